"""The slope of focus over the sensor at each range of a session, and the camera's part of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from labkit.field.geometry import FieldGeometry
from labkit.field.surfaces import focus_rows, um_relative_std
from labkit.field.target_tilt import SeparatedTilt, TargetTilts, sensor_tilt, target_tilts
from labkit.optics.field import FieldModel
from labkit.optics.lens import ThinLens
from labkit.optics.wavefront import DEFOCUS
from labkit.results import Wavefront
from labkit.types import Floats

SLOPES = (3, 2)
"""Noll's modes of the field that are slopes, down and right."""


@dataclass(frozen=True, eq=False)
class FocusSlopes:
    """The slope of focus over the sensor at each range.

    Parameters
    ----------
    ranges_mm : (stations,) ranges with at least three tiles that are not on one line
    um_per_mm : (stations, 2) down and right, positive where the sensor is behind the image
    covariance : (2 stations, 2 stations)
    """

    ranges_mm: tuple[float | None, ...]
    um_per_mm: Floats
    covariance: Floats


def session_tilt(
    fits: Iterable[Wavefront],
    model: FieldModel,
    geometry: FieldGeometry,
    lens: ThinLens,
    focal_relative_std: float = 0.0,
) -> SeparatedTilt | None:
    """Separate the slopes of focus of a session's ranges into the camera's and the target's.

    Parameters
    ----------
    fits : of tiles, such as results
    model : their field
    geometry : of the tiles' places
    lens : of the target's image
    focal_relative_std : relative standard error of its focal length

    Returns
    -------
    None without a known range that has slopes
    """
    tilts = target_tilts(geometry, lens, focal_relative_std)
    slopes = focus_slopes(fits, model)
    both = [r for r in slopes.ranges_mm if r is not None and r in geometry.model.ranges_mm]
    if not both:
        return None
    here = _pairs(slopes.ranges_mm, both)
    return sensor_tilt(
        slopes.um_per_mm.ravel()[here].reshape(-1, 2),
        slopes.covariance[np.ix_(here, here)],
        _tilts_at(tilts, both),
    )


def focus_slopes(fits: Iterable[Wavefront], model: FieldModel) -> FocusSlopes:
    """Return the slope of focus at each range, by what the field's model leaves of the tiles' defocus.

    Each range and channel has a focus of its own; the shape of the focal surface but for its
    slope is the model's. Errors are those of the tiles' fits, larger where tiles scatter more.
    Those of the shape and of the cone are common to all ranges.

    Parameters
    ----------
    fits : of tiles; those that were not accepted, or whose sign is open, are left out
    model : of the field
    """
    by_range: dict[float | None, list[Wavefront]] = {}
    for fit in fits:
        usable = fit.accepted and not fit.sign_open and fit.tile is not None
        if usable and fit.placement is not None and fit.channel in model.channels:
            by_range.setdefault(fit.range_mm, []).append(fit)
    found = {
        range_mm: slope
        for range_mm, tiles in by_range.items()
        if (slope := _slope(tiles, model)) is not None
    }
    slopes = found.values()
    value = np.array([one.value for one in slopes]).reshape(-1, 2)
    by_shape = np.array([one.by_shape for one in slopes]).reshape(-1, model.waves.size)
    own = np.asarray(block_diag(*[one.covariance for one in slopes]))
    covariance = own + by_shape @ model.covariance @ by_shape.T
    um = model.um_per_wave * value
    cone = um_relative_std(model) * um.ravel()
    return FocusSlopes(
        tuple(found), um, model.um_per_wave**2 * covariance + np.outer(cone, cone)
    )


@dataclass(frozen=True, eq=False)
class _Slope:
    """The slope of defocus of one range, waves RMS for each mm.

    Parameters
    ----------
    value : (2,) down and right
    covariance : (2, 2) with the model's shape known
    by_shape : (2, coefficients) derivative by the model's coefficients
    """

    value: Floats
    covariance: Floats
    by_shape: Floats


def _slope(fits: Sequence[Wavefront], model: FieldModel) -> _Slope | None:
    """Return the slope of defocus of one range; None where tiles do not determine a plane."""
    channels = sorted({fit.channel for fit in fits})
    middles = [fit.placement.centre_px for fit in fits if fit.placement is not None]
    places = np.array(middles)
    heights = model.frame.heights_mm(places)
    own = np.array([[fit.channel == c for c in channels] for fit in fits], float)
    rows = np.hstack([heights, own])
    if np.linalg.matrix_rank(rows) < rows.shape[1] or len(rows) <= rows.shape[1]:
        return None
    at = [fit.noll.index(DEFOCUS) for fit in fits]
    waves = np.array([fit.waves[k] for fit, k in zip(fits, at, strict=True)])
    std = np.sqrt([fit.covariance[k, k] for fit, k in zip(fits, at, strict=True)])
    shape = [_shape(model, f.channel, p) for f, p in zip(fits, places, strict=True)]
    left = waves - shape @ model.waves.ravel()
    weighted = rows / std[:, None]
    covariance = np.asarray(np.linalg.inv(weighted.T @ weighted), float)
    solving = covariance @ weighted.T / std
    numbers = solving @ left
    square = float((((left - rows @ numbers) / std) ** 2).sum())
    scale = max(square / (len(rows) - rows.shape[1]), 1.0)
    return _Slope(numbers[:2], scale * covariance[:2, :2], -solving[:2] @ shape)


def _shape(model: FieldModel, channel: str, place_px: Floats) -> Floats:
    """Return (coefficients,): defocus at a place, but for its slope, as a linear combination of the model's coefficients."""
    row = focus_rows(model, channel, place_px)
    slopes = [k for k in SLOPES if k in model.field]
    row[[model.index(channel, k, DEFOCUS) for k in slopes]] = 0.0
    return row


def _tilts_at(tilts: TargetTilts, ranges_mm: Sequence[float]) -> TargetTilts:
    """Return the target's tilts at some of the ranges."""
    pairs = _pairs(tilts.ranges_mm, ranges_mm)
    at = [tilts.ranges_mm.index(r) for r in ranges_mm]
    return replace(
        tilts,
        ranges_mm=tuple(ranges_mm),
        depth_per_mm=tilts.depth_per_mm[at],
        covariance=tilts.covariance[np.ix_(pairs, pairs)],
        pupil_to_image_mm=tilts.pupil_to_image_mm[at],
        um=tilts.um[at],
    )


def _pairs(ranges_mm: Sequence[float | None], wanted: Sequence[float]) -> list[int]:
    """Return the places of the pairs of some ranges."""
    return [2 * ranges_mm.index(r) + k for r in wanted for k in (0, 1)]
