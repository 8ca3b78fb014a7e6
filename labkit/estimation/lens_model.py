"""Laws that connect the observations of a session: one lens, one sensor at rest, one rail (thesis §4.5.2, Appendix E).

Every observation measures modes, numbers of camera parts, ln of the working f-number and ln of the picture's scale. All follow
from a few named parameters of the session, the columns of a least-squares problem; the plan states some of them. A new law
needs a new column (`_columns`) and its derivatives: an entry of `_channel_map`, or a term of `_laws`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from labkit.estimation.candidate import Reading
from labkit.estimation.field_terms import (
    Family,
    common_columns,
    design,
    own_columns,
    station_design,
    usual_order,
)
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    COMMON_MODE,
    F_NUMBER,
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
    WORKING_F_NUMBER,
    Column,
    Laws,
    Name,
    Place,
)
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.imaging.parts import ESTIMATED
from labkit.key import Key
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens, defocus_waves
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Bools, Floats, Indices

ONLY_MISTAKEN: tuple[Place, ...] = ((PIXEL_PITCH, ()), (WAVELENGTH, ()))
"""Parameters that are exact unless they are a mistake: pixel pitch, and a common factor of all wavelengths."""

DERIVATIVE_STEP = 1e-3
"""Step of numerical derivatives by an argument over its size, or over 1 if it is smaller: slopes err by 1e-9 at most."""


@dataclass(frozen=True)
class LensModel:
    """The laws of a session, for all observations, measured or not.

    Values of an observation, in order: modes of `noll`, numbers of the parts, ln of the working f-number, ln of the scale.
    Columns are parameters of the whole session. Where observations are of tiles, `labkit.estimation.field_terms` adds those of
    the field, and local columns: a set for each channel, which `labkit.estimation.block_solve` eliminates.

    Attributes
    ----------
    readings : rail positions of the n observations; ValueError if two have the same key
    noll : Noll's numbers of the modes, including 4
    parts : labels of the parts' numbers
    stated : the plan's numbers
    laws : tolerances of the laws
    tilt_std : relative error of all sizes due to the target's tilt
    field_spread : standard deviations of the field's terms, by family, where they differ from those before the session
    """

    readings: tuple[Reading, ...]
    noll: tuple[int, ...]
    parts: tuple[str, ...]
    stated: Stated
    laws: Laws = field(default_factory=Laws)
    tilt_std: float = 0.0
    field_spread: Mapping[Family, float] = field(default_factory=dict)

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
    def blocks(self) -> Indices:
        """(n,) index of each observation's block, which has local columns: its channel."""
        return _numbered(r.key.channel for r in self.readings)

    def by_block(self, rows: Floats) -> Floats:
        """Sum rows (n, ...) over the observations of each block, (blocks, ...)."""
        order, first = self._block_order
        return np.asarray(
            np.add.reduceat(rows if order is None else rows[order], first, axis=0)
        )

    @cached_property
    def _block_order(self) -> tuple[Indices | None, Indices]:
        """Order that sorts observations by block, None if they are sorted, and the place where each block begins."""
        order = np.argsort(self.blocks, kind="stable")
        first = np.flatnonzero(np.diff(self.blocks[order], prepend=-1))
        return None if np.array_equal(order, np.arange(len(order))) else order, first

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Parameters of the whole session."""
        return tuple(self._widened(column) for column in self._columns())

    @cached_property
    def local_columns(self) -> tuple[Column, ...]:
        """Parameters of each channel for itself; empty for sessions without tiles, or with one channel."""
        if len(self.channels) < 2:
            return ()
        return tuple(own_columns(self.field_order, self.noll, self.field_spread))

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
        """Predict the measurements (n, values), for theta (columns,) and local (blocks, local columns).

        Light of a longer wavelength than stated makes the same picture as stated light through a cone narrower by the same
        ratio, with path differences smaller by the same ratio: N grows with the wavelength's error, the modes shrink. If the
        stated pitch is too large, so are N and the scale, by the same ratio.
        """
        values, arguments = np.split(self._sums(theta, local), [self.values], axis=1)
        values[:, self._law_rows] += self._laws(arguments.T).T
        values[:, : len(self.noll)] *= np.exp(-(self._longer @ theta))[:, None]
        return values

    def true(self, theta: Floats, local: Floats) -> Floats:
        """Return values (n, values) as predicted for light and a pitch as stated: their errors change what is measured only."""
        return self.predicted(np.where(self._apparent, 0.0, theta), local)

    def slopes(self, theta: Floats, local: Floats) -> tuple[Floats, Floats]:
        """Return derivatives of `predicted`: (n, values, columns), and (n, values, local columns)."""
        by_argument = self._law_slopes(self._sums(theta, local)[:, self.values :].T)
        shrunk = np.exp(-(self._longer @ theta))[:, None, None]

        def chained(rows: Floats) -> Floats:
            slopes = rows[:, : self.values].copy()
            arguments = rows[:, self.values :]
            slopes[:, self._law_rows] += np.einsum("lan,nac->nlc", by_argument, arguments)
            slopes[:, : len(self.noll)] *= shrunk
            return slopes

        whole, own = map(chained, self._map[1:])
        modes = self.predicted(theta, local)[:, : len(self.noll), None]
        whole[:, : len(self.noll)] -= modes * self._longer[:, None]
        return whole, own

    def true_slopes(self, slopes: Floats) -> Floats:
        """Return slopes (..., columns) of `true` from those of `predicted`."""
        return np.where(self._apparent, 0.0, slopes)

    @property
    def _upper_modes(self) -> list[int]:
        return [j for j in self.noll if j != DEFOCUS]

    @property
    def _law_rows(self) -> list[int]:
        """Places of defocus, ln of the f-number and ln of the scale, which follow nonlinear laws."""
        return [self.defocus, self.values - 2, self.values - 1]

    @cached_property
    def _apparent(self) -> Bools:
        """(columns,) whether a parameter changes what is measured, but not the lens: errors of wavelengths and pitch."""
        return np.array(
            [column.kind in (WAVELENGTH, PIXEL_PITCH) for column in self.columns]
        )

    @cached_property
    def _longer(self) -> Floats:
        """(n, columns) derivatives of ln of the true over the stated wavelength."""
        light = np.array([column.kind == WAVELENGTH for column in self.columns])
        return np.asarray(self._map[1][:, self.values - 2] * light)

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
        yield Column(WORKING_F_NUMBER, self.laws.f_number_std)
        homings = {homing for reading in self.readings for homing in reading.homings}
        for homing in sorted(homings)[1:]:
            yield Column(HOMING_LABEL, stated.homing_std_mm, name=(homing,))
        for station in self._stations:
            yield Column(STEPS_LABEL, stated.range_std_mm, name=(station,))
        yield Column(FOCUS, 100 * far, far)
        for channel in self.channels:
            error = stated.wavelength_std.get(channel, 0.0)
            yield Column(WAVELENGTH, error, name=(channel,))
            if channel != self.reference:
                yield Column(AXIAL_COLOUR, SETTINGS.colour_std * far, name=(channel,))
                yield Column(LATERAL_COLOUR, SETTINGS.colour_std, name=(channel,))
        names = (self.of_channel(label, c) for c in self.channels for label in self.parts)
        for name in dict.fromkeys(names):
            yield Column(PART, SETTINGS.unknown, name=name)
        for j in self._upper_modes:
            yield Column(COMMON_MODE, SETTINGS.unknown, name=(j,))
            for channel in self.channels:
                yield Column(MODE, SETTINGS.colour_modes_std, name=(channel, j))
        yield from common_columns(
            self.field_order, self.noll, self.field_spread, self._stations
        )
        for kind, name in ONLY_MISTAKEN:  # last: other columns keep their places
            if (kind, name) == self.laws.mistaken:
                yield Column(kind, SETTINGS.loose)

    @property
    def _stations(self) -> list[float]:
        return sorted({reading.station for reading in self.readings})

    @cached_property
    def _map(self) -> tuple[Floats, Floats, Floats]:
        """Linear map from parameters to the values without the laws, followed by the six arguments of the laws.

        The arguments are f, N, ln mp, true range, best focus of the channel, best focus of the reference.

        Returns
        -------
        (n, values + 6) for parameters that are 0; derivatives (n, values + 6, columns), (n, values + 6, local columns)
        """
        n = len(self.readings)
        rows = self.values + 6
        true_range = self.values + 3
        offset = np.zeros((n, rows))
        offset[:, true_range] = [reading.range_mm for reading in self.readings]
        by_channel = {channel: self._channel_map(channel) for channel in self.channels}
        common = np.array([by_channel[r.key.channel] for r in self.readings])
        for k, reading in enumerate(self.readings):
            common[k, true_range, self.index(STEPS_LABEL, reading.station)] = 1.0
            for homing, times in Counter(reading.homings).items():
                if (column := self._places.get((HOMING_LABEL, (homing,)))) is not None:
                    common[k, true_range, column] = times / len(reading.homings)
        own = np.zeros((n, rows, len(self.local_columns)))
        places = np.array([reading.place for reading in self.readings])
        common[:, : self.values] += design(self.columns, places, self.noll, self.values)
        stations = [reading.station for reading in self.readings]
        common[:, self.values - 1] += station_design(self.columns, places, stations)
        own[:, : self.values] = design(self.local_columns, places, self.noll, self.values)
        return offset, common, own

    def _channel_map(self, channel: str) -> Floats:
        """Return derivatives (values + 6, columns) that all observations of a channel have in common."""
        cone, scale, first, true_range = (self.values + k for k in (-2, -1, 0, 3))
        rows = np.zeros((self.values + 6, len(self.columns)))
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
            entries += [(row, (COMMON_MODE, (j,))), (row, (MODE, (channel, j)))]
        for row, label in enumerate(self.parts, len(self.noll)):
            entries.append((row, (PART, self.of_channel(label, channel))))
        for at, place in entries:  # sessions have only some of these columns
            if (column := self._places.get(place)) is not None:
                rows[at, column] = 1.0
        rows[true_range + 1] += self.best_focus(channel)
        rows[true_range + 2] += self.best_focus(self.reference)
        return rows

    def _sums(self, theta: Floats, local: Floats) -> Floats:
        """Return values without the laws, and the laws' arguments, (n, values + 6)."""
        offset, common, own = self._map
        return np.asarray(
            offset + common @ theta + np.einsum("nrl,nl->nr", own, local[self.blocks])
        )

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
        """Differentiate the laws by their arguments, (3, 6, n), by central differences of fourth order."""
        steps = DERIVATIVE_STEP * np.maximum(np.abs(arguments), 1.0)
        moves = steps[:, None] * np.eye(len(steps))[:, :, None]

        def difference(times: int) -> Floats:
            ahead = self._laws(arguments[:, None] + times * moves)
            return ahead - self._laws(arguments[:, None] - times * moves)

        return np.asarray((8 * difference(1) - difference(2)) / (12 * steps))


def _numbered(names: Iterable[Hashable]) -> Indices:
    """Number names by their first appearance, (n,)."""
    every = list(names)
    places = {name: k for k, name in enumerate(dict.fromkeys(every))}
    return np.array([places[name] for name in every], dtype=np.intp)
