"""Make master frames: offset, smooth illumination and pixel response, each with its error.

All functions take and return plain arrays on the full raw grid. `planes` are the slices of
the colour filter's cell (one for mono), because neighbours of one colour are two pixels
apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from labkit.types import Bools, Counts, Floats

SLAB_ROWS = 256
"""Stacks are worked on so many rows at a time: a whole stack of floats of a large sensor would not fit."""

REJECT_SIGMAS = 4.0
"""Values of a stack farther than this from their median are left out of the mean."""

OUTLIER_SIGMAS = 8.0
"""Pixels whose response differs from their neighbours' by more than this are not used."""

ILLUMINATION_ORDER = 4
"""Total degree of the polynomial in row and column that takes vignetting and the display's fall-off."""

ILLUMINATION_SMOOTHING_PX = 16.0
"""Standard deviation, in pixels of one plane, of the smoothing of what the polynomial leaves."""

DISPLAY_DEPARTS = 0.1
"""Relative difference of a flat from the light on the target, continued, beyond which it does not show the display: a
polynomial continued over a target's margin errs by a per cent or two, what is beside a display by far more."""

DISPLAY_ROUNDS = 4
"""Of continuing the light as far as the display was found: corners beside a turned target are far from it."""

MAJORITY_PX = 5
"""Side, in pixels of one plane, of the neighbourhood whose majority decides where the display is: single pixels are defects."""

LIT_SHARE = 0.25
"""A flat's brightness, as a share of its bright parts', below which the display does not reach."""


def clipped_mean(stack: Counts) -> Floats:
    """Return the (rows, cols) mean of (frames, rows, cols), without values far from each pixel's median.

    With fewer than three frames the plain mean is returned.
    """
    if len(stack) < 3:
        return np.asarray(stack.mean(axis=0, dtype=np.float64))
    mean = np.empty(stack.shape[1:])
    for rows in _slabs(stack.shape[1]):
        slab = stack[:, rows].astype(np.float64)
        away = np.abs(slab - np.median(slab, axis=0))
        own = 1.4826 * np.median(away, axis=0)  # bright pixels are noisier than others
        mean[rows] = np.average(
            slab,
            axis=0,
            weights=away <= REJECT_SIGMAS * np.maximum(own, max(np.median(own), 0.5)),
        )
    return mean


def _slabs(rows: int) -> Iterator[slice]:
    return (
        slice(start, min(start + SLAB_ROWS, rows)) for start in range(0, rows, SLAB_ROWS)
    )


def shrunk(values: Floats, variance: Floats | float) -> tuple[Floats, Floats]:
    """Return posterior mean and deviation of normal values with unknown spread, measured with known variance.

    Empirical Bayes: the spread's variance is the values' robust scatter beyond their
    measurement error. The posterior pulls each value towards the common mean by its own
    unreliability (Efron and Morris, JASA 70, 1975).
    """
    error = np.broadcast_to(np.asarray(variance, dtype=np.float64), values.shape)
    # means of whole numbers stand on few steps: a clipped variance does not mind, a median deviation would
    kept = values[
        ~outliers(
            values, np.ones(values.shape, dtype=np.bool_), least=float(np.sqrt(error.max()))
        )
    ]
    centre = float(kept.mean())
    prior = max(float(kept.var()) - float(np.median(error)), 0.0)
    if prior == 0.0:
        return np.full_like(values, centre), np.zeros_like(values)
    pull = prior / (prior + error)
    return centre + pull * (values - centre), np.sqrt(pull * error)


@dataclass(frozen=True, slots=True)
class Illumination:
    """Light of one plane in counts, continued beyond the lit pixels; relative to its mean where lit; and the lit pixels."""

    surface: Floats
    relative: Floats
    level: float
    lit: Bools


def smooth_illumination(
    flat: Floats,
    good: Bools,
    smooth_px: float = ILLUMINATION_SMOOTHING_PX,
    lit: Bools | None = None,
) -> Illumination:
    """Return the smooth part of a plane's mean flat.

    A robust polynomial of low order describes the fall-off, a wide Gaussian mean the rest.
    Pixel response stays out of both, being uncorrelated. flat: (rows, cols) counts with
    black removed; good: usable pixels; smooth_px: of the Gaussian; lit: by the display,
    None where that is to be found.
    """
    if lit is None:
        lit = _lit(flat, good)
    use = good & lit
    surface = _polynomial(flat, use)
    remainder = np.where(use, flat / surface, 0.0)
    sigma = min(smooth_px, min(flat.shape) / 8)
    weight = ndimage.gaussian_filter(use.astype(np.float64), sigma, mode="constant")
    centre = float(np.median(remainder[use]))
    spread = 1.4826 * float(np.median(np.abs(remainder[use] - centre)))
    calm = np.clip(remainder, centre - 5 * spread, centre + 5 * spread) * use
    smooth = ndimage.gaussian_filter(calm, sigma, mode="constant") / np.maximum(
        weight, 1e-3
    )
    light = surface * np.where(weight > 1e-3, smooth, 1.0)
    level = float(light[use].mean())
    return Illumination(light, np.where(lit, light / level, 1.0), level, lit)


