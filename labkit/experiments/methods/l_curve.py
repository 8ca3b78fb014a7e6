"""The strength of a restoration's penalty by the L-curve, to compare with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.restoration.strength import LEAST, MOST, Choice, Trial

BENDS = 41  # points of the curve
FEWEST = 4  # points of likely strengths


def _decade(trials: Sequence[Trial], unit: float) -> float:
    """Return the decade where misfit against roughness, both logarithmic, bends most to the left, as an L does.

    Only strengths that leave a tenth to ten times the noise count. P. Hansen and D. O'Leary, SIAM J. Sci. Comput. 14, 1487
    (1993).
    """
    decades = np.linspace(LEAST, MOST, BENDS)
    points = np.array(
        [np.sum([_corner(t, unit * 10**d) for t in trials], axis=0) for d in decades]
    )
    data = sum(trial.views.data for trial in trials)
    likely = np.abs(np.log10(points[:, 0] / data)) < 1
    if likely.sum() <= FEWEST:
        return float(decades[BENDS // 2])
    x, y = np.log(points[likely]).T
    dx, dy = np.gradient(x), np.gradient(y)
    bent = (dx * np.gradient(dy) - np.gradient(dx) * dy) / (dx**2 + dy**2) ** 1.5
    return float(decades[likely][int(np.argmax(bent[1:-1])) + 1])


def _corner(trial: Trial, stiffness: float) -> tuple[float, float]:
    """Return squared residuals, and roughness: f^T K f, from the planes of the scene."""
    kriging = trial.soft.stiffer(stiffness)
    planes = kriging.solve(trial.apart)
    rough = float(np.sum(planes * kriging.data_part(planes))) / stiffness
    return float(np.sum(kriging.variance * planes**2)), rough


L_CURVE = Choice("l-curve", _decade)
