"""How likely counts are through a lens whatever the scene: the likelihood integrated over scenes, not at the best one.

The best scene explains counts through nearly any lens, and the sharper the more blur is supposed; of all scenes together few
look like the counts through a wrong one (A. Levin et al., IEEE Trans. Pattern Anal. Mach. Intell. 33, 2354 (2011)).
"""

from __future__ import annotations

import numpy as np

from labkit.restoration.strength import Trial
from labkit.restoration.views import Views
from labkit.types import Floats

POWERS = (
    1.0,
    1.5,
    2.0,
)  # of w^2 that a scene's spectrum falls with: many edges, few edges, none
CONTRAST = 2.0  # standard deviation over mean of a scene, at most: what is nowhere below 0 has little more
FIRST_DECADE, DECADE_STEP, MOST_DECADES = (
    -3.0,
    0.5,
    1.0,
)  # decades of the stiffness about the unit of `Trial`


def unlikeliness(views: Views, coupling: Floats) -> float:
    """Return minus the log-likelihood of counts over random scenes of the most suitable contrast and smoothness.

    Not more contrasty than light can be: any blur of a few tens of pixels looks likely where scenes may be a thousand times as
    contrasty as their pictures.
    """
    return min(
        _least(Trial(views, coupling, np.random.default_rng(1), power)) for power in POWERS
    )


def _least(trial: Trial) -> float:
    """Return the minimum, downhill by steps of the stiffness, then by the parabola through the lowest three."""
    lowest = np.log10(trial.contrast_of_one() / CONTRAST**2 / trial.unit)

    def unlikely(decade: float) -> float:
        return trial.unlikely(trial.unit * 10**decade)

    at = max(FIRST_DECADE, lowest)
    here, below, above = (unlikely(at + k * DECADE_STEP) for k in (0, -1, 1))
    while below < here and at - DECADE_STEP > lowest:
        at, here, above, below = (
            at - DECADE_STEP,
            below,
            here,
            unlikely(at - 2 * DECADE_STEP),
        )
    while above < here and at < MOST_DECADES:
        at, here, below, above = (
            at + DECADE_STEP,
            above,
            here,
            unlikely(at + 2 * DECADE_STEP),
        )
    bend = below - 2 * here + above
    inside = bend > 0 and here <= min(below, above)
    return here - (above - below) ** 2 / (8 * bend) if inside else min(here, above)
