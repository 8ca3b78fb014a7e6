"""Sagittal and tangential focus over the frame, and what is left of it on the best plane.

Every number is a focus error of the sensor in um: positive where the sensor lies behind the
image, farther from the lens.

Along a direction x of the pupil, defocus and astigmatism make W = x² (2 √3 c4 + √6 c), c the
astigmatism towards x: Noll 6 cos 2φ + Noll 5 sin 2φ. Light resolved along x is
sharp where the bracket is zero, at c4 = -c / √2. So tangential focus (details along the
field's radius) has c4 + c / √2, sagittal focus (across) c4 - c / √2, medial focus c4.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, nan, radians, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from labkit.field.pair import Pair
from labkit.optics.field import FieldModel
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats
from labkit.uncertain import Uncertain

Surface = Literal["medial", "sagittal", "tangential"]

ASTIGMATISM = (6, 5)
"""Noll's modes with the cosine and the sine of twice the angle."""

TOWARDS = {"medial": 0.0, "tangential": 1 / sqrt(2), "sagittal": -1 / sqrt(2)}
"""Focus of a surface for a wave of astigmatism towards the field's radius, in waves of Noll 4."""

EXTREME_STEPS = 24
"""Steps along the frame's longer side, between places among which peak and valley are looked for."""

PLANE_NODES = 16
"""Nodes along each side of the frame that a best plane is fitted to: squares up to degree 31 are exact."""

PLANE_TERMS = 3
"""Polynomials of a field that is a plane: nothing is known of what a plane leaves."""


def focus_rows(
    model: FieldModel,
    channel: str,
    places_px: ArrayLike,
    surface: Surface = "medial",
    azimuth_deg: float | None = None,
) -> Floats:
    """Return (..., coefficients): Noll 4 of a surface at places (..., 2) as linear combinations of `waves.ravel()`.

    azimuth_deg : direction called tangential, degrees from right towards down; by default
        that of the place from the frame's centre, and down at the centre itself
    """
    at = np.moveaxis(model.frame.polynomials(model.field, places_px), 0, -1)
    rows = np.zeros((*at.shape[:-1], *model.waves.shape))
    own = model.channels.index(channel)
    rows[..., own, :, model.noll.index(DEFOCUS)] = at
    down, right = np.moveaxis(model.frame.heights_mm(places_px), -1, 0)
    at_centre = (down == 0) & (right == 0)
    angle = np.where(at_centre, np.pi / 2, np.arctan2(down, right))
    if azimuth_deg is not None:
        angle = np.full(angle.shape, radians(azimuth_deg))
    for mode, part in zip(ASTIGMATISM, (np.cos(2 * angle), np.sin(2 * angle)), strict=True):
        if mode in model.noll:
            towards = TOWARDS[surface] * part[..., None]
            rows[..., own, :, model.noll.index(mode)] = towards * at
    return rows.reshape(*at.shape[:-1], model.waves.size)


def focus_um(
    model: FieldModel,
    channel: str,
    places_px: ArrayLike,
    surface: Surface = "medial",
    azimuth_deg: float | None = None,
) -> tuple[Floats, Floats]:
    """Return the focus error of the sensor (...), um, at places (..., 2), and its standard errors; as `focus_rows`."""
    rows = focus_rows(model, channel, places_px, surface, azimuth_deg)
    return in_um(model, rows)


def in_um(model: FieldModel, rows: Floats) -> tuple[Floats, Floats]:
    """Return linear combinations (..., coefficients) of Noll 4 in um, with standard errors that include the cone's."""
    value = model.um_per_wave * (rows @ model.waves.ravel())
    variance = np.sum((rows @ model.covariance) * rows, axis=-1)
    std = model.um_per_wave * np.sqrt(variance.clip(0))
    return value, np.hypot(std, um_relative_std(model) * value)


def um_relative_std(model: FieldModel) -> float:
    """Return the relative standard error of um for a wave of defocus, which grows with the f-number squared."""
    return 2 * model.f_number_std / model.f_number


def frame_places(model: FieldModel, steps: int = EXTREME_STEPS) -> Floats:
    """Return places (rows, columns, 2) that cover the frame from corner to corner in equal steps."""
    shape = np.array(model.frame.shape_px)
    counts = np.maximum(np.round(steps * shape / shape.max()), 2).astype(int) + 1
    rows, columns = (
        np.linspace(-0.5, side - 0.5, count)
        for side, count in zip(shape, counts, strict=True)
    )
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)


@dataclass(frozen=True, eq=False)
class BestPlane:
    """The plane nearest to a focal surface over the whole frame, and what it leaves.

    Parameters
    ----------
    tilt : slope of the focus error, um/mm, down and right
    rms : of the focus error that the best plane leaves, um
    peak_to_valley : of the same, um
    """

    tilt: Pair
    rms: Uncertain
    peak_to_valley: Uncertain


def best_plane(model: FieldModel, channel: str, surface: Surface = "medial") -> BestPlane:
    """Return the best plane of a focal surface: least squares over the frame.

    A sensor moved and tilted onto the plane keeps the residual, which is the lens's.
    """
    if len(model.field) <= PLANE_TERMS:
        unknown = Uncertain(nan, inf, "um")
        return BestPlane(Pair(np.full(2, nan), np.full((2, 2), inf)), unknown, unknown)
    places, weight = _nodes(model)
    rows = focus_rows(model, channel, places, surface)
    root = np.sqrt(weight)[:, None]
    fitted = np.linalg.lstsq(root * _plane(model, places), root * rows, rcond=None)[0]
    left = root * (rows - _plane(model, places) @ fitted)
    # squares of linear numbers add up to the mean square
    parts = left @ model.waves.ravel()
    mean_square = float(parts @ parts)
    by_waves = parts @ left
    variance = float(by_waves @ model.covariance @ by_waves)
    noise = float(np.sum((left @ model.covariance) * left))
    rms = sqrt(mean_square)
    std = sqrt(variance / mean_square if mean_square > noise else noise)
    corners = frame_places(model).reshape(-1, 2)
    beside = focus_rows(model, channel, corners, surface) - _plane(model, corners) @ fitted
    error = beside @ model.waves.ravel()
    span, span_std = in_um(model, beside[np.argmax(error)] - beside[np.argmin(error)])
    factor = model.um_per_wave
    relative = um_relative_std(model)
    slopes = fitted[1:]
    tilt = Pair(slopes @ model.waves.ravel(), slopes @ model.covariance @ slopes.T)
    return BestPlane(
        tilt.times(factor, "um/mm", relative),
        Uncertain(factor * rms, factor * hypot(std, relative * rms), "um"),
        Uncertain(float(span), float(span_std), "um"),
    )


def _plane(model: FieldModel, places_px: Floats) -> Floats:
    """Return (n, 3) a constant and the heights of places, whose combinations are planes."""
    heights = model.frame.heights_mm(places_px)
    return np.column_stack([np.ones(len(heights)), heights])


def _nodes(model: FieldModel) -> tuple[Floats, Floats]:
    """Return places (n, 2) and weights (n,) that average polynomials over the frame exactly (Gauss)."""
    node, weight = np.polynomial.legendre.leggauss(PLANE_NODES)
    half = np.array(model.frame.shape_px) / 2
    places = np.stack(np.meshgrid(node, node, indexing="ij"), axis=-1) * half
    both = np.outer(weight, weight) / 4
    return places.reshape(-1, 2) + model.frame.centre_px, both.ravel()
