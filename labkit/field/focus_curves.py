"""MTF against the sensor's position at points of the field, sagittal and tangential, with standard errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, isnan, nan, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from labkit.arrays import real_array
from labkit.field.curves import USUAL_PER_MM, Band
from labkit.field.places import azimuth_of, detail_deg, field_points
from labkit.field.surfaces import Surface, focus_um
from labkit.optics.field import FieldModel
from labkit.optics.through_focus import ThroughFocus, mtf_through_focus
from labkit.optics.wavefront import DEFOCUS, FittedWavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

POSITIONS = 41
"""Positions of the sensor in a curve."""

REACH_PER_NUMBER = 6.0
"""Reach of curves beyond the best focus of all places, um, for each unit of the f-number squared."""

FREQUENCY_STEP = 1e-4
"""Relative, of the MTF's derivative by frequency."""

TILTS_AND_FOCUS = (2, 3, DEFOCUS)
"""Noll's modes that `mtf_through_focus` leaves out."""


@dataclass(frozen=True, eq=False)
class FocusCurve:
    """MTF of one direction of detail at a place against the sensor's position.

    Parameters
    ----------
    channel, place : names
    surface : sagittal or tangential
    frequency_per_mm : of the MTF
    shift_um : (n,) movement of the sensor away from the lens
    mtf : (n,)
    best_um : movement that gives the highest MTF; nan if that is not within the curve
    """

    channel: str
    place: str
    surface: Surface
    frequency_per_mm: float
    shift_um: Floats
    mtf: Band
    best_um: Uncertain


def through_focus(
    model: FieldModel,
    channel: str,
    frequency_per_mm: ArrayLike = USUAL_PER_MM,
    points: Mapping[str, Floats] | None = None,
    shift_um: ArrayLike | None = None,
) -> tuple[FocusCurve, ...]:
    """Return the MTF against the sensor's position, sagittal and tangential, at points of the field.

    Parameters
    ----------
    points : places (row, column) by name; by default `field_points`
    shift_um : (n,) ascending movements of the sensor away from the lens; by default about
        the mean of the points' best focus
    """
    frequency = real_array("frequency_per_mm", frequency_per_mm, (None,), "cycles/mm")
    points = field_points(model.frame) if points is None else points
    if shift_um is None:
        shift_um = _usual_shifts(model, channel, list(points.values()))
    shift = real_array("shift_um", shift_um, (None,), "um")
    return tuple(
        _focus_curve(model, channel, name, place, surface, float(f), shift)
        for name, place in points.items()
        for surface in ("sagittal", "tangential")
        for f in frequency
    )


def _usual_shifts(model: FieldModel, channel: str, places: Sequence[Floats]) -> Floats:
    """Return positions of the sensor that reach beyond the best focus of every place."""
    best = -focus_um(model, channel, np.array(places))[0]
    reach = REACH_PER_NUMBER * model.f_number**2
    return np.linspace(best.min() - reach, best.max() + reach, POSITIONS)


def _focus_curve(
    model: FieldModel,
    channel: str,
    name: str,
    place: Floats,
    surface: Surface,
    frequency: float,
    shift: Floats,
) -> FocusCurve:
    """Return one curve, with errors that include those of the focus at the place and of the cone."""
    wavefront = model.wavefront(channel, place)
    detail = detail_deg(azimuth_of(model.frame, place), surface)
    own = wavefront.waves[wavefront.index(DEFOCUS)]
    away = shift / model.um_per_wave
    curve, above = (
        mtf_through_focus(wavefront, frequency * factor, detail, own + away)
        for factor in (1.0, 1 + FREQUENCY_STEP)
    )
    # a slower cone has a lower cutoff, and more um for each wave
    by_cone = (above.value - curve.value) / FREQUENCY_STEP - 2 * away * curve.slope
    of_modes = _gradient(wavefront, curve.slopes, curve.slope)
    relative = wavefront.f_number_relative_std
    std = np.sqrt(wavefront.variance(of_modes) + (relative * by_cone) ** 2)
    top = _top(curve)
    top_by_cone = (_top(above) - top) / FREQUENCY_STEP + 2 * (top - own)
    best_std = hypot(_top_std(wavefront, curve, top), relative * top_by_cone)
    return FocusCurve(
        channel,
        name,
        surface,
        frequency,
        shift,
        Band(curve.value, std),
        Uncertain(model.um_per_wave * (top - own), model.um_per_wave * best_std, "um"),
    )


def _gradient(wavefront: FittedWavefront, others: Floats, focus: Floats) -> Floats:
    """Return the derivatives (modes, ...) by all modes of a wavefront, tilts' being zero."""
    gradient = np.zeros((len(wavefront.noll), *np.shape(focus)))
    kept = [j not in TILTS_AND_FOCUS for j in wavefront.noll]
    gradient[kept] = others
    gradient[wavefront.index(DEFOCUS)] = focus
    return gradient


def _top(curve: ThroughFocus) -> float:
    """Return the defocus of the highest MTF within a curve, waves; nan if the curve has no peak."""
    spline = CubicHermiteSpline(curve.defocus_waves, curve.value, curve.slope)
    turns = spline.derivative().roots(extrapolate=False)
    tops = [float(at) for at in turns if spline(at, 2) < 0]
    return max(tops, key=spline, default=nan)


def _top_std(wavefront: FittedWavefront, curve: ThroughFocus, top: float) -> float:
    """Return the standard error by the modes of the defocus of the highest MTF less that of the place."""
    if isnan(top):
        return inf
    slope, *slopes = CubicSpline(
        curve.defocus_waves, np.vstack([curve.slope, curve.slopes]), axis=1
    )(top, 1)
    gradient = _gradient(wavefront, -np.array(slopes) / slope, np.array(-1.0))
    return sqrt(wavefront.variance(gradient))
