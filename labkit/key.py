"""The identity of a wavefront: its range, its channel, its tile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

DECIMALS = 5
"""Of a range in mm. Ranges that round alike are the same range: rails do not resolve 10 nm, and sums err by far less."""

WRITTEN = ".12g"
"""The longest range, 1 km, with all its decimals."""

Tile = tuple[int, int]
"""(row, column) of a tile of the field."""


@dataclass(frozen=True, slots=True)
class Key:
    """The identity of a wavefront. A key is hashable, and sorts by range, channel and tile.

    Parameters
    ----------
    range_mm : mm as the plan states it, rounded to `DECIMALS`; None if unknown
    channel : name of the channel
    tile : (row, column) of a tile of the field; None for the whole frame

    >>> results[Key(3200.0, "G")]
    """

    range_mm: float | None
    channel: str
    tile: Tile | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "range_mm", rounded(self.range_mm))

    def __str__(self) -> str:
        return self.array_name

    def __lt__(self, other: Key) -> bool:
        return self._rank < other._rank

    @property
    def whole(self) -> Key:
        """The key of the whole frame that a tile is of."""
        return replace(self, tile=None)

    @property
    def array_name(self) -> str:
        """The name of this wavefront's arrays in files: ``3200_G``, ``none_G``, ``3200_G_0_2``."""
        return "_".join([_digits(self.range_mm), self.channel, *map(str, self.tile or ())])

    @property
    def label(self) -> str:
        """The key in words: ``G at 3200 mm``."""
        words = self.channel
        if self.range_mm is not None:
            words += f" at {self.range_mm:{WRITTEN}} mm"
        return words if self.tile is None else f"{words}, tile {self.tile}"

    def as_json(self) -> dict[str, Any]:
        """Return the key as results.json keeps it."""
        tile = None if self.tile is None else list(self.tile)
        return {"range_mm": self.range_mm, "channel": self.channel, "tile": tile}

    @property
    def _rank(self) -> tuple[bool, float, str, tuple[int, ...]]:
        """Keys without a range come first, and whole frames before their tiles."""
        return (
            self.range_mm is not None,
            self.range_mm or 0.0,
            self.channel,
            self.tile or (),
        )


def rounded(range_mm: float | None) -> float | None:
    """Return a range to as many decimals as tell ranges apart, mm."""
    return None if range_mm is None else round(float(range_mm), DECIMALS)


def same_range(one_mm: float | None, other_mm: float | None) -> bool:
    """Return whether two ranges are the same: both unknown, or equal to 10 nm."""
    return rounded(one_mm) == rounded(other_mm)


def _digits(range_mm: float | None) -> str:
    return "none" if range_mm is None else f"{range_mm:{WRITTEN}}"
