"""A field made by hand, and results of tiles that follow its model, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from labkit.findings.findings import Finding
from labkit.key import Key
from labkit.optics.field import FieldFrame, FieldModel, field_terms
from labkit.results import Placement, Results, Wavefront
from labkit.types import Floats
from tests.results_samples import ACCEPTED, PLAN, REJECTED, a_wavefront, some_results

FRAME = FieldFrame((4000, 6000), 4.78)
NOLL = tuple(range(4, 12))
FIELD = field_terms(2)
TILT, CURVATURE, COMA, ASTIGMATISM = (0.05, -0.11), -0.16, (0.03, -0.02), 0.07
"""Noll 4 by Noll 3 and 2 of the field; by Noll 4; Noll 7 and 8 by 1; Noll 5 and 6 by 5 and 6. Waves RMS."""

SHAPE = (3, 5)
NEAR_MM, FAR_MM = 3000.0, 3200.0
STEP_PX, SIDE_PX = 1200.0, 420.0
K1_PER_MM2, LATERAL = -5e-5, 2e-4
TILED = PLAN.replace(
    target={"grid": list(SHAPE), "pitch_mm": PLAN.target.size_mm * STEP_PX / SIDE_PX},
    limits={
        "tilt_um": 60.0,
        "coma_waves": 0.03,
        "curvature_um": 54.0,
        "lateral_colour_um": 2.0,
        "distortion_percent": 1.0,
    },
    mount={"screws_mm": [[-20, 15], [20, 15], [0, -20]], "screw_pitch_mm": 0.5},
)
"""Of the limits one is met, one is missed, and one is as near as the errors."""

PLACE_STD_PX = 0.01


def a_model(channels: tuple[str, ...] = ("R", "B"), std: float = 0.003) -> FieldModel:
    """A field of order two: a tilted, curved focal surface, astigmatism, and a decentre."""
    waves = np.zeros((len(channels), len(FIELD), len(NOLL)))
    at = {(k, j): (FIELD.index(k), NOLL.index(j)) for k in FIELD for j in NOLL}
    for (k, j), value in {
        (3, 4): TILT[0],
        (2, 4): TILT[1],
        (4, 4): CURVATURE,
        (1, 7): COMA[0],
        (1, 8): COMA[1],
        (2, 8): 0.04,
        (3, 7): 0.04,
        (5, 5): ASTIGMATISM,
        (6, 6): ASTIGMATISM,
    }.items():
        waves[:, *at[k, j]] = value
    waves[1:, 0, 0] = 0.05  # longitudinal colour
    spread = std / np.sqrt(np.array(FIELD, float))
    std_of = np.broadcast_to(spread[:, None], waves.shape).ravel()
    wavelengths = {"R": 650.0, "G": 550.0, "B": 450.0}
    return FieldModel(
        FRAME,
        channels,
        FIELD,
        NOLL,
        waves,
        np.diag(std_of**2),
        tuple(wavelengths[c] for c in channels),
        450.0,
        2.8,
        0.008,
    )


def tile_corners_px(
    tile: tuple[int, int], range_mm: float = NEAR_MM, channel: str = "R"
) -> Floats:
    """Return (4, 2) corners of a tile whose grid fills the frame at the nearer range, distorted, and of its own size in B."""
    away = (np.array(tile) - (np.array(SHAPE) - 1) / 2) * STEP_PX
    corners = away + SIDE_PX / 2 * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    mm = corners * NEAR_MM / range_mm * 1e-3 * FRAME.pixel_pitch_um
    mm = mm * (1 + K1_PER_MM2 * np.sum(mm**2, axis=1, keepdims=True))
    return FRAME.places_px(mm * (1 + (LATERAL if channel == "B" else 0.0)))


def a_tile(
    tile: tuple[int, int], range_mm: float, channel: str, **changed: Any
) -> Wavefront:
    """A wavefront as the model has it at the tile's place, plus the defocus of its range."""
    model = a_model()
    rng = np.random.default_rng([int(range_mm), ord(channel), *tile])
    corners = tile_corners_px(tile, range_mm, channel)
    corners = corners + rng.normal(0, PLACE_STD_PX, corners.shape)
    fitted = model.wavefront(channel, corners.mean(axis=0))
    waves = fitted.waves.copy()
    waves[0] += (range_mm - NEAR_MM) / 190
    return a_wavefront(
        range_mm,
        channel,
        tile=tile,
        noll=NOLL,
        waves=waves,
        covariance=fitted.covariance,
        poses=np.zeros((1, 8)),
        placement=Placement((0, 0), (4000, 6000), corners[np.newaxis]),
        **{"residuals": None, **changed},
    )


def tiled_results(shape: tuple[int, int] = SHAPE, **changed: Any) -> Results:
    """Two ranges of two channels; a tile was left out, and one of R at 3000 mm is doubtful."""
    left_out, doubtful = (0, 1), (shape[0] - 1, shape[1] - 1)
    wavefronts = []
    for range_mm in (NEAR_MM, FAR_MM):
        for channel in ("R", "B"):
            for tile in np.ndindex(shape):
                if tile == left_out:
                    continue
                at = (range_mm, channel, tile)
                test = REJECTED if at == (NEAR_MM, "R", doubtful) else ACCEPTED
                wavefronts.append(a_tile((tile[0], tile[1]), range_mm, channel, test=test))
    missing = Key(NEAR_MM, "R", left_out)
    fields: dict[str, Any] = {
        "wavefronts": tuple(wavefronts),
        "field": a_model(),
        "plan": TILED,
        "findings": (Finding("tile-left-out", missing, {}, "the frame cuts it"),),
    }
    return replace(some_results(), **fields | changed)
