"""Groups of numbers that fits estimate with wavefront and pose: their names and data-sheet quantities."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

from labkit.plan import Channel
from labkit.uncertain import Uncertain


class Estimated(ABC):
    """A group of numbers, such as a part of the camera. The likelihood is regular at zero.

    Attributes
    ----------
    labels : a name for each number; numbers may be negative in the course of an estimate
    usual : standard deviation of each number among cameras, far beyond the error of one
        frame
    meanings : a few words on each quantity, for a table, by the end of its key
    per_channel : whether each channel has numbers of its own; otherwise all channels share
        them
    one_sided : whether numbers below 0 are unphysical
    """

    __slots__ = ()

    labels: ClassVar[tuple[str, ...]]
    usual: ClassVar[tuple[float, ...]]
    meanings: ClassVar[Mapping[str, str]]
    per_channel: ClassVar[bool] = False
    one_sided: ClassVar[bool] = True

    @property
    @abstractmethod
    def name(self) -> str:
        """Key in results and in labels."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Name for a table."""

    @property
    @abstractmethod
    def values(self) -> tuple[float, ...]:
        """The numbers, one for each label."""

    @abstractmethod
    def at(self, values: Sequence[float]) -> Self:
        """Return the same group with other numbers, limited to possible values."""

    @abstractmethod
    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        """Return the data-sheet quantities of estimated numbers.

        Parameters
        ----------
        numbers : one for each label
        channel : of the numbers, for a group that is `per_channel`

        Returns
        -------
        By their keys in ``model_parts`` of results.json: name, channel if any, and
        quantity, which ends with its unit.
        """

    @abstractmethod
    def finding(self, found: Mapping[str, Uncertain]) -> str:
        """Describe the group's quantities, as of `quantities`, in one sentence of a warning."""

    def own(self, found: Mapping[str, Uncertain]) -> dict[str, Uncertain]:
        """Return this group's quantities among those of a whole camera, by their keys without the group's name."""
        start = f"{self.name}."
        return {
            key.removeprefix(start): value
            for key, value in found.items()
            if key.startswith(start)
        }


def root(square: Uncertain, unit: str = "") -> Uncertain:
    """Return the square root of an estimated number; 0 for a negative number."""
    value = math.sqrt(max(square.value, 0.0))
    std = square.std / (2 * value) if value**2 > square.std else math.sqrt(square.std)
    return Uncertain(value, std, unit)


def polar(
    cosine: Uncertain, sine: Uncertain, order: int = 1
) -> tuple[Uncertain, Uncertain]:
    """Return length and direction, degrees, of two independent components along cosine and sine of `order` times the angle.

    The error of a direction is at most that of any direction within a period.
    """
    length = math.hypot(cosine.value, sine.value) or 1e-9
    along = cosine.value / length
    across = sine.value / length
    angle = math.degrees(math.atan2(sine.value, cosine.value)) / order
    std = math.degrees(math.hypot(across * cosine.std, along * sine.std) / length) / order
    return (
        Uncertain(length, math.hypot(along * cosine.std, across * sine.std)),
        Uncertain(angle, min(std, 360 / order / math.sqrt(12)), "deg"),
    )


def mean(numbers: Sequence[Uncertain]) -> Uncertain:
    """Return the mean of independent numbers."""
    value = sum(number.value for number in numbers)
    std = math.hypot(*(number.std for number in numbers))
    return Uncertain(value / len(numbers), std / len(numbers))
