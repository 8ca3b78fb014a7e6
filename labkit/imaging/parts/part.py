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
from labkit.optics.rim import ROUND, Place, Rim
from labkit.optics.spectrum import Spectrum
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain

UNIT = re.compile(r"_(px2?|nm|deg)$")


class Part(Estimated):
    """A part of the camera or of the lens that blurs; with all numbers 0 it does nothing.

    The numbers of a blur are variances, not widths. Most parts multiply the transfer
    function of lens and pixel: `transfer` and `slopes`. A part of the light adds up the
    PSFs of several wavelengths instead: `light` and `light_slopes`. A part of the pupil
    shapes its rim: `onto`.

    Attributes
    ----------
    reach_px : distance from a point's image within which a model must keep its light,
        pixels
    of_rim : whether the part shapes the pupil's rim
    sought : whether fits test for the part by a score test if a plan does not state it
    far : whether the numbers are so far from 0 that a score test at 0 hardly shows the
        part's gain
    kind : parts of one kind other than "" exclude each other: a lens has one diaphragm
    """

    __slots__ = ()

    reach_px: ClassVar[float] = 0.0
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

    @property
    def twin(self) -> Self:
        """The part of the twin: turned by half a turn."""
        return self.at([v * s for v, s in zip(self.values, self.twin_signs, strict=True)])

    def starts(self, before: Sequence[Part]) -> tuple[Self, ...]:
        """Return the part with the start values of a fit; several where the right ones are not known.

        before: parts in the model of the previous fit
        """
        return (self,)

    @property
    def sides(self) -> tuple[Self, ...]:
        """The part, and its twin if a fit may have it on the wrong side."""
        return (self,)

    @property
    def idle(self) -> bool:
        """Return whether the part leaves the transfer function behind the lens unchanged."""
        return not any(self.values)

    @property
    def at_bound(self) -> bool:
        """Return whether an estimate ended at the limit of the part's physical values."""
        return False

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

    @property
    def broadest(self) -> Spectrum | None:
        """Broadest spectrum within an estimate's bounds; None for parts other than the spectrum."""
        return None

    def about(self, typical: Spectrum, place: Place | None) -> Self:
        """Return the part for light of a typical spectrum and, of tiles, for a place of the frame."""
        return self

    def light_slopes(self) -> tuple[Mapping[float, float], ...]:
        """Return the derivatives of `light` by each number: of each node's weight, by node."""
        return ()

    def onto(self, rim: Rim) -> Rim:
        """Return the pupil's rim with this part; most parts leave the rim unchanged."""
        return rim

    @abstractmethod
    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        """Return a channel's part as a plan states it, and whether fits estimate its numbers; else None."""

    @abstractmethod
    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        """Return the part with some `quantities`; None if they are missing or not finite."""

    def finding(self, found: Mapping[str, Uncertain]) -> str:
        """Return the sentence of a warning that the photographs show the part, with its quantities."""
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
