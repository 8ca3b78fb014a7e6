"""How likely counts are through a lens whatever the scene: the likelihood integrated over scenes, not at the best one.

The best scene explains counts through nearly any lens, and the sharper the more blur is supposed; of all scenes together few
look like the counts through a wrong one (A. Levin et al., IEEE Trans. Pattern Anal. Mach. Intell. 33, 2354 (2011)).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labkit.restoration.strength import Trial
from labkit.restoration.views import Views
from labkit.types import Floats

POWERS = (1.0, 1.5, 2.0)  # of w^2 that a scene's spectrum falls with: many edges, few edges, none
BEGIN, STEP, MOST, LEAST = -3.0, 0.5, 1.0, -6.0  # decades of the stiffness about the unit of `Trial`


def unlikeliness(views: Views, coupling: Floats) -> float:
    """Minus the log-likelihood of counts, but for a constant: of random scenes as contrasty and as smooth as suits best."""
    trials = [Trial(views, coupling, np.random.default_rng(1), power) for power in POWERS]
    return min(_least(lambda decade, trial=trial: trial.unlikely(trial.unit * 10**decade)) for trial in trials)


def _least(unlikely: Callable[[float], float]) -> float:
    """Downhill by steps, then of the parabola through the lowest three."""
    at, here, below, above = BEGIN, *(unlikely(BEGIN + k * STEP) for k in (0, -1, 1))
    while below < here and at > LEAST:
        at, here, above, below = at - STEP, below, here, unlikely(at - 2 * STEP)
    while above < here and at < MOST:
        at, here, below, above = at + STEP, above, here, unlikely(at + 2 * STEP)
    bend = below - 2 * here + above
    return here - (above - below) ** 2 / (8 * bend) if bend > 0 and here <= min(below, above) else min(here, below, above)
