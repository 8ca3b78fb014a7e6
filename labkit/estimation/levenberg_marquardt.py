"""Damped Newton steps from a start to the nearest maximum (Levenberg-Marquardt), in any parameter space."""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np
import scipy.linalg

from labkit.estimation.settings import SETTINGS
from labkit.types import Floats


class Step(NamedTuple):
    """A step from one position to another.

    Attributes
    ----------
    change : change of all parameters
    length : length in standard errors
    gain : predicted rise of the objective, for a parabola
    """

    change: Floats
    length: float
    gain: float

    @property
    def shortened(self) -> float:
        """Distance that damping leaves to go along the step, over its length: 0 if undamped, for then gain = length^2 / 2."""
        return self.gain / self.length**2 - 0.5 if self.length else 0.0


class Position(Protocol):
    """A point of a parameter space. A climb requests steps only from accepted positions, so slopes may be computed lazily."""

    @property
    def objective(self) -> float:
        """Log-likelihood to maximise; -inf at forbidden positions."""
        ...

    def step(self, damping: float) -> Step:
        """Return Marquardt's step: every diagonal element of the information grows by the share `damping`."""
        ...

    def moved(self, change: Floats) -> Self:
        """Return the position after a change."""
        ...

    def foreseen(self, change: Floats) -> Self | None:
        """Predict the position after a change of at most a standard error, from the slopes; None if not supported."""
        return None


P = TypeVar("P", bound=Position)


def climb(
    start: P,
    *,
    tolerance: float,
    max_steps: int = 40,
    damping: float = 1e-3,
    least: float = 1e-3,
) -> tuple[P, int, bool]:
    """Climb to the maximum near a start.

    Parameters
    ----------
    start : where to begin
    tolerance : error of the end in standard errors, all parameters together
    max_steps : largest number of positions whose slopes are computed
    damping : damping of the first step
    least : least damping after a step that led down, over 8

    Returns
    -------
    the end; the number of positions whose slopes were computed; whether the climb settled

    Notes
    -----
    Levenberg (1944), Marquardt (1963). The damping follows the ratio of a step's gain to its predicted gain: H. B. Nielsen,
    report IMM-REP-1999-05, Technical University of Denmark (1999). The remaining distance after a step is known beforehand:
    steps shrink at least as fast as the last two did, unless damping shortens them. A climb ends with a step that leaves less
    than the tolerance to go and whose end can be predicted from slopes, or with a step shorter than the tolerance.
    """
    here, steps, before = start, 1, 0.0
    converged = False
    while steps < max_steps and not converged and damping * SETTINGS.exact < 1:
        step = here.step(damping)
        slowed = min(1.0, step.length / before) if before else 1.0
        left = step.length * max(slowed, step.shortened)
        near = left < tolerance and step.length < 1
        foreseen = here.foreseen(step.change) if near else None
        there = foreseen or here.moved(step.change)
        gained = there.objective - here.objective
        converged = left < tolerance and step.length < tolerance
        if gained > 0:
            converged = converged or foreseen is not None
            damping *= max(1 / 8, 1 - (2 * gained / step.gain - 1) ** 3)
            here, steps, before = there, steps + (foreseen is None), step.length
        else:
            damping, before = 8 * max(damping, least), 0.0
        del there  # a position may hold much memory: one at a time
    return here, steps, converged


def damped_step(gradient: Floats, information: Floats, damping: float) -> Step:
    """Return Marquardt's step for a gradient (p,) and an information (p, p); parameters without information stay."""
    free = np.diag(information) > 0
    scale = np.zeros_like(gradient)
    scale[free] = 1 / np.sqrt(np.diag(information)[free])
    scaled = information * np.outer(scale, scale) + np.diag(np.where(free, damping, 1.0))
    change = np.asarray(
        scipy.linalg.solve(scaled, gradient * scale, assume_a="pos") * scale
    )
    square = float(change @ information @ change)
    return Step(change, square**0.5, float(change @ gradient) - square / 2)
