"""What each channel's optics do at best focus, from the wavefront that was photographed nearest to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.optics.mtf import Direction, pixel_mtf
from labkit.optics.wavefront import FittedWavefront
from labkit.plan import Sensor
from labkit.results import BestFocus, Results, Wavefront
from labkit.results.verdicts import confirmed
from labkit.uncertain import Uncertain

MTF_DIRECTIONS: tuple[Direction, ...] = ("x", "y")


@dataclass(frozen=True, slots=True)
class ChannelFocus:
    """A channel's wavefront nearest to focus, and the pixels that it is photographed with.

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
        """Its numbers at best focus, of the optics alone; their errors are nan where they are not known."""
        return self.photographed.best if self.unsure is None else self.unsure

    @property
    def fitted(self) -> FittedWavefront:
        """The wavefront without defocus."""
        return self.best.fitted

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
    """For each channel, what its wavefront of least defocus is without it."""
    sensor = results.plan.sensor
    nearest = [results.nearest_focus(channel) for channel in results.channels]
    return [ChannelFocus(w, sensor, _unsure(w, results)) for w in nearest]


def _unsure(w: Wavefront, results: Results) -> BestFocus | None:
    if confirmed(w, results.wavefronts):
        return None
    fitted = w.at_focus()
    unknown = np.full_like(fitted.covariance, np.nan)
    return BestFocus(replace(fitted, covariance=unknown, f_number_std=np.nan))


def full_nyquist_per_mm(sensor: Sensor) -> float:
    """Nyquist's frequency of all pixels, cycles/mm along rows and columns."""
    return 500.0 / sensor.pixel_pitch_um


def plane_nyquist_per_mm(sensor: Sensor, channel: str) -> float:
    """That of the pixels of one channel: half as high in a filter array of 2 x 2."""
    return full_nyquist_per_mm(sensor) / sensor.pixels(channel).period
