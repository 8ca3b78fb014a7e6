"""Tiles of a field where a lens and a target put them, exactly or with noise."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labkit.field.tile_model import BEND, DECENTRE, RADIAL, TileModel
from labkit.field.tile_places import TileGrid, TilePlace, usual_covariance
from labkit.key import Key
from labkit.optics.field import FieldFrame
from labkit.optics.lens import ThinLens
from labkit.types import Floats

FRAME = FieldFrame((512, 768), 5.2)
GRID = TileGrid((2, 3), 45.077, (29.751, 29.751))
LENS = ThinLens(35.0, 4.0)
RANGES_MM = (1180.0, 1220.0, 1260.0)
TILES = tuple(np.ndindex(*GRID.shape))
LATERAL = {"G": 0.0, "R": -1.1e-4, "B": 1.8e-4}
TRUTH = Path(__file__).parents[2] / "shared" / "golden" / "truth-field-open.json"


def truth() -> dict[str, Any]:
    return dict(json.loads(TRUTH.read_text(encoding="utf-8")))


def empty_places(
    channels: Sequence[str] = tuple(LATERAL), ranges_mm: Sequence[float] = RANGES_MM
) -> tuple[TilePlace, ...]:
    keys = [
        Key(r, c, (row, column))
        for r in ranges_mm
        for c in channels
        for row, column in TILES
    ]
    return tuple(TilePlace(key, np.zeros((4, 2))) for key in keys)


def model(
    channels: Sequence[str] = tuple(LATERAL), ranges_mm: Sequence[float] = RANGES_MM
) -> TileModel:
    places = empty_places(channels, ranges_mm)
    return TileModel(
        FRAME, GRID, places, tuple(ranges_mm), tuple(channels), np.array(ranges_mm)
    )


def numbers(
    of: TileModel,
    rng: np.random.Generator,
    k1: float = 9e-4,
    centre_mm: Sequence[float] = (0.0, 0.0),
    bend: Sequence[float] = (0.0, 0.0, 0.0),
    lateral: Mapping[str, float] = LATERAL,
) -> Floats:
    """Return the numbers of poses that differ a little from range to range, and of a lens."""
    drawn = np.zeros(of.size)
    for station, range_mm in enumerate(of.ranges_mm):
        assert range_mm is not None
        scale = LENS.focal_length_mm / (range_mm - LENS.focal_length_mm) * of.unit_mm
        down, right = 0.03 * rng.normal(size=2)
        tilt = 4e-5 * of.unit_mm * rng.normal(size=2)
        drawn[of.homography(station)] = [scale, 0, down, 0, scale, right, *tilt]
    shared = drawn[of.shared]
    shared[list(RADIAL)] = k1
    shared[list(DECENTRE)] = -k1 * np.asarray(centre_mm)
    shared[list(BEND)] = bend
    for channel in of.channels[1:]:
        drawn[of.colour(channel)][:1] = lateral[channel]
    return drawn


def observed(
    of: TileModel, with_numbers: Floats, std_px: float, rng: np.random.Generator
) -> tuple[TilePlace, ...]:
    """Return the places of tiles by a model, with noise as of equal information everywhere on a tile."""
    exact = FRAME.places_px(np.real(of.corners_mm(with_numbers))).reshape(-1, 8)
    errors = rng.normal(size=exact.shape) @ np.linalg.cholesky(usual_covariance()).T
    corners = (exact + std_px * errors).reshape(-1, 4, 2)
    return tuple(
        replace(place, corners_px=at) for place, at in zip(of.places, corners, strict=True)
    )
