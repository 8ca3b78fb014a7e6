"""The protocol of a part of camera or lens: a transfer function, a spectrum, or a rim of a few numbers."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import Estimated
from labkit.optics.rim import ROUND, Rim
from labkit.optics.spectrum import Spectrum
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain

UNIT = re.compile(r"_(px2?|nm|deg)$")


class Part(Estimated):
    """A part of the camera that blurs, or of the lens. With all of its numbers 0 it does nothing; those of a blur are
    variances, not widths.

    Most parts multiply the transfer function of lens and pixel: `transfer` and `slopes`. A part of the light adds up the
    PSFs of several wavelengths instead: `light` and `light_slopes`. A part of the pupil shapes its rim: `onto`.

    Attributes
    ----------
    reach_px : distance from a point's image within which a model must keep its light, pixels
    broadest : the broadest spectrum that an estimate may reach; None for a part that is not of the light
    of_rim : whether the part shapes the pupil's rim
    sought : whether fits look for the part by a score test where a plan does not state it
    far : whether numbers are so far from 0 that a score test there tells too little of what the part gains
    kind : parts of one kind other than "" exclude each other: a lens has one diaphragm
    """

    __slots__ = ()

    reach_px: ClassVar[float] = 0.0
    broadest: ClassVar[Spectrum | None] = None
    of_rim: ClassVar[bool] = False
    sought: bool = True
    far: ClassVar[bool] = False
    kind: ClassVar[str] = ""

    @property
    @abstractmethod
    def words(self) -> str:
        """Name for a sentence, with its article."""

    @property
    def twin_signs(self) -> tuple[float, ...]:
        """Factor of each number in the twin, whose pupil is turned by 180 degrees (thesis §3.6): -1 for odd numbers."""
        return (1.0,) * len(self.labels)

    def begun(self, before: Sequence[Part]) -> Self:
        """Return the part with the numbers that a fit begins with. before: parts in the model of the fit before."""
        return self

    @property
    def idle(self) -> bool:
        """Whether the part leaves the transfer function behind the lens as it is."""
        return not any(self.values)

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        """Return the transfer function.

        Parameters
        ----------
        rows, columns : frequencies along rows (m, 1) and along columns (1, n), cycles a pixel

        Returns
        -------
        (m, n), in their precision
        """
        return np.ones(np.broadcast_shapes(rows.shape, columns.shape), rows.dtype)

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        """Return the derivatives (m, n) of `transfer` by each number."""
        return ()

    @property
    def light(self) -> Spectrum | None:
        """Spectrum of the light; None for a part that is not of the light."""
        return None

    def light_slopes(self) -> tuple[Mapping[float, float], ...]:
        """Return the derivatives of `light` by each number: of each node's weight, by node."""
        return ()

    def onto(self, rim: Rim) -> Rim:
        """Return the pupil's rim with this part; most parts leave it as it is."""
        return rim

    @abstractmethod
    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        """Return the part as a plan states it for a channel, and whether fits estimate it; None where it does not."""

    @abstractmethod
    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        """Return the part that has some `quantities`; None where they are not there or not finite."""

    def finding(self, found: Mapping[str, Uncertain]) -> str:
        """Say that the photographs call for the part, and with what quantities."""
        numbers = ", ".join(
            f"{UNIT.sub('', key)} {value}" for key, value in self.own(found).items()
        )
        return f"the photographs call for {self.words}, which the plan does not state: {numbers}"


def rim_of(parts: Iterable[Part]) -> Rim:
    """Return the pupil's rim with all of its parts."""
    return reduce(lambda rim, part: part.onto(rim), parts, ROUND)


def finite(found: Mapping[str, Uncertain], *keys: str) -> list[float] | None:
    """Return the values of some quantities; None unless all are there and finite."""
    values = [found[key].value for key in keys if key in found]
    return values if len(values) == len(keys) and all(map(math.isfinite, values)) else None
