"""The rim of a pupil in results.json."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from labkit.optics.rim import Circle, Cut, Diaphragm, Rim
from labkit.results.kept import Degrees, Entry, Finite, Kept


class BladesEntry(Entry):
    """A diaphragm."""

    blades: Annotated[int, Field(ge=3, le=20)]
    turn: Degrees = Field(alias="turn_deg")
    roundness: Annotated[Finite, Field(ge=0, le=1)]


class CircleEntry(Entry):
    """A circle that cuts the pupil."""

    shift: Annotated[Finite, Field(ge=0, le=5)]
    size: Annotated[Finite, Field(gt=0, le=10)] = Field(alias="radius")
    direction: Degrees = Field(alias="direction_deg")


def _cut(entry: BladesEntry | CircleEntry) -> Cut:
    """Return an edge of the pupil. Raises ValueError for a circle off the pupil."""
    if isinstance(entry, BladesEntry):
        return entry.made(Diaphragm)
    if entry.shift >= entry.size:
        raise ValueError(f"a circle {entry.shift:g} off, of radius {entry.size:g}")
    return entry.made(Circle)


def _cut_entry(cut: Cut) -> dict[str, Any]:
    entry = BladesEntry if isinstance(cut, Diaphragm) else CircleEntry
    return entry.of(cut).written()


class PupilEntry(Entry):
    """The rim of a pupil that is no clear disc."""

    cuts: Annotated[
        tuple[Annotated[Cut, Kept(BladesEntry | CircleEntry, _cut, _cut_entry)], ...],
        Field(max_length=5),
    ] = ()
    uneven: Annotated[tuple[Finite, ...], Field(max_length=4)] = ()
    obstructed: Annotated[Finite, Field(ge=-0.9, le=0.9)] = 0.0


def _rim(entry: PupilEntry) -> Rim:
    """Return the rim. Raises ValueError where it is no closed curve."""
    if sum(map(abs, entry.uneven)) >= 1:
        raise ValueError(f"uneven = {entry.uneven}: the rim is no closed curve")
    return entry.made(Rim)


KeptRim = Annotated[Rim, Kept(PupilEntry, _rim, lambda rim: PupilEntry.of(rim).written())]
