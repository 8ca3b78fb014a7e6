"""Curves of the report, drawn and as numbers: each channel at best focus, and at and through focus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from labkit.optics.encircled_energy import EncircledEnergy, encircled_energy
from labkit.optics.lens import defocus_waves
from labkit.optics.mtf import Curve, Direction, mtf, pixel_mtf
from labkit.optics.through_focus import (
    FocusDepth,
    ThroughFocus,
    depth_of_focus,
    mtf_through_focus,
    sensor_shift_um,
    strehl_through_focus,
)
from labkit.optics.wavefront import FittedWavefront
from labkit.plan import Sensor
from labkit.results import BestFocus, Results, Wavefront
from labkit.results.verdicts import confirmed
from labkit.types import Floats
from labkit.uncertain import Uncertain

MTF_DIRECTIONS: tuple[Direction, ...] = ("x", "y")


@dataclass(frozen=True, slots=True)
class ChannelFocus:
    """A channel's wavefront nearest to focus, and the pixels of its photographs.

    unsure: the same numbers with unknown errors, where `labkit.results.verdicts.confirmed` has them so; else None.
    """

    photographed: Wavefront
    sensor: Sensor
    unsure: BestFocus | None = None

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.photographed.channel

    @property
    def best(self) -> BestFocus:
        """Numbers at best focus, of the optics alone; unknown errors are nan."""
        return self.photographed.best if self.unsure is None else self.unsure

    @property
    def fitted(self) -> FittedWavefront:
        """The wavefront without defocus."""
        return self.best.fitted

    @property
    def reference_nm(self) -> float:
        """Wavelength of `fitted`'s waves."""
        return self.photographed.reference_wavelength_nm

    @property
    def active_um(self) -> float:
        """Width of a pixel's active area."""
        return self.sensor.active_um

    @property
    def nyquist_per_mm(self) -> float:
        """Nyquist's frequency of the channel's own pixels."""
        return plane_nyquist_per_mm(self.sensor, self.channel)

    def mtf50(self, direction: Direction) -> Uncertain:
        """MTF50 of the optics alone, cycles/mm."""
        return self.best.mtf50(direction)

    def camera_mtf50(self, direction: Direction) -> Uncertain:
        """MTF50 with the pixel, cycles/mm."""
        return self.best.mtf50(direction, self.active_um)

    def at_nyquist(self, direction: Direction) -> Uncertain:
        """MTF of the optics alone at Nyquist's frequency of the channel's own pixels."""
        return self.best.mtf_at(self.nyquist_per_mm, direction)

    def camera_at_nyquist(self, direction: Direction) -> Uncertain:
        """The same with the pixel."""
        pixel = float(pixel_mtf(self.nyquist_per_mm, self.active_um, direction))
        optics = self.at_nyquist(direction)
        return Uncertain(pixel * optics.value, pixel * optics.std)


def at_best_focus(results: Results) -> list[ChannelFocus]:
    """Return, for each channel, the wavefront with the least defocus."""
    sensor = results.plan.sensor
    nearest = [results.nearest_focus(channel) for channel in results.channels]
    return [ChannelFocus(w, sensor, _unsure(w, results)) for w in nearest]


def _unsure(w: Wavefront, results: Results) -> BestFocus | None:
    if confirmed(w, results.wavefronts):
        return None
    fitted = w.at_focus()
    unknown = np.full_like(fitted.covariance, np.nan)
    return BestFocus(
        replace(fitted, covariance=unknown, f_number_std=np.nan, scale_std=np.nan)
    )


def full_nyquist_per_mm(sensor: Sensor) -> float:
    """Nyquist's frequency of all pixels, cycles/mm along rows and columns."""
    return 500.0 / sensor.pixel_pitch_um


def plane_nyquist_per_mm(sensor: Sensor, channel: str) -> float:
    """Return the Nyquist frequency of a channel's pixels: half as high in a filter array of 2 x 2."""
    return full_nyquist_per_mm(sensor) / sensor.pixels(channel).period


DRAWN_CURVE_POINTS = 90
REACH_WAVES = 0.21  # RMS in a channel's own light: beyond, there is no peak to speak of
CURVE_STEPS = 29
NEAREST_CURVE = 1.02  # focal lengths: no nearer target has an image

