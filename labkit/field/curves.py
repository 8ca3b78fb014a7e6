"""MTF and focus against image height, sagittal and tangential, with standard errors.

Image heights have a sign and are never folded: a decentred lens differs from side to side.
The MTF is that of the optics alone, without the pixel. The sensor is at the best focus of
the reference channel, as a mean over the field, or moved from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from labkit.arrays import real_array
from labkit.field.places import azimuths_deg, detail_deg, line_end_mm, line_px
from labkit.field.surfaces import Surface, focus_um
from labkit.optics.field import FieldModel
from labkit.optics.mtf import mtf, mtf50
from labkit.types import Floats

USUAL_PER_MM = (10.0, 20.0, 40.0)
"""Frequencies of a usual lens report, cycles/mm."""

PROFILE_PLACES = 21
"""Places along a line through the centre; odd, so that the centre is among them."""


@dataclass(frozen=True, eq=False)
class Band:
    """Values with their standard errors, of one shape."""

    value: Floats
    std: Floats


@dataclass(frozen=True, eq=False)
class Profile:
    """One direction of detail along a line through the frame's centre.

    Parameters
    ----------
    channel : name
    azimuth_deg : of the line, degrees from right towards down
    surface : sagittal or tangential
    frequency_per_mm : (f,)
    height_mm : (n,) from edge to edge, positive along the azimuth
    mtf : (f, n)
    mtf50_per_mm : (n,) lowest frequency at which the MTF is one half
    focus_um : (n,) focus error of the sensor, positive where it lies behind the image
    """

    channel: str
    azimuth_deg: float
    surface: Surface
    frequency_per_mm: Floats
    height_mm: Floats
    mtf: Band
    mtf50_per_mm: Band
    focus_um: Band


def usable_frequencies(
    model: FieldModel, channel: str, wanted_per_mm: Sequence[float] = USUAL_PER_MM
) -> tuple[Floats, tuple[str, ...]]:
    """Return the frequencies (f,) that lens and sensor pass, and a line for each left out."""
    wavelength_um = 1e-3 * model.wavelengths_nm[model.channels.index(channel)]
    most = {
        "cutoff of the lens": 1e3 / (wavelength_um * model.f_number),
        "Nyquist frequency of the sensor": 500 / model.frame.pixel_pitch_um,
    }
    kept = []
    notes = []
    for frequency in wanted_per_mm:
        above = [f"{what}, {end:.0f}" for what, end in most.items() if frequency >= end]
        if above:
            said = f"{frequency:g} cycles/mm is left out in {channel}: above the"
            notes.append(f"{said} {' and the '.join(above)} cycles/mm")
        else:
            kept.append(frequency)
    return np.array(kept, float), tuple(notes)


def profiles(
    model: FieldModel,
    channel: str,
    frequency_per_mm: ArrayLike = USUAL_PER_MM,
    azimuth_deg: Sequence[float] | None = None,
    places: int = PROFILE_PLACES,
    sensor_um: float = 0.0,
) -> tuple[Profile, ...]:
    """Return sagittal and tangential profiles along lines through the centre, from edge to edge of the frame.

    Parameters
    ----------
    azimuth_deg : of the lines; by default `azimuths_deg`
    places : along a line
    sensor_um : movement of the sensor away from the lens
    """
    frequency = real_array("frequency_per_mm", frequency_per_mm, (None,), "cycles/mm")
    lines = azimuths_deg(model.frame) if azimuth_deg is None else azimuth_deg
    return tuple(
        _profile(model, channel, frequency, azimuth, surface, places, sensor_um)
        for azimuth in lines
        for surface in ("sagittal", "tangential")
    )


def _profile(
    model: FieldModel,
    channel: str,
    frequency: Floats,
    azimuth: float,
    surface: Surface,
    places: int,
    sensor_um: float,
) -> Profile:
    """Return one profile."""
    end_mm = line_end_mm(model.frame, azimuth)
    height = np.linspace(-end_mm, end_mm, places)
    at = line_px(model.frame, azimuth, height)
    detail = detail_deg(azimuth, surface)
    found = [model.wavefront(channel, place, sensor_um) for place in at]
    curves = [mtf(wavefront, frequency, detail) for wavefront in found]
    halves = [mtf50(wavefront, detail) for wavefront in found]
    focus, focus_std = focus_um(model, channel, at, surface, azimuth)
    return Profile(
        channel,
        azimuth,
        surface,
        frequency,
        height,
        Band(
            np.array([curve.value for curve in curves]).T,
            np.array([curve.std for curve in curves]).T,
        ),
        Band(
            np.array([half.value for half in halves]),
            np.array([half.std for half in halves]),
        ),
        Band(focus + sensor_um, focus_std),
    )
