"""The likelihood about a wavefront that is not an optimum: what the frames say of a session's prediction.

Near focus, even modes hardly change a picture to first order (α = 0 is a saddle). With few photons the nearest optimum may be
far from the truth there, with errors that are too small. About the prediction of all other frames, the likelihood to second
order is a measurement that the session can use.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.estimation.climb import Problem, Start
from labkit.estimation.expansion import Freed, Opened, camera_prior, wide_enough
from labkit.estimation.identifiability import inverse

HELD_STEPS = 2
"""Newton's steps of pose, light and noise; they begin at an optimum of the same photographs."""


def expanded_about(problem: Problem, start: Start, f_number_std: float) -> Freed:
    """Fit pose, light and noise with the wavefront held, and expand the likelihood there.

    Parameters
    ----------
    problem : frames and their model, with the optics to hold
    start : the wavefront to hold, with a pose next to the right one
    f_number_std : relative standard error of the f-number

    Returns
    -------
    The Gaussian about the held wavefront, with the log-likelihood of its maximum: to second order, or as the frames have it
    there if that is less, where a parabola does not hold so far; but no less than at the held wavefront
    """
    problem, start = wide_enough(problem, start)
    prior = camera_prior(problem.model.optics, f_number_std)
    position = Opened(problem, problem.drawn(start.state), start.state, *prior)
    for _ in range(HELD_STEPS):
        expansion = position.expansion
        change = np.zeros_like(expansion.gradient)
        free = np.arange(expansion.camera.stop, change.size)
        information = expansion.information[np.ix_(free, free)]
        change[free] = inverse(information) @ expansion.gradient[free]
        there = position.moved(change)
        if not there.at.relative:  # implausible: what was reached is kept
            break
        position = there
    freed = position.freed(HELD_STEPS, True)
    step, _ = freed.expansion.newton(position.precision)
    foreseen = freed.solution.objective + 0.5 * float(step @ freed.expansion.gradient)
    objective = max(freed.solution.objective, min(foreseen, position.moved(step).objective))
    solution = replace(freed.solution, objective=objective)
    return replace(freed, solution=solution)
