"""Fits of a session, made of the laws of a lens as physics.md §10 and §15 print them: nothing here is labkit's formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labkit.analysis.lens_model import Member, Stated
from labkit.estimation.expansion import Measured
from labkit.types import Floats
from labkit.uncertain import Uncertain

REFERENCE_MM = 450e-6
COLOURS = ("R", "G", "B")
DEFOCUS_STD, CONE_STD, SIZE_STD = 3e-4, 4e-3, 1.5e-5
"""Of one fit, physics.md §15: waves with the cone known; relative errors of cone and size."""


def laws(range_mm: Any, focus_mm: Any, reference_mm: Any, f: Any, n: Any, mp: Any) -> list[Any]:
    """Waves RMS of defocus, ln of the cone's f-number, ln of the scale; of real numbers or complex ones.

    All ranges are true; reference_mm: best focus of the colour that sizes are held to, and whose f and n are given. Others have
    the same aperture and sensor, so that what they focus on tells their focal length.
    """
    sensor = reference_mm * f / (reference_mm - f)
    own = sensor * focus_mm / (sensor + focus_mm)

    def sagitta(r: Any) -> Any:
        radius, half = r * own / (r - own) + (mp - 1) * own, mp * f / n / 2
        return half**2 / (radius + np.sqrt(radius**2 - half**2))

    waves = (sagitta(range_mm) - sagitta(focus_mm)) / np.sqrt(12) / REFERENCE_MM
    cone = (sensor + (mp - 1) * own) / (mp * f / n)
    scale = (sensor + (mp - 1) * f) / (mp * (range_mm - f + f / mp))
    return [waves, np.log(cone), np.log(scale)]


def covariance(waves: float, *, size_std: float = SIZE_STD) -> Floats:
    """(3, 3) of defocus, ln cone, ln scale of one fit: defocus times cone is known better than either."""
    slope = np.array([-waves, 1.0, 0.0])
    return np.diag([DEFOCUS_STD**2, 0.0, size_std**2]) + CONE_STD**2 * np.outer(slope, slope)


def member(range_mm: float, channel: str, values: Floats, *, size_std: float = SIZE_STD) -> Member:
    """A fit of defocus alone. values: (3,)."""
    cov = covariance(float(values[0]), size_std=size_std)
    return Member(channel, range_mm, range_mm, Measured((4,), np.asarray(values, float), cov, np.zeros((3, 3))))


def members(
    ranges_mm: Sequence[float], focus_mm: float, f: float, n: float, mp: float = 1.0, *, size_std: float = SIZE_STD
) -> list[Member]:
    """Of three colours, all focused at one range, ranges as stated."""
    return [
        member(r, colour, np.array(laws(r, focus_mm, focus_mm, f, n, mp)), size_std=size_std)
        for r in ranges_mm
        for colour in COLOURS
    ]


def moved(m: Member, waves: float = 0.0, cone: float = 0.0) -> Member:
    """A fit that ended elsewhere, by waves of defocus and by ln of its cone."""
    values = m.measured.values + np.array([waves, cone, 0.0])
    return replace(m, measured=replace(m.measured, values=values))


def stated(f: float, n: float, **changed: Any) -> Stated:
    """Engravings, 1 % and free; tape, 5 mm; steps, 1 µm; the rest exact."""
    fields: dict[str, Any] = {
        "focal_length": Uncertain(f, 0.01 * f, "mm"),
        "f_number": Uncertain(n, n),
        "size_std": 0.0,
        "range_std_mm": 1e-3,
        "range_zero_std_mm": 5.0,
        "homing_std_mm": 0.0,
        "wavelength_std": dict.fromkeys(COLOURS, 0.0),
        "reference_nm": 450.0,
    }
    return Stated(**fields | changed)
