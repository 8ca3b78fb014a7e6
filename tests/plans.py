"""Plans for tests, as text: a lens and a target, devices, and whatever a test wants otherwise."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

Tables = Mapping[str, Any]

SMALL: Tables = {
    "lens": {"focal_length_mm": 50.0, "f_number": 8.0},
    "sensor": {"pixel_pitch_um": 6.0},
    "channel": [{"name": "G", "wavelength_nm": 550.0}],
    "target": {"kind": "sierpinski", "order": 2, "size_mm": 9.0},
}
"""A target of 38 pixels at 2 m: a whole capture of it takes a moment."""

PORTRAIT: Tables = {
    "lens": {"focal_length_mm": 70.0, "f_number": 2.8},
    "sensor": {"pixel_pitch_um": 4.78},
    "channel": [{"name": "G", "wavelength_nm": 550.0}],
    "target": {"kind": "sierpinski", "order": 4, "size_mm": 15.6},
}
"""The lens and sensor of the thesis, before a target that is small enough to be fitted fast."""

RED_AND_GREEN: Tables = {
    "channel": [
        {"name": "R", "wavelength_nm": 650.0},
        {"name": "G", "wavelength_nm": 550.0},
    ]
}

IPAD: Tables = {"panel": "ipad-9.7-retina", "pixel_pitch_mm": None, "pixels": None}
"""Of [display], in place of a small panel."""


def simulated(
    ranges_mm: Sequence[float], range_at_zero_mm: float, address: str = "simulated:"
) -> Tables:
    """All three devices, on one simulated bench."""
    return {
        "camera": {"address": address, "exposure_s": 0.02},
        "rail": {
            "address": address,
            "ranges_mm": [*ranges_mm],
            "range_at_zero_mm": range_at_zero_mm,
        },
        "display": {"address": address, "pixel_pitch_mm": 0.1, "pixels": [400, 400]},
    }


def plan_text(*tables: Tables) -> str:
    """TOML of all tables together; of a key that stands in several the last counts, and None leaves it out."""
    lines = []
    for name in dict.fromkeys(name for one in tables for name in one):
        given = [one[name] for one in tables if name in one]
        if isinstance(given[-1], list):
            lines += [line for item in given[-1] for line in (f"[[{name}]]", *_pairs(item))]
        else:
            lines += [
                f"[{name}]",
                *_pairs({key: value for one in given for key, value in one.items()}),
            ]
    return "\n".join(lines) + "\n"


def _pairs(table: Tables) -> list[str]:
    # the strings, numbers, booleans and lists of JSON are those of TOML
    return [
        f"{key} = {json.dumps(value)}" for key, value in table.items() if value is not None
    ]
