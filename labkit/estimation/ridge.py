"""The ridge of a likelihood: where it is largest if the values that a session prescribes are given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labkit.types import Floats


@dataclass(frozen=True)
class Ridge:
    """The ridge about an optimum, to first order.

    The p parameters are modes, camera parameters, and the rest, which affects no other observation: pose, light, noise. The m
    values are those of `Measured`.

    Attributes
    ----------
    values : (m,) at the optimum
    slopes : (m, p) change of the likeliest parameters by each value
    """

    values: Floats
    slopes: Floats

    def step(self, values: Floats) -> Floats:
        """Return the change (p,) of the parameters from the optimum to where the values (m,) are given."""
        return np.asarray((values - self.values) @ self.slopes)

    def twin(self, signs: Floats) -> Ridge:
        """Return the ridge about the twin of the optimum. signs: (m,) see `Measured.signs`."""
        of_parameters = np.ones(self.slopes.shape[1])
        of_parameters[: len(signs) - 1] = signs[:-1]
        return Ridge(self.values * signs, self.slopes * np.outer(signs, of_parameters))
