"""Photographs of one scene and the lenses they were taken through, and how parts of them become views of a scene's part."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.fft

from labkit.imaging.blur import Blur
from labkit.imaging.optics import Optics
from labkit.imaging.window import WINDOW_AIRY
from labkit.optics.psf import Pupil
from labkit.restoration.grid import SceneGrid
from labkit.restoration.views import View, Views
from labkit.types import AnyFloats, Bools, Complexes64, Floats

Area = tuple[slice, slice]
"""Rows and columns of the photographs, pixels."""

Shift = tuple[float, float]
"""Pixels down and right."""

LEAST_USED = 4
"""Counts of a plane's part; one with fewer is left out."""


@dataclass(frozen=True, eq=False)
class Colour:
    """One colour of the scene: where its pixels lie in the filter array's cell, and the lens in its light.

    optics, waves: of the session; waves_at: (row, column) of a place in the photograph -> (modes,), where they differ over the
    field. gain: counts an electron; read_variance: counts squared. motion: (2, 3), lateral colour: where what another colour
    shows at [row, column, 1] stands in this one, less [row, column], px.
    """

    name: str
    places: tuple[tuple[int, int], ...]
    optics: Optics
    waves: Floats
    gain: float
    read_variance: float
    motion: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    waves_at: Callable[[float, float], Floats] | None = None

    def waves_near(self, place: tuple[float, float]) -> Floats:
        """(modes,) at a place in the photograph."""
        return self.waves if self.waves_at is None else self.waves_at(*place)


@dataclass(frozen=True, eq=False)
class Exposure:
    """counts: (rows, columns) of all colours, black removed. used: neither clipped nor dead. light: relative illumination.
    motion: (2, 3), where what the first photograph shows at [row, column, 1] stands in this one, less [row, column], px."""

    counts: AnyFloats
    used: Bools
    light: AnyFloats
    motion: Floats = field(default_factory=lambda: np.zeros((2, 3)))


