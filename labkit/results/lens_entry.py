"""The entry "lens" of results.json: the lens itself, and its modes and pupil, made of wavefronts and camera parts."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from labkit.mode_groups import USUAL_NOLL
from labkit.optics.metrics import rms_by_order
from labkit.optics.rim import Diaphragm
from labkit.results.common import CommonNumbers, StatedNumber
from labkit.results.kept import (
    Entry,
    Finite,
    Matrix,
    Millimetres,
    Name,
    PositiveEntry,
    array,
    table,
    uncertain,
)
from labkit.results.model import Lens
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results


class LensEntry(Entry):
    """The lens that all fits have in common. modes, pupil: made of wavefronts and camera parts, and not read."""

    focal_length: Annotated[Uncertain, uncertain("mm", PositiveEntry)] = Field(
        alias="focal_length_mm"
    )
    f_number: Annotated[Uncertain, uncertain("", PositiveEntry)]
    pupil_magnification: Annotated[Uncertain, uncertain("", PositiveEntry)]
    range_zero: Millimetres = Field(alias="range_zero_mm")
    modes: Any = None
    pupil: Any = None

    @classmethod
    def of_results(cls, results: Results, lens: Lens) -> LensEntry:
        """Return the entry of the lens of some results."""
        return cls.of(lens, modes=_modes_entry(results), pupil=_pupil_entry(results, lens))


def _modes_entry(results: Results) -> dict[str, Any]:
    """Return the modes, and the RMS of each order beyond the usual ones in the wavefront that determines them best."""
    best = min(results.wavefronts, key=lambda w: float(np.sum(w.std)))
    higher = rms_by_order(best.fitted.without(range(USUAL_NOLL[1] + 1)))
    return {
        "orders": [
            {"order": order, "waves_rms": rms.as_json()} for order, rms in higher.items()
        ],
        "noll": [min(best.noll), max(best.noll)],
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
    """A number that was known before the session."""

    value: Finite
    std: Finite
    moves: Annotated[Floats, array(tuple[Finite, ...])]


class CommonEntry(Entry):
    """The lens's numbers with their joint covariance."""

    names: tuple[Name, ...]
    values: Annotated[Floats, array(tuple[Finite, ...])]
    covariance: Matrix
    stated: dict[Name, Annotated[StatedNumber, table(StatedEntry, StatedNumber)]]


Common = Annotated[CommonNumbers, table(CommonEntry, CommonNumbers)]
