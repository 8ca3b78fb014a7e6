"""Laws that connect the observations of a session: one lens, one sensor at rest, one rail (thesis §4.5.2, Appendix E).

Every observation measures modes, numbers of camera parts, ln of the working f-number and ln of the picture's scale. All follow
from a few named parameters of the session, the columns of a least-squares problem; the plan states some of them. A new law
needs a new column (`_columns`) and its derivatives (`_linear`, or an argument of `_laws`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from labkit.estimation.candidate import Reading
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    COMMON_MODE,
    F_NUMBER,
    FOCAL_LENGTH,
    FOCUS,
    GEOMETRY,
    HOMING,
    LATERAL_COLOUR,
    MAGNIFICATION,
    MODE,
    PART,
    PITCH,
    RANGE_ZERO,
    SIZE,
    STEPS,
    WAVELENGTH,
    WORKING_F_NUMBER,
    Column,
    Laws,
    Name,
)
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.imaging.optics import ESTIMATED
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens, defocus_waves
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats, Indices

STEP = 1e-4
"""Relative step of the laws' numerical derivatives: errors by rounding and by curvature are equal, 1e-8."""


@dataclass(frozen=True)
class Layout:
    """Derivatives of all observations that do not depend on the parameters.

    Attributes
    ----------
    linear : (n, values, columns) of the linear part of the values
    local : (n, values, local columns) of the linear part, by the columns of the observation's own group
    arguments, local_arguments : (6, n, columns) of the arguments of the nonlinear laws
    offset : (6, n) arguments for columns that are all 0
    """

    linear: Floats
    local: Floats
    arguments: Floats
    local_arguments: Floats
    offset: Floats