Place = Callable[[float], float]
"""Where a defocus, waves RMS, stands on an axis: a range in mm, or a shift of the sensor in um."""


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Curves of a channel: MTF with its factors, encircled energy, and both through focus.

    mtf: of the optics along x and y; pixel: of a pixel's active area, along either;
    perfect: of a lens without aberration.
    energy, perfect_energy: at the same radii. place: of a defocus, in a range if in_ranges,
    else a shift of the sensor;
    strehl, modulation: against defocus, the latter at through_per_mm; depth: None where the
    curve does not show it.
    """

    focus: ChannelFocus
    mtf: dict[Direction, Curve]
    pixel: Floats
    perfect: Floats
    energy: EncircledEnergy
    perfect_energy: Floats
    strehl: ThroughFocus
    modulation: dict[Direction, ThroughFocus]
    through_per_mm: float
    depth: FocusDepth | None
    place: Place
    in_ranges: bool

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.focus.channel

    @property
    def places(self) -> Floats:
        """Return where the points through focus stand."""
        return np.array([self.place(float(d)) for d in self.strehl.defocus_waves])

    def placed(self, defocus: Uncertain, focus_std: float = 0.0) -> Uncertain:
        """Return the place of a defocus; its error includes the errors of the cone and of best focus."""
        step = 1e-3
        w = self.focus.fitted
        slope = (self.place(defocus.value + step) - self.place(defocus.value - step)) / (
            2 * step
        )
        std = np.hypot(defocus.std, w.f_number_relative_std * defocus.value)
        return Uncertain(self.place(defocus.value), float(np.hypot(slope * std, focus_std)))


def last_frequency_per_mm(results: Results) -> float:
    """Return where axes of frequency end: at the highest cutoff, or three times Nyquist's frequency."""
    return min(
        3 * full_nyquist_per_mm(results.plan.sensor),
        max(w.fitted.cutoff_per_mm for w in results),
    )


def curves_of(results: Results, focused: list[ChannelFocus]) -> list[Curves]:
    """Return the curves of each channel, on the same axes for all channels."""
    last_per_mm = last_frequency_per_mm(results)
    last_um = max(
        max(
            1.9 * b.best.energy_radius().value,
            3 * b.fitted.wavelength_um * b.fitted.f_number,
        )
        for b in focused
    )
    return [_of_channel(results, best, last_per_mm, last_um) for best in focused]


def _of_channel(
    results: Results, focus: ChannelFocus, last_per_mm: float, last_um: float
) -> Curves:
    fitted = focus.fitted
    frequency = np.linspace(0, last_per_mm, DRAWN_CURVE_POINTS)
    radius = np.linspace(0, last_um, DRAWN_CURVE_POINTS)
    through = full_nyquist_per_mm(results.plan.sensor) / 2
    reach = REACH_WAVES * fitted.wavelength_um / fitted.reference_um
    place = _range_of(results, focus.channel)
    grid = np.linspace(-reach, reach, CURVE_STEPS)
    if place is not None:
        grid = np.array([d for d in grid if np.isfinite(place(float(d)))])
    curve = strehl_through_focus(fitted, grid)
    return Curves(
        focus,
        {d: mtf(fitted, frequency, d) for d in MTF_DIRECTIONS},
        pixel_mtf(frequency, focus.active_um, "x"),
        mtf(focus.best.ideal.fitted, frequency, "x").value,
        encircled_energy(fitted, radius),
        encircled_energy(focus.best.ideal.fitted, radius).value,
        curve,
        {d: mtf_through_focus(fitted, through, d, grid) for d in MTF_DIRECTIONS},
        through,
        depth_of_focus(fitted, curve),
        place or (lambda waves: sensor_shift_um(fitted, waves)),
        place is not None,
    )


def _range_of(results: Results, channel: str) -> Place | None:
    """The stated range at which a channel has a defocus, nan where none has; None where best focus is not known."""
    focus = results.focus
    plan = results.plan
    if focus is None or channel not in focus.best_focus_mm:
        return None
    lens = results.thin_lens
    zero_mm = results.range_zero_mm
    best_mm = focus.best_focus_mm[channel].value + zero_mm
    nearest_mm = NEAREST_CURVE * lens.focal_length_mm
    furthest_mm = 1e3 * best_mm
    if not best_mm > nearest_mm:
        return None

    def defocus(true_mm: float) -> float:
        return float(
            defocus_waves(
                lens, true_mm, best_mm, results.reference_wavelength_nm, plan.fit.convention
            )
        )

    def place(waves: float) -> float:
        if not defocus(nearest_mm) < waves < defocus(furthest_mm):
            return float("nan")
        # ranges as diopters, in which defocus is nearly linear
        return (
            1 / brentq(lambda d: defocus(1 / d) - waves, 1 / furthest_mm, 1 / nearest_mm)
            - zero_mm
        )

    return place
