"""Places of the field that a lens tester reads: lines through the centre, and the frame's centre, edges and corners.

Azimuths are degrees from right (along the rows) towards down, as in the pupil. Tangential
detail has its frequencies along the azimuth of its place, sagittal detail across.
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, inf, radians, sin

import numpy as np
from numpy.typing import ArrayLike

from labkit.field.surfaces import Surface
from labkit.optics.field import FieldFrame
from labkit.types import Floats

AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0)

PARALLEL = 1e-12
"""Cosine of a line and a side of the frame that never meet."""


def azimuths_deg(frame: FieldFrame) -> tuple[float, ...]:
    """Return the azimuths of profiles: every 45 degrees, and the frame's diagonals, which end in its corners."""
    diagonal = degrees(atan2(*frame.shape_px))
    return tuple(sorted({*AZIMUTHS_DEG, diagonal, 180.0 - diagonal}))


def line_end_mm(frame: FieldFrame, azimuth_deg: float) -> float:
    """Return the distance from the frame's centre to its edge along an azimuth."""
    turn = radians(azimuth_deg)
    half = np.array(frame.shape_px) / 2 * frame.pixel_pitch_um * 1e-3
    along = abs(sin(turn)), abs(cos(turn))
    ends = (
        side / part if part > PARALLEL else inf
        for side, part in zip(half, along, strict=True)
    )
    return float(min(ends))


def line_px(frame: FieldFrame, azimuth_deg: float, height_mm: Floats) -> Floats:
    """Return the places (n, 2), row and column, at heights (n,) along a line through the centre."""
    turn = radians(azimuth_deg)
    return frame.places_px(height_mm[:, None] * np.array([sin(turn), cos(turn)]))


def detail_deg(azimuth_deg: float, surface: Surface) -> float:
    """Return the direction of frequencies of a surface at a place of some azimuth: along it, or across."""
    return azimuth_deg if surface == "tangential" else azimuth_deg - 90.0


def field_points(frame: FieldFrame) -> dict[str, Floats]:
    """Return the centre, the middles of the edges and the corners of the frame, (row, column) each."""
    sides = {
        "centre": (0, 0),
        "top": (-1, 0),
        "left": (0, -1),
        "right": (0, 1),
        "bottom": (1, 0),
        "top left": (-1, -1),
        "top right": (-1, 1),
        "bottom left": (1, -1),
        "bottom right": (1, 1),
    }
    half = np.array(frame.shape_px) / 2
    return {name: frame.centre_px + half * side for name, side in sides.items()}


def azimuth_of(frame: FieldFrame, place_px: ArrayLike) -> float:
    """Return the azimuth of a place from the frame's centre, degrees from right towards down; down at the centre."""
    down, right = frame.heights_mm(place_px)
    return degrees(atan2(down, right)) if hypot(down, right) else 90.0
