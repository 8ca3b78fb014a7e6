"""Laws that connect the observations of a session: one lens, one sensor at rest, one rail (thesis §4.5.2, Appendix E).

Every observation measures modes, numbers of camera parts, ln of the working f-number and ln of the picture's scale. All follow
from a few named parameters of the session, the columns of a least-squares problem; the plan states some of them. A new law
needs a new column (`_columns`) and its derivatives: an entry of `_channel_map`, or a term of `_laws`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from labkit.estimation.candidate import Reading
from labkit.estimation.field_terms import (
    TARGET_SLOPES,
    Family,
    coefficient,
    common_columns,
    mode_columns,
    own_columns,
    polynomials,
    usual_order,
)
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    COMMON_MODE,
    F_NUMBER,
    FIELD_TILT,
    FOCAL_LENGTH,
    FOCUS,
    GEOMETRY,
    HOMING_LABEL,
    LATERAL_COLOUR,
    MAGNIFICATION,
    MODE,
    PART,
    PIXEL_PITCH,
    RANGE_ZERO,
    SIZE,
    STEPS_LABEL,
    WAVELENGTH,
    WEAK_MODE,
    WORKING_F_NUMBER,
    Column,
    Laws,
    Name,
    Place,
)
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.estimation.tilted_target import TiltedTarget
from labkit.imaging.parts import ESTIMATED
from labkit.key import Key
from labkit.optics.field import field_terms
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens, defocus_waves
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Bools, Floats, Indices

ARGUMENTS = 8
"""Number of arguments of the nonlinear laws."""

DERIVATIVE_STEP = 1e-3
"""Step of numerical derivatives by an argument over its size, or over 1 if it is smaller: slopes err by 1e-9 at most."""


@dataclass(frozen=True)
class LensModel:
    """The laws of a session, for all observations, measured or not.

    Values of an observation, in order: modes of `noll`, numbers of the parts, ln of the working f-number, ln of the scale.
    All tiles of a channel at a station are one exposure: the laws give it a polynomial over the field for each value, a
    constant where there are no tiles. Its coefficients, (values, terms), follow from the columns, which are parameters of the
    whole session. `labkit.estimation.field_terms` adds those of the field, and local columns: a set for each channel, which
    `labkit.estimation.block_solve` eliminates.

    Attributes
    ----------
    readings : rail positions of the n observations; ValueError if two have the same key
    noll : Noll's numbers of the modes, including 4
    parts : labels of the parts' numbers
    stated : the plan's numbers
    laws : tolerances of the laws
    tilt_std : relative error of all sizes due to the target's tilt
    spread : standard deviations of families of columns, where they differ from those before the session
    weak : standard deviations before the session of modes for which no photograph calls, by Noll's number
    """

    readings: tuple[Reading, ...]
    noll: tuple[int, ...]
    parts: tuple[str, ...]
    stated: Stated
    laws: Laws = field(default_factory=Laws)
    tilt_std: float = 0.0
    spread: Mapping[Family, float] = field(default_factory=dict)
    weak: Mapping[int, float] = field(default_factory=dict)

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
    def rows(self) -> dict[Key, int]:
        """Place of each observation, by its key."""
        return {reading.key: k for k, reading in enumerate(self.readings)}

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
        """Return whether observations are of tiles of the field."""
        return any(reading.key.tile is not None for reading in self.readings)

    @cached_property
    def field_order(self) -> int:
        """Radial order of the field's expansion; 0 for sessions without tiles."""
        if not self.tiled:
            return 0
        tiles = len({reading.key.tile for reading in self.readings})
        stated = self.stated.field_order
        return usual_order(tiles) if stated is None else stated

    @cached_property
    def groups(self) -> Indices:
        """(n,) index of each observation's group: its channel and tile. Defocus of a group changes its sign once over range."""
        return _numbered((r.key.channel, r.key.tile) for r in self.readings)

    @cached_property
    def terms(self) -> int:
        """Number of terms over the field."""
        return len(field_terms(self.field_order))

    @cached_property
    def exposures(self) -> Indices:
        """(n,) index of each observation's exposure: observations that differ in their tiles only."""
        return _numbered(
            (r.key.range_mm, r.key.channel, r.range_mm, r.station, r.homings)
            for r in self.readings
        )

    @cached_property
    def _exposed(self) -> list[Reading]:
        """One reading of each exposure."""
        first = np.unique(self.exposures, return_index=True)[1]
        return [self.readings[k] for k in first]

    @cached_property
    def polynomials(self) -> Floats:
        """(n, values, terms) derivatives of each value by its own coefficients."""
        places = np.array([reading.place for reading in self.readings])
        return polynomials(self.field_order, places, self.noll, self.values)

    def seen(self, coefficients: Floats, at: Indices | slice = slice(None)) -> Floats:
        """Return values (n, values, ...) of observations for coefficients (exposures, values x terms, ...)."""
        shape = (len(coefficients), self.values, self.terms, *coefficients.shape[2:])
        here = coefficients.reshape(shape)[self.exposures[at]]
        return np.asarray(np.einsum("nvt,nvt...->nv...", self.polynomials[at], here))

    @cached_property
    def blocks(self) -> Indices:
        """(exposures,) index of each exposure's block, which has local columns: its channel."""
        return _numbered(reading.key.channel for reading in self._exposed)

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Parameters of the whole session."""
        return tuple(self._widened(column) for column in self._columns())

    @cached_property
    def local_columns(self) -> tuple[Column, ...]:
        """Parameters of each channel for itself; empty for sessions without tiles, or with one channel."""
        if len(self.channels) < 2:
            return ()
        return tuple(own_columns(self.field_order, self.noll, self.spread))

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

    def column(self, kind: str, *name: str | float) -> Floats:
        """Return a parameter as a linear combination (columns,)."""
        return np.asarray(np.eye(len(self.columns))[self.index(kind, *name)])

    def best_focus(self, channel: str) -> Floats:
        """Return best focus of a channel as a linear combination (columns,)."""
        if channel == self.reference:
            return self.column(FOCUS)
        return self.column(FOCUS) + self.column(AXIAL_COLOUR, channel)

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
        variance = self.mode_scatter()
        variance[self.defocus] = self.laws.defocus_scatter**2
        variance[-2] = self.laws.f_number_scatter**2
        variance[-1] = self.laws.size_scatter**2
        return variance

    def mode_scatter(self) -> Floats:
        """Return variances (values,) of an observation's modes, except defocus, about those of the session."""
        variance = np.zeros(self.values)
        variance[: len(self.noll)] = self.laws.mode_scatter**2
        variance[self.defocus] = 0.0
        return variance

    def predicted(self, theta: Floats, local: Floats) -> Floats:
        """Predict the measurements (n, values), for theta (columns,) and local (blocks, local columns)."""
        return self.seen(self.coefficients(theta, local))

    def true(self, theta: Floats, local: Floats) -> Floats:
        """Return values (n, values) as predicted for light and a pitch as stated: their errors change what is measured only."""
        return self.predicted(np.where(self._apparent, 0.0, theta), local)

    def coefficients(self, theta: Floats, local: Floats) -> Floats:
        """Predict each exposure's coefficients (exposures, values x terms) over the field.

        Light of a longer wavelength than stated makes the same picture as stated light through a cone narrower by the same
        ratio, with path differences smaller by the same ratio: N grows with the wavelength's error, the modes shrink. If the
        stated pitch is too large, so are N and the scale, by the same ratio.
        """
        size = self.values * self.terms
        coefficients, arguments = np.split(self._sums(theta, local), [size], axis=1)
        coefficients[:, self._law_rows] += self._laws(arguments.T).T
        coefficients[:, self._of_modes] *= np.exp(-(self.longer @ theta))[:, None]
        return coefficients

    def slopes(self, theta: Floats, local: Floats) -> tuple[Floats, Floats]:
        """Return derivatives of `coefficients` by the columns and by the local columns, (exposures, values x terms, ...)."""
        size = self.values * self.terms
        by_argument = self._law_slopes(self._sums(theta, local)[:, size:].T)
        shrunk = np.exp(-(self.longer @ theta))[:, None, None]

        def chained(rows: Floats) -> Floats:
            slopes = rows[:, :size].copy()
            arguments = rows[:, size:]
            slopes[:, self._law_rows] += np.einsum("lan,nac->nlc", by_argument, arguments)
            slopes[:, self._of_modes] *= shrunk
            return slopes

        whole, own = map(chained, self._map[1:])
        modes = self.coefficients(theta, local)[:, self._of_modes, None]
        whole[:, self._of_modes] -= modes * self.longer[:, None]
        return whole, own

    def true_slopes(self, slopes: Floats) -> Floats:
        """Return slopes (..., columns) of `true` from those of `predicted`."""
        return np.where(self._apparent, 0.0, slopes)

    @property
    def _law_rows(self) -> list[int]:
        """Coefficients that follow nonlinear laws: defocus and ln of the f-number in the middle, and all of ln of the scale."""
        defocus, cone, scale, end = (
            row * self.terms
            for row in (self.defocus, self.values - 2, self.values - 1, self.values)
        )
        return [defocus, cone, *range(scale, end)]

    @property
    def _of_modes(self) -> slice:
        """Coefficients of the modes."""
        return slice(len(self.noll) * self.terms)

    @cached_property
    def _apparent(self) -> Bools:
        """(columns,) whether a parameter changes what is measured, but not the lens: errors of wavelengths and pitch."""
        return np.array(
            [column.kind in (WAVELENGTH, PIXEL_PITCH) for column in self.columns]
        )

    @cached_property
    def longer(self) -> Floats:
        """(exposures, columns) derivatives of ln of the true over the stated wavelength."""
        light = np.array([column.kind == WAVELENGTH for column in self.columns])
        return np.asarray(self._map[1][:, self._law_rows[1]] * light)

    def _widened(self, column: Column) -> Column:
        """Return the column, with the error of a mistake if the laws call its number mistaken."""
        if (column.kind, column.name) != self.laws.mistaken:
            return column
        unit = {
            FOCAL_LENGTH: column.value,
            F_NUMBER: column.value,
            RANGE_ZERO: max(reading.range_mm for reading in self.readings),
        }
        return replace(column, std=SETTINGS.loose * unit.get(column.kind, 1.0))

    def _columns(self) -> Iterator[Column]:
        stated = self.stated
        far = max(reading.range_mm for reading in self.readings)
        focal = stated.focal_length
        f_number = stated.f_number
        yield Column(FOCAL_LENGTH, focal.std, focal.value)
        yield Column(F_NUMBER, f_number.std, f_number.value)
        yield Column(MAGNIFICATION, USUAL_LOG_MAGNIFICATION)
        yield Column(RANGE_ZERO, stated.range_zero_std_mm)
        yield Column(SIZE, float(np.hypot(stated.size_std, self.tilt_std)))
        for exact in (PIXEL_PITCH, WAVELENGTH):  # of all channels: wrong only by a mistake
            yield Column(exact, 0.0)
        yield Column(WORKING_F_NUMBER, self.laws.f_number_std)
        homings = {homing for reading in self.readings for homing in reading.homings}
        for homing in sorted(homings)[1:]:
            yield Column(HOMING_LABEL, stated.homing_std_mm, name=(homing,))
        for station in self._stations:
            yield Column(STEPS_LABEL, stated.range_std_mm, name=(station,))
        yield Column(FOCUS, 100 * far, far)
        for channel in self.channels:
            yield Column(WAVELENGTH, self._wavelength_std(channel), name=(channel,))
            if channel != self.reference:
                yield Column(AXIAL_COLOUR, SETTINGS.colour_std * far, name=(channel,))
                yield Column(LATERAL_COLOUR, SETTINGS.colour_std, name=(channel,))
        names = (self.of_channel(label, c) for c in self.channels for label in self.parts)
        for name in dict.fromkeys(names):
            yield Column(PART, SETTINGS.unknown, name=name)
        for j in self.noll:
            if j != DEFOCUS:
                weak = self.weak.get(j)
                yield from mode_columns(j, self.channels, self.spread, weak)
        yield from common_columns(self.field_order, self.noll, self.spread, self._stations)

    def _wavelength_std(self, channel: str) -> float:
        std = self.stated.wavelength_std.get(channel, 0.0)
        return min(std, SETTINGS.rounded_light) if self.laws.exact_light else std

    @property
    def _stations(self) -> list[float]:
        return sorted({reading.station for reading in self.readings})

    @cached_property
    def _map(self) -> tuple[Floats, Floats, Floats]:
        """Linear map from parameters to the coefficients without the laws, followed by the arguments of the laws.

        The arguments are f, N, ln mp, true range, best focus of the channel, best focus of the reference, and the target's tilt
        down and right: how much nearer it comes, relative, over half the frame's diagonal.

        Returns
        -------
        (exposures, values x terms + 8) for parameters that are 0; derivatives of these by the columns and by the local columns
        """
        size = self.values * self.terms
        true_range, tilt = size + 3, size + 6
        exposed = self._exposed
        offset = np.zeros((len(exposed), size + ARGUMENTS))
        offset[:, true_range] = [reading.range_mm for reading in exposed]
        by_channel = {channel: self._channel_map(channel) for channel in self.channels}
        common = np.array([by_channel[reading.key.channel] for reading in exposed])
        for k, reading in enumerate(exposed):
            common[k, true_range, self.index(STEPS_LABEL, reading.station)] = 1.0
            for homing, times in Counter(reading.homings).items():
                if (column := self._places.get((HOMING_LABEL, (homing,)))) is not None:
                    common[k, true_range, column] = times / len(reading.homings)
            for axis, slope in enumerate(TARGET_SLOPES if self.field_order else ()):
                column = self.index(FIELD_TILT, reading.station, slope)
                common[k, tilt + axis, column] = 1.0
        own = np.zeros((len(exposed), size + ARGUMENTS, len(self.local_columns)))
        for row, at in self._coefficients_of(self.local_columns):
            own[:, row, at] = 1.0
        return offset, common, own

    def _coefficients_of(self, columns: Sequence[Column]) -> Iterator[tuple[int, int]]:
        """Yield each coefficient to which a column adds, with the column's place."""
        for at, column in enumerate(columns):
            row = coefficient(column, self.field_order, self.noll, self.values)
            if row is not None:
                yield row, at

    def _channel_map(self, channel: str) -> Floats:
        """Return derivatives (values x terms + 8, columns) that all exposures of a channel have in common."""
        size = self.values * self.terms
        cone, scale = self._law_rows[1:3]
        first, true_range = size, size + 3
        rows = np.zeros((size + ARGUMENTS, len(self.columns)))
        for row, at in self._coefficients_of(self.columns):
            rows[row, at] = 1.0
        entries: list[tuple[int | list[int], Place]] = [
            (cone, (WORKING_F_NUMBER, ())),
            (scale, (SIZE, ())),
            (scale, (LATERAL_COLOUR, (channel,))),
            (cone, (WAVELENGTH, (channel,))),
            (cone, (WAVELENGTH, ())),
            ([cone, scale], (PIXEL_PITCH, ())),
            *((first + k, (kind, ())) for k, kind in enumerate(GEOMETRY[:3])),
            ([true_range, true_range + 1, true_range + 2], (RANGE_ZERO, ())),
        ]
        for row, j in enumerate(self.noll):
            constant = row * self.terms
            entries += [(constant, (kind, (j,))) for kind in (COMMON_MODE, WEAK_MODE)]
            entries.append((constant, (MODE, (channel, j))))
        for row, label in enumerate(self.parts, len(self.noll)):
            number = (PART, self.of_channel(label, channel))
            entries.append((row * self.terms, number))
        for constants, place in entries:  # sessions have only some of these columns
            if (column := self._places.get(place)) is not None:
                rows[constants, column] = 1.0
        rows[true_range + 1] += self.best_focus(channel)
        rows[true_range + 2] += self.best_focus(self.reference)
        return rows

    def _sums(self, theta: Floats, local: Floats) -> Floats:
        """Return coefficients without the laws, and the laws' arguments, (exposures, values x terms + 8)."""
        offset, common, own = self._map
        return np.asarray(
            offset + common @ theta + np.einsum("nrl,nl->nr", own, local[self.blocks])
        )

    def _laws(self, arguments: Floats) -> Floats:
        """Return defocus, waves RMS, ln of the f-number, and coefficients of ln of the scale, of arguments (8, ...)."""
        f, n, pupils = arguments[:3]
        lens = ThinLens(
            *cast(tuple[float, float, float], (f, n, np.exp(pupils)))
        )  # arrays of lenses
        ranges, focus, reference = np.maximum(arguments[3:6], 1.01 * f)
        colour = lens.in_colour(focus, reference)
        ranges = np.maximum(ranges, 1.01 * colour.focal_length_mm)
        scale = self._target.log_scale(arguments[6:])
        scale[0] += np.log(lens.chief_ray_scale(ranges, reference))
        stated = self.stated
        waves = defocus_waves(colour, ranges, focus, stated.reference_nm, stated.convention)
        return np.stack([waves, np.log(colour.working_f_number(focus)), *scale])

    @cached_property
    def _target(self) -> TiltedTarget:
        return TiltedTarget.of(self.field_order, self.readings, self.exposures)

    def _law_slopes(self, arguments: Floats) -> Floats:
        """Differentiate the laws by their arguments, (laws, 8, n), by central differences of fourth order."""
        steps = DERIVATIVE_STEP * np.maximum(np.abs(arguments), 1.0)
        moves = steps[:, None] * np.eye(len(steps))[:, :, None]
        times = np.array([1.0, -1.0, 2.0, -2.0])[:, None, None]
        # of all moves at once: a call for few numbers takes as long as one for many
        laws = self._laws(arguments[:, None, None] + times * moves[:, None])
        once, twice = laws[:, 0] - laws[:, 1], laws[:, 2] - laws[:, 3]
        return np.asarray((8 * once - twice) / (12 * steps))


def _numbered(names: Iterable[Hashable]) -> Indices:
    """Number names by their first appearance, (n,)."""
    every = list(names)
    places = {name: k for k, name in enumerate(dict.fromkeys(every))}
    return np.array([places[name] for name in every], dtype=np.intp)
