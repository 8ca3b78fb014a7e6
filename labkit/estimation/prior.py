"""Gaussian priors of modes: what is known of a wavefront before a climb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labkit.estimation.settings import SETTINGS
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats


@dataclass(frozen=True)
class Prior:
    """A Gaussian of the modes, which are the first n parameters of a climb, each independent of all others.

    Attributes
    ----------
    mean, precision : (n,) means and inverse variances
    """

    mean: Floats
    precision: Floats

    @classmethod
    def of_lens(cls, noll: Sequence[int], known: Floats | None = None) -> Prior:
        """Return the prior of a lens's modes: about 0 as wide as lenses vary, or about what is known, (n,). Defocus is free."""
        std = SETTINGS.usual_waves if known is None else SETTINGS.known_waves
        precision = [0.0 if j == DEFOCUS else std**-2 for j in noll]
        mean = np.zeros(len(noll)) if known is None else known
        return cls(mean, np.array(precision))

    def loss(self, waves: Floats) -> float:
        """Return how much log-likelihood modes (n,) lose against the mean."""
        return 0.5 * float(self.precision @ (waves - self.mean) ** 2)

    def joined(
        self, gradient: Floats, information: Floats, waves: Floats
    ) -> tuple[Floats, Floats]:
        """Return gradient (p,) and information (p, p) at modes (n,) with the prior added."""
        at = np.arange(self.mean.size)
        gradient, information = gradient.copy(), information.copy()
        gradient[at] -= self.precision * (waves - self.mean)
        information[at, at] += self.precision
        return gradient, information
