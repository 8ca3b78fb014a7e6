"""The identity of an observation: provisional until the branch of findings joins."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Key:
    """Which range, channel and tile of the field an observation is of."""

    range_mm: float | None
    channel: str
    tile: tuple[int, int] | None = None
