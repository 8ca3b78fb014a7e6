"""Relative illumination: how much light reaches each place of the frame, against the centre, by flats.

Flats show the lens and the light together. The panel or the light box has to be even, and
its own fall-off counts as the lens's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from labkit.optics.field import FieldFrame, field_terms
from labkit.types import Floats
from labkit.uncertain import Uncertain

LIGHT_BLOCKS = 32
"""Of pixels along the longer side, whose means are fitted."""

TERMS = field_terms(6)
"""Noll's numbers of the polynomials over the circle around the frame. A test that leaves out orders which are hardly
significant would leave errors that no standard error holds."""

LEAST_BLOCK_VARIANCE = 1e-2
"""Of a block, over the median block's."""

LIGHT_ROUNDING = 1e-8
"""Of relative light."""

LEAST_SHARE_LIT = 0.5
"""Smallest share of usable pixels for a block that counts."""

UNLIT = 0.05
"""Light, relative to the brightest blocks, below which a block is outside of the light."""

FRAME_CORNERS = ("top left", "top right", "bottom right", "bottom left")

Plane = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class RelativeIllumination:
    """The light of one channel over the frame, as a polynomial of low order.

    Parameters
    ----------
    frame : coordinates
    light, covariance : (terms,), (terms, terms) coefficients, in any unit
    residual_percent : RMS of the blocks about the polynomial, of the light in the centre
    lit_share : of the frame's blocks
    """

    frame: FieldFrame
    light: Floats
    covariance: Floats
    residual_percent: float
    lit_share: float

    def percent(self, places_px: ArrayLike) -> tuple[Floats, Floats]:
        """Return the light (...) at places (..., 2), % of that in the centre, and its standard errors."""
        at = np.moveaxis(self.frame.polynomials(TERMS, places_px), 0, -1)
        centre = self.frame.polynomials(TERMS, self.frame.centre_px)
        level = centre @ self.light
        share = at @ self.light / level
        rows = (at - share[..., None] * centre) / level
        variance = np.einsum("...i,ij,...j->...", rows, self.covariance, rows)
        return 100 * share, 100 * np.sqrt(variance.clip(0))

    @property
    def corners_percent(self) -> tuple[Floats, Floats]:
        """Light (4,) in the corners of the frame, clockwise from the top left, % of the centre's, and standard errors."""
        rows, columns = np.array(self.frame.shape_px) - 1
        return self.percent([[0, 0], [0, columns], [rows, columns], [rows, 0]])

    @property
    def corners(self) -> dict[str, Uncertain]:
        """Light in each corner of the frame by its name, % of the centre's."""
        numbers = zip(*self.corners_percent, strict=True)
        return {
            name: Uncertain(float(value), float(std), "%")
            for name, (value, std) in zip(FRAME_CORNERS, numbers, strict=True)
        }

    def as_json(self) -> dict[str, Any]:
        """Return the light in the corners, and how well the polynomial describes the flat."""
        return {
            "corners_percent": {at: light.as_json() for at, light in self.corners.items()},
            "residual_percent": self.residual_percent,
            "lit_share": self.lit_share,
        }


def measure_illumination(
    flat: Floats, planes: Sequence[Plane], pixel_pitch_um: float
) -> RelativeIllumination:
    """Measure the relative illumination of one channel.

    Parameters
    ----------
    flat : (rows, columns) mean counts above dark of the whole raw image, nan where unusable
    planes : of the channel's pixels, such as (slice(0, None, 2), slice(1, None, 2))
    pixel_pitch_um : of the raw's pixels

    Raises
    ------
    ValueError : a flat of too few lit blocks for a polynomial
    """
    if flat.ndim != 2:
        raise ValueError(f"a flat of shape {flat.shape}: (rows, columns) is needed")
    frame = FieldFrame((flat.shape[0], flat.shape[1]), pixel_pitch_um)
    blocks = [_blocks(flat, plane) for plane in planes]
    places, light, variance = (np.concatenate(part) for part in zip(*blocks, strict=True))
    lit = np.isfinite(light) & (light > UNLIT * np.nanpercentile(light, 95))
    least = 2 * len(TERMS)
    if lit.sum() < least:
        raise ValueError(
            f"the flat has {lit.sum()} lit blocks of {len(lit)}: {least} are needed for its illumination"
        )
    # every block's own scatter, but none is known so much better than the usual one
    known = np.maximum(variance[lit], LEAST_BLOCK_VARIANCE * np.median(variance[lit]))
    weight = 1 / np.sqrt(known + LIGHT_ROUNDING**2)
    rows = frame.polynomials(TERMS, places[lit]).T
    weighted = rows * weight[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    coefficients = np.asarray(covariance @ weighted.T @ (weight * light[lit]))
    left = light[lit] - rows @ coefficients
    scale = float(((weight * left) ** 2).sum()) / (len(left) - len(TERMS))
    centre = frame.polynomials(TERMS, frame.centre_px) @ coefficients
    return RelativeIllumination(
        frame,
        coefficients,
        np.asarray(max(scale, 1.0) * covariance),
        float(100 * np.sqrt(np.mean(left**2)) / centre),
        float(lit.mean()),
    )


def _blocks(flat: Floats, plane: Plane) -> tuple[Floats, Floats, Floats]:
    """Return places (n, 2) px, mean light and variance of a plane's blocks, over the plane's mean; nan where unusable."""
    counts = flat[plane].astype(float)
    rows, columns = (
        np.arange(size)[part].astype(float)
        for size, part in zip(flat.shape, plane, strict=True)
    )
    side = max(1, max(counts.shape) // LIGHT_BLOCKS)
    high, wide = (size // side for size in counts.shape)
    cut = counts[: high * side, : wide * side].reshape(high, side, wide, side)
    pixels = cut.swapaxes(1, 2).reshape(high * wide, side**2)
    usable = np.isfinite(pixels)
    number = usable.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(usable, pixels, 0).sum(axis=1) / number
        away = np.where(usable, pixels - mean[:, None], 0)
        variance = (away**2).sum(axis=1) / np.maximum(number - 1, 1) / number
    mean[number < LEAST_SHARE_LIT * side**2] = np.nan
    middle_rows = rows[: high * side].reshape(high, side).mean(axis=1)
    middle_columns = columns[: wide * side].reshape(wide, side).mean(axis=1)
    places = np.stack(np.meshgrid(middle_rows, middle_columns, indexing="ij"), axis=-1)
    level = np.nanmean(mean) if np.isfinite(mean).any() else 1.0
    return places.reshape(-1, 2), mean / level, variance / level**2
