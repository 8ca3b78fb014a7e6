"""The pixels of the simulated sensor: their response to light, hot and dead ones, and noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.image import MOST_AT_ONCE
from labkit.drivers.simulated.view import per_tangent_mm
from labkit.drivers.simulated.world import BenchSettings, TrueSensor
from labkit.types import Counts, Floats, Floats32

STRIP_ROWS = 640
"""Noise and even light of a larger sensor are drawn in strips."""

Cut = tuple[slice, slice]
"""Rows and columns of the sensor."""


class PixelArray:
    """The sensor with its constant properties, drawn at birth."""

    def __init__(self, settings: BenchSettings, rng: np.random.Generator) -> None:
        sensor = settings.sensor
        self._sensor = sensor
        shape = sensor.rows, sensor.cols
        # a whole frame has no room for double precision
        kind = np.float32 if settings.room else np.float64
        per_s = np.empty(shape, dtype=kind)
        for rows in strips(sensor.rows):
            drawn = rng.normal(size=per_s[rows].shape)
            per_s[rows] = sensor.white_electrons_per_s * (1 + sensor.response_std * drawn)
        bad = rng.choice(per_s.size, sensor.hot_pixels + sensor.dead_pixels, replace=False)
        hot, dead = np.split(bad, [sensor.hot_pixels])
        per_s.flat[dead] *= rng.uniform(0, 0.4, dead.size).astype(kind)
        self._hot = hot // sensor.cols, hot % sensor.cols
        self._hot_electrons_per_s = 10 ** rng.uniform(4.3, 5.6, hot.size)
        for rows in strips(sensor.rows):
            _share_colours(per_s[rows], sensor)
            per_s[rows] *= vignette(settings, rows)
        if max(shape) > MOST_AT_ONCE:
            per_s = per_s.astype(np.float32, copy=False)
        self._white_electrons_per_s = per_s

    def counts(
        self,
        light: Floats32 | None,
        cut: Cut,
        exposure_s: float,
        iso: int,
        rng: np.random.Generator,
    ) -> Counts:
        """Return the counts of a cut, (rows, cols), with shot noise by Poisson's law.

        light: of each pixel of the cut in its own colour, white = 1; None for a covered
        lens.
        """
        sensor = self._sensor
        first = cut[0].start
        shape = cut[0].stop - first, cut[1].stop - cut[1].start
        counts = np.empty(shape, dtype=np.uint16)
        for rows in strips(shape[0]):
            here = slice(first + rows.start, first + rows.stop), cut[1]
            per_s = self._hot_in(here)
            if light is not None:
                per_s += self._white_electrons_per_s[here] * light[rows]
            electrons = rng.poisson(per_s * exposure_s) + rng.normal(
                0, sensor.read_noise_electrons, per_s.shape
            )
            exact = sensor.black_level + electrons * sensor.counts_per_electron * iso / 100
            counts[rows] = np.clip(np.rint(exact), 0, sensor.white_level)
        return counts

    def rough_counts(
        self,
        light: Floats32 | None,
        cut: Cut,
        exposure_s: float,
        iso: int,
        rng: np.random.Generator,
    ) -> Counts:
        """Return counts as `counts` does, with all noise by Gauss's law, in a tenth of the time."""
        sensor = self._sensor
        electrons = self._hot_in(cut).astype(np.float32)
        if light is not None:
            electrons += self._white_electrons_per_s[cut] * light
        electrons *= np.float32(exposure_s)
        noise = rng.standard_normal(electrons.shape, dtype=np.float32)
        noise *= np.sqrt(electrons + np.float32(sensor.read_noise_electrons**2))
        electrons += noise
        electrons *= np.float32(sensor.counts_per_electron * iso / 100)
        # whole numbers by cutting: half a count more rounds
        electrons += np.float32(sensor.black_level + 0.5)
        return np.clip(electrons, 0, sensor.white_level, out=electrons).astype(np.uint16)

    def _hot_in(self, cut: Cut) -> Floats:
        """Return electrons per second without light, (rows, cols) of a cut."""
        rows, cols = cut
        down = self._hot[0] - rows.start
        right = self._hot[1] - cols.start
        shape = rows.stop - rows.start, cols.stop - cols.start
        inside = (down >= 0) & (down < shape[0]) & (right >= 0) & (right < shape[1])
        electrons_per_s = np.zeros(shape)
        electrons_per_s[down[inside], right[inside]] = self._hot_electrons_per_s[inside]
        return electrons_per_s


def strips(rows: int) -> list[slice]:
    """Return slices of at most STRIP_ROWS rows, in order."""
    return [slice(top, min(top + STRIP_ROWS, rows)) for top in range(0, rows, STRIP_ROWS)]


def _share_colours(per_s: NDArray[np.floating], sensor: TrueSensor) -> None:
    """Scale some rows' response, from an even row on, by the share of each pixel's colour, in place."""
    if sensor.pattern == "mono":
        return
    for place, colour in enumerate(sensor.pattern):
        per_s[place // 2 :: 2, place % 2 :: 2] *= sensor.colour_response.get(colour, 1.0)


def vignette(settings: BenchSettings, rows: slice) -> Floats:
    """Return the light at each pixel of some rows, falling with the square of the distance from a point near the
    middle.
    """
    sensor = settings.sensor
    lens = settings.lens
    y = np.linspace(-1, 1, sensor.rows)[rows, None] - 0.06
    x = np.linspace(-1, 1, sensor.cols)[None, :] + 0.04
    even = 1 - lens.vignetting * (x * x + y * y) / 2
    of_field = lens.field_terms.light(
        (sensor.rows, sensor.cols),
        sensor.pitch_um * 1e-3,
        lens.pupil,
        per_tangent_mm(lens),
        rows,
    )
    return np.asarray(even * of_field)