@dataclass(frozen=True)
class LensModel:
    """The laws of a session, for all observations, measured or not.

    Values of an observation, in order: modes of `noll`, numbers of the parts, ln of the working f-number, ln of the scale.
    Columns are parameters of the whole session. Observations of tiles have local columns in addition, one set for each channel
    and tile, which `labkit.estimation.block_solve` eliminates.

    Attributes
    ----------
    readings : rail positions of the n observations; ValueError if two have the same key
    noll : Noll's numbers of the modes, including 4
    parts : labels of the parts' numbers
    stated : the plan's numbers
    laws : tolerances of the laws
    tilt_std : relative error of all sizes due to the target's tilt
    """

    readings: tuple[Reading, ...]
    noll: tuple[int, ...]
    parts: tuple[str, ...]
    stated: Stated
    laws: Laws = field(default_factory=Laws)
    tilt_std: float = 0.0

    def __post_init__(self) -> None:
        times = Counter(reading.key for reading in self.readings)
        if twice := [str(key) for key, count in times.items() if count > 1]:
            raise ValueError(f"{', '.join(twice)}: observed twice; give each key once")

    @property
    def values(self) -> int:
        """Number of values of an observation."""
        return len(self.noll) + len(self.parts) + 2

    @property
    def defocus(self) -> int:
        """Place of defocus among the values."""
        return self.noll.index(DEFOCUS)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in the order of the observations."""
        return tuple(dict.fromkeys(reading.key.channel for reading in self.readings))

    @cached_property
    def reference(self) -> str:
        """Channel whose best focus defines the sensor's position: green if present, else the first."""
        return "G" if "G" in self.channels else self.channels[0]

    @cached_property
    def tiled(self) -> bool:
        """Whether observations are of tiles of the field."""
        return any(reading.key.tile is not None for reading in self.readings)

    @cached_property
    def groups(self) -> Indices:
        """(n,) index of each observation's group: its channel and tile."""
        names = [(r.key.channel, r.key.tile) for r in self.readings]
        places = {name: k for k, name in enumerate(dict.fromkeys(names))}
        return np.array([places[name] for name in names], dtype=np.intp)

    def by_group(self, rows: Floats) -> Floats:
        """Sum rows (n, ...) over the observations of each group, (groups, ...)."""
        order, first = self._group_order
        return np.asarray(
            np.add.reduceat(rows if order is None else rows[order], first, axis=0)
        )

    @cached_property
    def _group_order(self) -> tuple[Indices | None, Indices]:
        """Order that sorts observations by group, None if they are sorted, and the place where each group begins."""
        order = np.argsort(self.groups, kind="stable")
        first = np.flatnonzero(np.diff(self.groups[order], prepend=-1))
        return None if np.array_equal(order, np.arange(len(order))) else order, first

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Parameters of the whole session."""
        return tuple(self._widened(column) for column in self._columns())

    @cached_property
    def local_columns(self) -> tuple[Column, ...]:
        """Parameters of each channel and tile; empty for sessions without tiles."""
        if not self.tiled:
            return ()
        far = max(reading.range_mm for reading in self.readings)
        return (
            Column(FOCUS, (), 0.0, SETTINGS.colour_std * far, 1e-3 * far),
            Column(LATERAL_COLOUR, (), 0.0, SETTINGS.loose, 1e-4),
            *(Column(MODE, (j,), 0.0, SETTINGS.unknown, 1e-2) for j in self._upper_modes),
        )

    @cached_property
    def centre(self) -> Floats:
        """(columns,) means of the prior."""
        return np.array([column.value for column in self.columns])

    @cached_property
    def prior_std(self) -> Floats:
        """(columns,) standard errors of the prior."""
        return np.array([column.prior_std for column in self.columns])

    @cached_property
    def local_std(self) -> Floats:
        """(local columns,) standard errors of the prior, whose mean is 0."""
        return np.array([column.prior_std for column in self.local_columns])

    @cached_property
    def _places(self) -> dict[tuple[str, Name], int]:
        return {(column.kind, column.name): k for k, column in enumerate(self.columns)}

    def index(self, kind: str, *name: str | float) -> int:
        """Return the place of a column; raise KeyError for a column that the session does not have."""
        return self._places[kind, name]

    def best_focus(self, channel: str) -> Floats:
        """Return best focus of a channel as a linear combination (columns,)."""
        combination = np.zeros(len(self.columns))
        combination[self.index(FOCUS)] = 1.0
        if channel != self.reference:
            combination[self.index(AXIAL_COLOUR, channel)] = 1.0
        return combination

    def of_channel(self, label: str, channel: str) -> Name:
        """Return the column name of a part's number: common to all channels, or of one channel."""
        return (label, channel) if ESTIMATED[label.split(".")[0]].per_channel else (label,)

    def bounds(self) -> tuple[Floats, Floats]:
        """Return least and largest values, (columns,) each."""
        low = np.full(len(self.columns), -np.inf)
        high = np.full(len(self.columns), np.inf)
        for at in (self.index(FOCAL_LENGTH), self.index(F_NUMBER)):
            low[at], high[at] = 0.25 * self.centre[at], 4 * self.centre[at]
        at = self.index(MAGNIFICATION)
        low[at], high[at] = np.log(SETTINGS.magnification_bounds)
        low[self.index(FOCUS)] = 1.05 * self.centre[self.index(FOCAL_LENGTH)]
        return low, high

    def scatter(self) -> Floats:
        """Return variances (values,) of an observation about the laws."""
        variance = np.zeros(self.values)
        variance[: len(self.noll)] = self.laws.mode_scatter**2
        variance[self.defocus] = self.laws.defocus_scatter**2
        variance[-2] = self.laws.f_number_scatter**2
        variance[-1] = self.laws.size_scatter**2
        return variance

    def lens(self, theta: Floats) -> ThinLens:
        """Return the lens for parameters (columns,)."""
        focal_mm, f_number, pupils = (
            float(theta[self.index(kind)]) for kind in GEOMETRY[:3]
        )
        return ThinLens(focal_mm, f_number, float(np.exp(pupils)))

    def true(self, theta: Floats, local: Floats) -> Floats:
        """Return values (n, values) for theta (columns,) and local (groups, local columns).

        Errors of stated wavelengths and of the stated pixel pitch change what is measured, not these values.
        """
        layout = self._layout
        own = local[self.groups]
        true = layout.linear @ theta + np.einsum("nvl,nl->nv", layout.local, own)
        true[:, self._law_rows] += self._laws(self._arguments(theta, own)).T
        return np.asarray(true)

    def predicted(self, theta: Floats, local: Floats) -> Floats:
        """Predict the measurements (n, values), for parameters as in `true`.

        Light of a longer wavelength than stated makes the same picture as stated light through a cone narrower by the same
        ratio, with path differences smaller by the same ratio: N grows with the wavelength's error, the modes shrink. If the
        stated pitch is too large, so are N and the scale, by the same ratio.
        """
        seen = self.true(theta, local)
        longer = theta[self._wavelengths] + (theta[-1] if self._light_mistaken else 0.0)
        seen[:, : len(self.noll)] *= np.exp(-longer)[:, None]
        seen[:, -2] += longer
        if self._pitch_mistaken:
            seen[:, -2:] += theta[-1]
        return seen

    def slopes(self, theta: Floats, local: Floats) -> tuple[Floats, Floats]:
        """Return derivatives of `predicted`: (n, values, columns), and (n, values, local columns)."""
        layout = self._layout
        by_argument = self._law_slopes(self._arguments(theta, local[self.groups]))
        whole = layout.linear.copy()
        whole[:, self._law_rows] += np.einsum("lan,anc->nlc", by_argument, layout.arguments)
        own = layout.local.copy()
        own[:, self._law_rows] += np.einsum(
            "lan,anc->nlc", by_argument, layout.local_arguments
        )
        common = theta[-1] if self._light_mistaken else 0.0
        shrunk = np.exp(-theta[self._wavelengths, None, None] - common)
        modes = slice(0, len(self.noll))
        whole[:, modes] *= shrunk
        own[:, modes] *= shrunk
        n = np.arange(len(self.readings))
        if self._pitch_mistaken:
            whole[:, -2:, -1] = 1.0
        by_wavelength = np.zeros((len(n), self.values))
        by_wavelength[:, modes] = -self.predicted(theta, local)[:, modes]
        by_wavelength[:, -2] = 1.0
        whole[n, :, self._wavelengths] = by_wavelength
        if self._light_mistaken:
            whole[:, :, -1] = by_wavelength
        return whole, own

    def true_slopes(self, slopes: Floats) -> Floats:
        """Return slopes (n, values, columns) of `true` from those of `predicted`."""
        slopes = slopes.copy()
        slopes[np.arange(len(slopes)), :, self._wavelengths] = 0.0
        if self._pitch_mistaken or self._light_mistaken:
            slopes[:, :, -1] = 0.0
        return slopes

    @property
    def _upper_modes(self) -> list[int]:
        return [j for j in self.noll if j != DEFOCUS]

    @property
    def _law_rows(self) -> list[int]:
        """Places of defocus, ln of the f-number and ln of the scale, which follow nonlinear laws."""
        return [self.defocus, self.values - 2, self.values - 1]

    @cached_property
    def _wavelengths(self) -> Indices:
        """(n,) place of each observation's wavelength column."""
        return np.array(
            [self.index(WAVELENGTH, r.key.channel) for r in self.readings], dtype=np.intp
        )

    @property
    def _pitch_mistaken(self) -> bool:
        """Whether the pitch is a parameter: the last column. A stated pitch that is no mistake is exact."""
        return self.laws.mistaken == (PITCH, ())

    @property
    def _light_mistaken(self) -> bool:
        """Whether a common factor of all wavelengths is a parameter: the last column."""
        return self.laws.mistaken == (WAVELENGTH, ())

    def _widened(self, column: Column) -> Column:
        """Return the column, with the error of a mistake if the laws call its number mistaken."""
        if (column.kind, column.name) != self.laws.mistaken:
            return column
        unit = {
            FOCAL_LENGTH: column.value,
            F_NUMBER: column.value,
            RANGE_ZERO: max(reading.range_mm for reading in self.readings),
        }
        return replace(column, std=SETTINGS.mistake * unit.get(column.kind, 1.0))

    def _columns(self) -> Iterator[Column]:
        stated = self.stated
        far = max(reading.range_mm for reading in self.readings)
        focal, f_number = stated.focal_length, stated.f_number
        yield Column(FOCAL_LENGTH, (), focal.value, focal.std, 1e-2 * focal.value)
        yield Column(F_NUMBER, (), f_number.value, f_number.std, 1e-2 * f_number.value)
        yield Column(MAGNIFICATION, (), 0.0, USUAL_LOG_MAGNIFICATION, 0.1)
        yield Column(RANGE_ZERO, (), 0.0, stated.range_zero_std_mm, 1e-3 * far)
        yield Column(SIZE, (), 0.0, float(np.hypot(stated.size_std, self.tilt_std)), 1e-4)
        yield Column(WORKING_F_NUMBER, (), 0.0, self.laws.f_number_std, 1e-2)
        homings = sorted(
            {homing for reading in self.readings for homing in reading.homings}
        )
        for homing in homings[1:]:
            yield Column(HOMING, (homing,), 0.0, stated.homing_std_mm, 1e-2)
        for station in sorted({reading.station for reading in self.readings}):
            yield Column(STEPS, (station,), 0.0, stated.range_std_mm, 1e-2)
        yield Column(FOCUS, (), far, 100 * far, 1e-3 * far)
        for channel in self.channels:
            error = stated.wavelength_std.get(channel, 0.0)
            yield Column(WAVELENGTH, (channel,), 0.0, error, 1e-3)
            if channel != self.reference:
                axial = SETTINGS.colour_std * far
                yield Column(AXIAL_COLOUR, (channel,), 0.0, axial, 1e-3 * far)
                yield Column(LATERAL_COLOUR, (channel,), 0.0, SETTINGS.colour_std, 1e-4)
        names = (self.of_channel(label, c) for c in self.channels for label in self.parts)
        for name in dict.fromkeys(names):
            yield Column(PART, name, 0.0, SETTINGS.unknown, 1e-3)
        yield from () if self.tiled else self._mode_columns()
        if self._pitch_mistaken:  # last, so that the other columns keep their places
            yield Column(PITCH, (), 0.0, 0.0, 1e-4)
        if self._light_mistaken:
            yield Column(WAVELENGTH, (), 0.0, 0.0, 1e-3)

    def _mode_columns(self) -> Iterator[Column]:
        for j in self._upper_modes:
            yield Column(COMMON_MODE, (j,), 0.0, SETTINGS.unknown, 1e-2)
            for channel in self.channels:
                yield Column(MODE, (channel, j), 0.0, SETTINGS.colour_modes_std, 1e-2)

    @cached_property
    def _layout(self) -> Layout:
        n, own = len(self.readings), len(self.local_columns)
        size = len(self.columns)
        layout = Layout(
            np.zeros((n, self.values, size)),
            np.zeros((n, self.values, own)),
            np.zeros((6, n, size)),
            np.zeros((6, n, own)),
            np.zeros((6, n)),
        )
        layout.offset[3] = [reading.range_mm for reading in self.readings]
        by_channel = {channel: self._linear(channel) for channel in self.channels}
        for k, reading in enumerate(self.readings):
            layout.linear[k] = by_channel[reading.key.channel]
            layout.arguments[:, k] = self._argument_slopes(reading)
        if own:
            layout.local_arguments[4, :, 0] = 1.0
            layout.local[:, -1, 1] = 1.0
            for column, j in enumerate(self._upper_modes, 2):
                layout.local[:, self.noll.index(j), column] = 1.0
        return layout

    def _linear(self, channel: str) -> Floats:
        """Return derivatives (values, columns) of the linear part of a channel's observations."""
        rows = np.zeros((self.values, len(self.columns)))
        rows[-2, self.index(WORKING_F_NUMBER)] = 1.0
        rows[-1, self.index(SIZE)] = 1.0
        if channel != self.reference:
            rows[-1, self.index(LATERAL_COLOUR, channel)] = 1.0
        for row, j in enumerate(self.noll):
            if j != DEFOCUS and not self.tiled:
                rows[row, self.index(COMMON_MODE, j)] = 1.0
                rows[row, self.index(MODE, channel, j)] = 1.0
        for row, label in enumerate(self.parts, len(self.noll)):
            rows[row, self.index(PART, *self.of_channel(label, channel))] = 1.0
        return rows

    def _argument_slopes(self, reading: Reading) -> Floats:
        """Return derivatives (6, columns) of f, N, ln mp, true range, best focus of the channel and of the reference."""
        slopes = np.zeros((6, len(self.columns)))
        for row, kind in enumerate(GEOMETRY[:3]):
            slopes[row, self.index(kind)] = 1.0
        slopes[3:, self.index(RANGE_ZERO)] = 1.0
        slopes[3, self.index(STEPS, reading.station)] = 1.0
        for homing in dict.fromkeys(reading.homings):
            if (
                column := self._places.get((HOMING, (homing,)))
            ) is not None:  # all but the first
                slopes[3, column] = reading.homings.count(homing) / len(reading.homings)
        slopes[4] += self.best_focus(reading.key.channel)
        slopes[5] += self.best_focus(self.reference)
        return slopes

    def _arguments(self, theta: Floats, own: Floats) -> Floats:
        """Return the laws' arguments (6, n). own: (n, local columns)."""
        layout = self._layout
        local = np.einsum("anl,nl->an", layout.local_arguments, own)
        return np.asarray(layout.offset + layout.arguments @ theta + local)

    def _laws(self, arguments: Floats) -> Floats:
        """Return defocus in waves RMS, ln of the working f-number and ln of the scale, (3, ...), for arguments (6, ...)."""
        f, n, pupils = arguments[:3]
        lens = ThinLens(
            *cast(tuple[float, float, float], (f, n, np.exp(pupils)))
        )  # arrays of lenses
        ranges, focus, reference = np.maximum(arguments[3:], 1.01 * f)
        colour = lens.in_colour(focus, reference)
        ranges = np.maximum(ranges, 1.01 * colour.focal_length_mm)
        return np.stack(
            [
                defocus_waves(
                    colour, ranges, focus, self.stated.reference_nm, self.stated.convention
                ),
                np.log(colour.working_f_number(focus)),
                np.log(lens.chief_ray_scale(ranges, reference)),
            ]
        )

    def _law_slopes(self, arguments: Floats) -> Floats:
        """Differentiate the laws by their arguments, (3, 6, n), by central differences."""
        steps = STEP * np.maximum(np.abs(arguments), 0.1)
        moves = steps[:, None] * np.eye(len(steps))[:, :, None]
        ahead = self._laws(arguments[:, None] + moves)
        behind = self._laws(arguments[:, None] - moves)
        return np.asarray((ahead - behind) / (2 * steps))
