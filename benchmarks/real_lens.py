"""Sessions of one carpet at a field point of a commercial lens, by its design wavefronts.

The lens is Edmund 63762 (`shared/real/lens63762`): `python -m benchmarks.sessions OUT.jsonl --study real-lens --sessions 15`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.random_sessions import TAPE_STD_MM, Drawn, _ranges_at, _session
from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.view import per_tangent_mm
from labkit.drivers.simulated.world import TrueLens
from labkit.drivers.simulated.zernike_table import read_table

REAL_LENS = Path(__file__).parents[2] / "shared/real/lens63762/zernike_noll.csv"
FIELD_DEG, REAL_F_NUMBERS = (0.0, 5.0, 10.0, 15.0, 20.0), (1.8, 2.8, 4.0)
REAL_ELECTRONS = 23_000.0
"""A commercial lens: its design wavefronts, where and how it is measured, and the electrons of white."""

REAL_SAMPLES = 12
"""To a pixel: fewer leave errors along edges that fits at so many electrons see."""

CAREFUL_TAPE_STD_MM, CAREFUL_LINE_STD_NM, LINE_WIDTH_NM = 1.0, 0.5, 1.0
"""Of a careful measurement in narrow light: errors of the tape and of wavelengths, and the stated width of the light."""

REAL_LENS_STREAM = 3
"""Sets what draws these sessions apart from what draws others."""


def draw_real_lens(
    seed: int, index: int, careful: bool = False, frames_per_range: int = 2
) -> Drawn:
    """Draw a session at a field point of a commercial lens, whose plan says nothing of modes: before, about and behind focus.

    Every fifteen sessions have each of FIELD_DEG at each of REAL_F_NUMBERS once. The frame's centre is at that angle below
    the lens's axis. Raises ValueError where the table of the lens is missing.

    Parameters
    ----------
    careful : whether the tape is good to CAREFUL_TAPE_STD_MM and the light to CAREFUL_LINE_STD_NM; otherwise as of other
        sessions, and the true wavelengths are stated
    frames_per_range : photographs at each range
    """
    rng = np.random.default_rng([seed, index, REAL_LENS_STREAM])
    field_deg = FIELD_DEG[index % len(FIELD_DEG)]
    best_mm = 2000.0
    lens = TrueLens(
        focal_length_mm=50.0,
        f_number=REAL_F_NUMBERS[index // len(FIELD_DEG) % len(REAL_F_NUMBERS)],
        wavelength_nm={"R": 656.0, "G": 588.0, "B": 486.0},
        best_focus_mm=dict.fromkeys("RGB", best_mm),
        aberration_waves=0.0,
    )
    height_mm = float(np.tan(np.radians(field_deg))) * per_tangent_mm(lens)
    terms = FieldTerms(axis_mm=(-height_mm, 0.0), table=read_table(str(REAL_LENS)))
    stations = np.array([-0.8, 0.0, 0.8]) + rng.uniform(-0.15, 0.15, 3)
    lens = replace(lens, field_terms=terms)
    ranges_mm = _ranges_at(lens, best_mm, stations)
    tape_std_mm = CAREFUL_TAPE_STD_MM if careful else TAPE_STD_MM
    drawn = _session(lens, ranges_mm, "through focus", rng, REAL_ELECTRONS, tape_std_mm)
    channels: list[dict[str, Any]] = [
        {"name": name, "wavelength_nm": nm} for name, nm in lens.wavelength_nm.items()
    ]
    for channel in channels if careful else ():
        channel["wavelength_nm"] += CAREFUL_LINE_STD_NM * float(rng.standard_normal())
        channel |= {"wavelength_std_nm": CAREFUL_LINE_STD_NM, "width_nm": LINE_WIDTH_NM}
    plan = drawn.plan.replace(
        channel=channels,
        fit={"zernike_noll": None, "range_zero_std_mm": tape_std_mm},
        camera={"frames_per_range": frames_per_range},
    )
    settings = replace(drawn.settings, samples_per_pixel=REAL_SAMPLES)
    return Drawn(plan, settings, {**drawn.kind, "field_deg": field_deg})
