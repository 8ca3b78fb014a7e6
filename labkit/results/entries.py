"""Tables of results.json beside the wavefronts: inputs of the fit, the lens with its modes and pupil, the rim of a pupil."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from labkit.optics.metrics import rms_by_order
from labkit.optics.rim import Circle, Cut, Diaphragm, Rim
from labkit.plan.mode_groups import MODE_GROUPS, USUAL_NOLL
from labkit.results.kept import (
    Degrees,
    Entry,
    Finite,
    Kept,
    KnownEntry,
    KnownStd,
    Matrix,
    Name,
    PositiveEntry,
    array,
    table,
    uncertain,
)
from labkit.results.model import CommonNumbers, Lens, StatedNumber
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results
from dataclasses import dataclass
from math import inf, isnan

from labkit.results.kept import Noll, Number, Range, Text


@dataclass(frozen=True)
class MadeFrom:
    """Inputs of a fit in addition to the plan, and their outcome.

    Attributes
    ----------
    frames_sha256 : of the names, kinds, ranges and checksums of the session's photographs
    numerics_sha256 : of the source of labkit's numerics
    own_plan : whether the plan is the session's own
    ranges_mm, channels, noll : as `labkit.fit` has them
    patience_s : processor time of a search; inf without a limit
    joint, split, plain : as `labkit.fit` has them
    failed : for each failed fit, a sentence with the reason
    failed_accepted : whether the user accepts the results without failed fits
    """

    frames_sha256: str
    numerics_sha256: str
    own_plan: bool = True
    ranges_mm: tuple[float, ...] | None = None
    channels: tuple[str, ...] | None = None
    noll: tuple[int, int] | None = None
    patience_s: float = inf
    joint: bool = False
    split: bool = False
    plain: bool = False
    failed: tuple[str, ...] = ()
    failed_accepted: bool = False

    def __post_init__(self) -> None:
        if isnan(self.patience_s):  # as a file states no limit
            object.__setattr__(self, "patience_s", inf)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings to make the results again, by the names of `labkit.fit`; without the plan."""
        names = ("ranges_mm", "channels", "noll", "patience_s", "joint", "split", "plain")
        return {name: getattr(self, name) for name in names}


class MadeFromEntry(Entry):
    """The entry of the inputs of results."""

    frames_sha256: Text
    numerics_sha256: Text
    own_plan: bool = True
    ranges_mm: tuple[Range, ...] | None = None
    channels: tuple[Name, ...] | None = None
    noll: tuple[Noll, Noll] | None = None
    patience_s: Number = inf
    joint: bool = False
    split: bool = False
    plain: bool = False
    failed: Annotated[tuple[Text, ...], Field(max_length=10_000)] = ()
    failed_accepted: bool = False


RecordOfInputs = Annotated[MadeFrom, table(MadeFromEntry, MadeFrom)]


class BladesEntry(Entry):
    """A diaphragm."""

    blades: Annotated[int, Field(ge=3, le=20)]
    turn: Degrees = Field(alias="turn_deg")
    roundness: Annotated[Finite, Field(ge=0, le=1)]


class CircleEntry(Entry):
    """A circle by which the pupil is cut."""

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
    """The rim of a pupil other than a clear disc."""

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


class LensEntry(Entry):
    """The lens that all fits have in common. modes, pupil: made of wavefronts and camera parts, and not read."""

    focal_length: Annotated[Uncertain, uncertain("mm", PositiveEntry)] = Field(
        alias="focal_length_mm"
    )
    f_number: Annotated[Uncertain, uncertain("", PositiveEntry)]
    pupil_magnification: Annotated[Uncertain, uncertain("", PositiveEntry)]
    range_zero: Annotated[Uncertain, uncertain("mm", KnownEntry)] = Field(
        alias="range_zero_mm"
    )
    wavelengths_nm: dict[Name, Annotated[Uncertain, uncertain("nm", PositiveEntry)]] = (
        Field(default_factory=dict)
    )
    modes: Any = None
    pupil: Any = None

    @classmethod
    def of_results(cls, results: Results, lens: Lens) -> LensEntry:
        """Return the entry of the lens of some results."""
        return cls.of(lens, modes=_modes_entry(results), pupil=_pupil_entry(results, lens))


def _modes_entry(results: Results) -> dict[str, Any]:
    """Return the modes, and the RMS of each order beyond the usual ones in the wavefront that determines them best.

    Where a session has added modes, those beyond are weak: no photograph calls for them.
    """
    best = min(results.wavefronts, key=lambda w: float(np.sum(w.std)))
    added = [
        MODE_GROUPS[one.name].last
        for one in results.parts_tried
        if one.adopted and one.name in MODE_GROUPS
    ]
    noll = [j for j in best.noll if j <= max(added, default=j)]
    without = set(best.noll) - set(noll) | set(range(USUAL_NOLL[1] + 1))
    higher = rms_by_order(best.fitted.without(without))
    return {
        "orders": [
            {"order": order, "waves_rms": rms.as_json()} for order, rms in higher.items()
        ],
        "noll": [min(noll), max(noll)],
    }


def _pupil_entry(results: Results, lens: Lens) -> dict[str, Any]:
    """Return the pupil that all wavefronts share: its blades, obstruction, uneven rim and cat's eye."""
    rim = results.wavefronts[0].rim
    outer = results.wavefronts[0].rim.outer
    parts = {name: number.as_json() for name, number in results.model_parts.items()}
    diaphragm = next((cut for cut in rim.cuts if isinstance(cut, Diaphragm)), None)
    blades = None if diaphragm is None else diaphragm.blades
    obstruction = Uncertain(sqrt(max(rim.obstructed, 0.0)), 0.0)
    f_number = Uncertain(lens.f_number.value / outer, lens.f_number.std / outer)
    return {
        "blades": blades,
        "turn_deg": parts.get(f"blades_{blades}.turn_deg"),
        "roundness": parts.get(f"blades_{blades}.roundness"),
        "obstruction": parts.get("obstruction.diameter", obstruction.as_json()),
        "rim": [
            {"k": k, "cos": cosine, "sin": parts[f"uneven_rim.sine_{k}"]}
            for k in (2, 3)
            if (cosine := parts.get(f"uneven_rim.cosine_{k}")) is not None
        ],
        "cats_eye": None
        if "cats_eye.shift" not in parts
        else {
            name: parts[f"cats_eye.{name}"] for name in ("shift", "radius", "direction_deg")
        },
        "outer_f_number": f_number.as_json(),
    }


class StatedEntry(Entry):
    """A number known before the session."""

    value: Finite
    std: KnownStd
    moves: Annotated[Floats, array(tuple[Finite, ...])]


class CommonEntry(Entry):
    """The lens's numbers with their joint covariance."""

    names: tuple[Name, ...]
    values: Annotated[Floats, array(tuple[Finite, ...])]
    covariance: Matrix
    stated: dict[Name, Annotated[StatedNumber, table(StatedEntry, StatedNumber)]]


Common = Annotated[CommonNumbers, table(CommonEntry, CommonNumbers)]