def display_around(flat: Floats, good: Bools, target: Bools) -> Bools:
    """Return the pixels of a plane's mean flat that the display around a target lights.

    The light on the target is continued: the display ends where a flat departs from it, to
    a dark room or a bright one. flat, good: as of `smooth_illumination`; target: the pixels
    that see it.
    """
    display = target
    for _ in range(DISPLAY_ROUNDS):
        light = smooth_illumination(flat, good, lit=display)
        away = np.abs(flat / light.surface - 1)
        usual = float(np.median(away[good & display]))
        # a panel near enough to show its pixels departs everywhere, and its end is not seen
        near = away < max(DISPLAY_DEPARTS, OUTLIER_SIGMAS * 1.4826 * usual)
        among = ndimage.uniform_filter(good.astype(np.float64), MAJORITY_PX)
        most = ndimage.uniform_filter((near & good).astype(np.float64), MAJORITY_PX)
        found = joined_to(target, near & (most > 0.5 * among))
        if np.array_equal(found, display) or not (found & good).any():
            break
        display = found
    return display


def joined_to(target: Bools, pixels: Bools) -> Bools:
    """Return those of the pixels (rows, cols) that hang together with the target's."""
    parts, _ = ndimage.label(pixels)
    of_target = np.unique(parts[target & pixels])
    return np.asarray(np.isin(parts, of_target))


def _lit(flat: Floats, good: Bools) -> Bools:
    """Return the pixels lit by the display: all of the frame, or less its dark part and a seam of 5 %."""
    side = max(1, min(flat.shape) // 60)
    coarse = ndimage.uniform_filter(np.where(good, flat, 0.0), side) / np.maximum(
        ndimage.uniform_filter(good.astype(np.float64), side), 1e-3
    )
    bright = coarse > LIT_SHARE * np.percentile(coarse, 95)
    if bright.all():
        return np.asarray(bright)
    holes_filled = ndimage.binary_closing(
        np.pad(bright, 2 * side, mode="edge"), iterations=2 * side
    )
    bright = holes_filled[2 * side : -2 * side, 2 * side : -2 * side]
    return np.asarray(ndimage.binary_erosion(bright, iterations=3 * side, border_value=1))


def _polynomial(flat: Floats, use: Bools) -> Floats:
    """Fit a polynomial of total degree ILLUMINATION_ORDER to means of small blocks by robust least squares."""
    block = max(1, min(flat.shape) // 60)
    rows, cols = (n // block * block for n in flat.shape)
    shape = (rows // block, block, cols // block, block)
    weight = use[:rows, :cols].reshape(shape).sum(axis=(1, 3)).astype(np.float64)
    mean = np.where(use, flat, 0.0)[:rows, :cols].reshape(shape).sum(
        axis=(1, 3)
    ) / np.maximum(weight, 1.0)
    y, x = (
        2 * (np.arange(n // block) * block + (block - 1) / 2) / max(n - 1, 1) - 1
        for n in flat.shape
    )
    design = _powers(y, x).reshape(-1, mean.size).T
    scale = float(mean.max())
    trust = weight.ravel().copy()
    coefficients = np.zeros(design.shape[1])
    for _ in range(5):
        # Legendre polynomials are nearly orthogonal, so the normal equations do
        weighed = design.T * trust
        coefficients = np.linalg.lstsq(
            weighed @ design, weighed @ mean.ravel() / scale, rcond=None
        )[0]
        away = np.abs(mean.ravel() / scale - design @ coefficients)
        spread = 1.4826 * float(np.median(away[weight.ravel() > 0]))
        trust = weight.ravel() / np.maximum(
            1.0, away / max(2 * spread, 1e-12)
        )  # Huber's weights
    # a product of matrices: every term's surface by itself would take fifteen times the memory
    of_powers = np.zeros((ILLUMINATION_ORDER + 1, ILLUMINATION_ORDER + 1))
    of_powers[tuple(np.transpose(_degrees()))] = coefficients
    py, px = (_legendre(np.linspace(-1, 1, n)) for n in flat.shape)
    surface = scale * (py.T @ of_powers @ px)
    # outside of the lit part a polynomial may do anything
    return np.asarray(np.maximum(surface, 0.02 * scale))


def _powers(y: Floats, x: Floats) -> Floats:
    """Return (terms, rows, cols) products of Legendre polynomials up to the total degree."""
    py, px = _legendre(y), _legendre(x)
    return np.array([np.outer(py[i], px[j]) for i, j in _degrees()])


def _legendre(u: Floats) -> Floats:
    """Return (degrees, n) Legendre polynomials at places from -1 to 1."""
    return np.asarray(np.polynomial.legendre.legvander(u, ILLUMINATION_ORDER).T)


def _degrees() -> list[tuple[int, int]]:
    """Return the degrees in row and column of each term."""
    degrees = range(ILLUMINATION_ORDER + 1)
    return [(i, j) for i in degrees for j in degrees if i + j <= ILLUMINATION_ORDER]


def outliers(values: Floats, among: Bools, least: float = 0.0) -> Bools:
    """Return the pixels `among` that are 8 robust standard deviations, and `least`, from their median."""
    centre = float(np.median(values[among]))
    spread = 1.4826 * float(np.median(np.abs(values[among] - centre)))
    return np.asarray(
        among & (np.abs(values - centre) > max(OUTLIER_SIGMAS * spread, least))
    )
