"""Defocus over the inverse range, which is nearly a straight line: its slope, and where it crosses zero."""

from __future__ import annotations

import numpy as np

from labkit.estimation.lens_model import LensModel
from labkit.types import Floats


def focus_slope(model: LensModel) -> float:
    """Return the slope of a thin lens's defocus, waves RMS, over 1/(range - f), 1/mm."""
    focal_mm, f_number = model.stated.focal_length.value, model.stated.f_number.value
    reference_mm = model.stated.reference_nm * 1e-6
    return float(-(focal_mm**2) / (8 * f_number**2 * np.sqrt(12) * reference_mm))


def crossing(ranges_mm: Floats, waves: Floats, model: LensModel) -> Floats:
    """Return the ranges (...,) of zero defocus, mm, by straight lines through defocus over 1/(range - f).

    Parameters
    ----------
    ranges_mm : (m,)
    waves : (..., m) defocus, waves RMS
    model : has the stated focal length and f-number
    """
    focal_mm = model.stated.focal_length.value
    at = 1 / (ranges_mm - focal_mm)
    inverse = np.mean(at - waves / focus_slope(model), axis=-1)
    away = at - at.mean()
    if np.ptp(ranges_mm) > 0:
        slope = waves @ away / (away @ away)
        falling = np.where(slope < 0, slope, -np.inf)
        own = at.mean() - np.mean(waves, axis=-1) / falling
        inverse = np.where(slope < 0, own, inverse)
    low = 1 / (3 * ranges_mm.max() - focal_mm)
    high = 1 / max(ranges_mm.min() / 3 - focal_mm, 0.5 * focal_mm)
    return np.asarray(1 / np.clip(inverse, low, high) + focal_mm)
