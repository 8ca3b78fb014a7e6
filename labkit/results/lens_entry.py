"""Entries of "lens" in results.json that are made of the wavefronts and the parts of the model: modes and pupil."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.mode_groups import USUAL_NOLL
from labkit.optics.metrics import rms_by_order
from labkit.optics.rim import Diaphragm
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.model import Lens
    from labkit.results.results import Results

Json = dict[str, Any]


def modes_entry(results: Results) -> Json:
    """Return the modes, and the RMS of each order beyond the usual ones in the wavefront that determines them best."""
    best = min(results.wavefronts, key=lambda w: float(np.sum(w.std)))
    higher = rms_by_order(best.fitted.without(range(USUAL_NOLL[1] + 1)))
    return {
        "orders": [
            {"order": order, "waves_rms": rms.as_json()} for order, rms in higher.items()
        ],
        "noll": [min(best.noll), max(best.noll)],
    }


def pupil_entry(results: Results, lens: Lens) -> Json:
    """Return the pupil that all wavefronts share: its blades, obstruction, uneven rim and cat's eye."""
    rim, parts = results.wavefronts[0].rim, results.model_parts
    diaphragm = next((cut for cut in rim.cuts if isinstance(cut, Diaphragm)), None)
    blades = None if diaphragm is None else diaphragm.blades
    obstruction = Uncertain(math.sqrt(max(rim.obstructed, 0.0)), 0.0)
    outer = lens.f_number
    return {
        "blades": blades,
        "turn_deg": _json(parts.get(f"blades_{blades}.turn_deg")),
        "roundness": _json(parts.get(f"blades_{blades}.roundness")),
        "obstruction": parts.get("obstruction.diameter", obstruction).as_json(),
        "rim": [
            {
                "k": k,
                "cos": parts[f"uneven_rim.cosine_{k}"].as_json(),
                "sin": parts[f"uneven_rim.sine_{k}"].as_json(),
            }
            for k in (2, 3)
            if f"uneven_rim.cosine_{k}" in parts
        ],
        "cats_eye": None
        if "cats_eye.shift" not in parts
        else {
            name: parts[f"cats_eye.{name}"].as_json()
            for name in ("shift", "radius", "direction_deg")
        },
        "outer_f_number": Uncertain(
            outer.value / rim.outer, outer.std / rim.outer
        ).as_json(),
    }


def _json(number: Uncertain | None) -> Json | None:
    return None if number is None else number.as_json()