@dataclass(frozen=True, eq=False)
class Job:
    """All that a scene is to be restored from. period: pixels to a cell of the filter array; samples: of the scene to a pixel;
    guard_px: from how far beyond its frame a part of the scene is followed. coupling: as `Roughness` has it."""

    photographs: tuple[Exposure, ...]
    colours: tuple[Colour, ...]
    period: int
    samples: int
    guard_px: int
    coupling: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the photographs, pixels."""
        rows, columns = self.photographs[0].counts.shape
        return rows, columns

    @property
    def pitch_um(self) -> float:
        """Of pixels."""
        return self.colours[0].optics.pitch_um

    @property
    def nyquist_samples(self) -> int:
        """To a pixel, that hold all that the lens passes."""
        optics = [colour.optics for colour in self.colours]
        nyquist_um = min(o.airy_um * o.shortest / (2 * o.rim.reach) for o in optics)
        return math.ceil(self.pitch_um / nyquist_um * (1 - 1e-9))

    def of_samples(self, samples: int) -> Job:
        """The same on a grid of so many samples to a pixel."""
        return replace(self, samples=samples)

    def only(self, components: Sequence[int]) -> Job:
        """The same of some of its colours."""
        colours = tuple(self.colours[c] for c in components)
        covariance = np.linalg.inv(self.coupling)[np.ix_(components, components)]
        return replace(self, colours=colours, coupling=np.linalg.inv(covariance))

    def sees(self, component: int) -> bool:
        """Whether some plane has usable counts of a colour."""
        return any(
            photograph.used[row :: self.period, column :: self.period].sum() >= LEAST_USED
            for photograph in self.photographs
            for row, column in self.colours[component].places
        )

    def cut(self, area: Area) -> Job:
        """A part of it, with the lens and the motion of its place."""
        origin = np.array([area[0].start, area[1].start], float)
        photographs = tuple(
            replace(
                p,
                counts=p.counts[area],
                used=p.used[area],
                light=p.light[area],
                motion=_from(p.motion, origin),
            )
            for p in self.photographs
        )
        place = (
            (area[0].start + area[0].stop - 1) / 2,
            (area[1].start + area[1].stop - 1) / 2,
        )
        colours = tuple(
            replace(
                c, waves=c.waves_near(place), waves_at=None, motion=_from(c.motion, origin)
            )
            for c in self.colours
        )
        return replace(self, photographs=photographs, colours=colours)

    def views(self, area: Area) -> Views | None:
        """Of the scene in an area of whole cells; None where no count of it can be used."""
        frame = (area[0].stop - area[0].start, area[1].stop - area[1].start)
        grid = SceneGrid(frame, self.guard_px, self.pitch_um, self.samples, self.period)
        place = (
            (area[0].start + area[0].stop - 1) / 2,
            (area[1].start + area[1].stop - 1) / 2,
        )
        found: list[View] = []
        for component, colour in enumerate(self.colours):
            transfer = transfer_on(grid, colour.optics, colour.waves_near(place))
            for photograph in self.photographs:
                down, right = (photograph.motion + colour.motion) @ np.array([*place, 1.0])
                by = (float(down), float(right))
                found += self._planes(photograph, area, component, grid, transfer, by)
        return (
            Views(grid, tuple(found), len(self.colours)) if self._complete(found) else None
        )

    def small(self, place: tuple[float, float], cells: int) -> Views:
        """The same planes on a torus of a few cells, all counts there: what errors of even noise are computed on."""
        side = cells * self.period
        one, none = np.ones((side, side)), np.zeros((side, side))
        photographs = tuple(
            replace(p, counts=none, used=one > 0, light=one) for p in self.photographs
        )
        job = replace(self, photographs=photographs, guard_px=0)
        views = replace(
            job,
            colours=tuple(
                replace(c, waves=c.waves_near(place), waves_at=None) for c in self.colours
            ),
        )
        found = views.views((slice(0, side), slice(0, side)))
        assert found is not None
        return found

    def _planes(
        self,
        photograph: Exposure,
        area: Area,
        component: int,
        grid: SceneGrid,
        transfer: Complexes64,
        by: Shift,
    ) -> Sequence[View]:
        colour, found = self.colours[component], []
        for row, column in colour.places:
            plane = (
                slice(area[0].start + row, area[0].stop, self.period),
                slice(area[1].start + column, area[1].stop, self.period),
            )
            used = photograph.used[plane]
            if used.sum() < LEAST_USED:
                continue
            found.append(
                View(
                    component,
                    (row, column),
                    grid.shifted(transfer, (by[0] - row, by[1] - column)),
                    photograph.counts[plane].astype(np.float64),
                    used,
                    photograph.light[plane].astype(np.float64),
                    colour.gain,
                    colour.read_variance,
                )
            )
        return found

    def _complete(self, found: Sequence[View]) -> bool:
        return {view.component for view in found} == set(range(len(self.colours)))


def _from(motion: Floats, origin: Floats) -> Floats:
    """A motion in coordinates that begin elsewhere."""
    moved = motion.copy()
    moved[:, 2] += motion[:, :2] @ origin
    return moved


def transfer_on(grid: SceneGrid, optics: Optics, waves: Floats) -> Complexes64:
    """Half plane of the transfer function of lens, pixel and camera. waves: (modes,) RMS at the reference wavelength."""
    torus, side_um = grid.pixels, min(grid.pixels.fine) * grid.pixels.spacing_um
    cutoff = optics.rim.reach / (optics.airy_um * optics.shortest)
    finer = max(math.ceil(2 * torus.spacing_um * cutoff * (1 - 1e-9)), 1)
    spacing_um = torus.spacing_um / finer
    window_um = min(max(WINDOW_AIRY, optics.window_airy(waves)) * optics.airy_um, side_um)
    size = scipy.fft.next_fast_len(math.ceil(window_um / spacing_um), real=True)
    size = min(size, min(torus.fine) * finer)
    pupil = Pupil(
        optics.wavelength_um,
        optics.reference_um,
        optics.f_number,
        spacing_um,
        size,
        optics.noll,
        optics.rim,
    )
    blur = Blur(torus, pupil, optics.active_um, optics.light, optics.parts, optics.given)
    return grid.whole(blur.transfer(waves))
