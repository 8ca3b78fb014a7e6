"""Photographs of a scene and the lenses in front of them, and their areas as views of a part of the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.imaging.model import blur_on
from labkit.imaging.optics import Optics
from labkit.imaging.window import WINDOW_AIRY
from labkit.restoration.grid import SceneGrid
from labkit.restoration.views import View, Views
from labkit.types import AnyFloats, Bools, Complexes64, Floats

Area = tuple[slice, slice]
"""Rows and columns of the photographs, pixels."""

LEAST_USED = 4  # counts of a plane in an area


@dataclass(frozen=True, eq=False)
class Colour:
    """A colour of the scene: its pixels in the filter array's cell, and the lens in its light.

    Attributes
    ----------
    name : of the channel
    places : (row, column) in the cell
    optics, waves : of the session
    gain, read_variance : counts per electron, counts squared
    motion : (2, 3), lateral colour: displacement from another colour's picture at [row, column, 1], px
    waves_at : (row, column) of a place in the photograph -> (modes,), if they differ over the field
    """

    name: str
    places: tuple[tuple[int, int], ...]
    optics: Optics
    waves: Floats
    gain: float
    read_variance: float
    motion: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    waves_at: Callable[[float, float], Floats] | None = None

    @property
    def defocus(self) -> float | None:
        """Waves RMS at the reference; None without Noll mode 4."""
        noll = self.optics.noll
        return float(self.waves[noll.index(4)]) if 4 in noll else None

    def waves_near(self, place: tuple[float, float]) -> Floats:
        """Return the modes (modes,) at a place in the photograph."""
        return self.waves if self.waves_at is None else self.waves_at(*place)


@dataclass(frozen=True, eq=False)
class Exposure:
    """A photograph of the scene.

    Attributes
    ----------
    counts : (rows, columns) of all colours, above black
    used : neither clipped nor dead
    light : relative illumination
    motion : (2, 3), displacement from the first photograph's picture at [row, column, 1], px
    """

    counts: AnyFloats
    used: Bools
    light: AnyFloats
    motion: Floats = field(default_factory=lambda: np.zeros((2, 3)))


@dataclass(frozen=True, eq=False)
class Job:
    """Photographs and lenses from which a scene is restored.

    Attributes
    ----------
    photographs, colours : photographs of the scene, and lenses
    period : pixels of a side of the filter array's cell
    samples : of the scene, for each pixel
    guard_px : width of the rim beyond a frame from which light reaches it
    coupling : as of `Roughness`
    """

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
        """Pitch of the pixels."""
        return self.colours[0].optics.pitch_um

    @property
    def nyquist_samples(self) -> int:
        """Samples of a pixel, enough for all frequencies within the lens's cutoff."""
        optics = [colour.optics for colour in self.colours]
        nyquist_um = min(o.airy_um * o.shortest / (2 * o.rim.reach) for o in optics)
        return math.ceil(self.pitch_um / nyquist_um * (1 - 1e-9))

    def plane(self, place: tuple[int, int], area: Area | None = None) -> Area:
        """Return slices of the pixels at a place of the cell, in an area of whole cells."""
        rows, columns = area or (slice(0, None), slice(0, None))
        return (
            slice(rows.start + place[0], rows.stop, self.period),
            slice(columns.start + place[1], columns.stop, self.period),
        )

    def of_samples(self, samples: int) -> Job:
        """Return the job on a grid of so many samples for each pixel."""
        return replace(self, samples=samples)

    def only(self, components: Sequence[int]) -> Job:
        """Return the job of some colours."""
        colours = tuple(self.colours[c] for c in components)
        covariance = np.linalg.inv(self.coupling)[np.ix_(components, components)]
        return replace(self, colours=colours, coupling=np.linalg.inv(covariance))

    def sees(self, component: int) -> bool:
        """Return whether a plane has usable counts of a colour."""
        return any(
            photograph.used[self.plane(place)].sum() >= LEAST_USED
            for photograph in self.photographs
            for place in self.colours[component].places
        )

    def cut(self, area: Area) -> Job:
        """Return an area of the job, with the lens and the motion of its place."""
        origin = np.array([area[0].start, area[1].start], float)
        photographs = tuple(
            Exposure(
                p.counts[area], p.used[area], p.light[area], begun_at(p.motion, origin)
            )
            for p in self.photographs
        )
        colours = tuple(
            replace(
                c,
                waves=c.waves_near(middle_of(area)),
                waves_at=None,
                motion=begun_at(c.motion, origin),
            )
            for c in self.colours
        )
        return replace(self, photographs=photographs, colours=colours)

    def views(self, area: Area) -> Views | None:
        """Return the views of the scene in an area of whole cells; None if a colour has no usable count."""
        frame = (area[0].stop - area[0].start, area[1].stop - area[1].start)
        grid = SceneGrid(frame, self.guard_px, self.pitch_um, self.samples, self.period)
        middle = middle_of(area)
        found: list[View] = []
        for component, colour in enumerate(self.colours):
            transfer = transfer_on(grid, colour.optics, colour.waves_near(middle))
            for photograph in self.photographs:
                shift = (photograph.motion + colour.motion) @ np.array([*middle, 1.0])
                for place in colour.places:
                    plane = self.plane(place, area)
                    if photograph.used[plane].sum() < LEAST_USED:
                        continue
                    down, right = shift - place
                    view = View(
                        component,
                        place,
                        grid.shifted(transfer, (float(down), float(right))),
                        photograph.counts[plane].astype(np.float64),
                        photograph.used[plane],
                        photograph.light[plane].astype(np.float64),
                        colour.gain,
                        colour.read_variance,
                    )
                    found.append(view)
        if len({view.component for view in found}) < len(self.colours):
            return None
        return Views(grid, tuple(found), len(self.colours))

    def small(self, cells: int) -> Views:
        """Return the planes on a torus of a few cells, all counts used: errors of even noise are computed on it."""
        side = cells * self.period
        one = np.ones((side, side))
        none = np.zeros((side, side))
        photographs = tuple(
            Exposure(none, one > 0, one, p.motion) for p in self.photographs
        )
        job = replace(self, photographs=photographs, guard_px=0)
        found = job.views((slice(0, side), slice(0, side)))
        assert found is not None
        return found


def middle_of(area: Area) -> tuple[float, float]:
    """Return (row, column) of an area's centre."""
    rows, columns = area
    return (rows.start + rows.stop - 1) / 2, (columns.start + columns.stop - 1) / 2


def begun_at(motion: Floats, origin: Floats) -> Floats:
    """Return a motion in coordinates with another origin (2,)."""
    moved = motion.copy()
    moved[:, 2] += motion[:, :2] @ origin
    return moved


def transfer_on(grid: SceneGrid, optics: Optics, waves: Floats) -> Complexes64:
    """Return the half plane of the transfer function of lens, pixel and camera. waves: (modes,) RMS at the reference."""
    torus = grid.pixels
    side_um = min(grid.pixels.fine) * grid.pixels.spacing_um
    cutoff = optics.rim.reach / (optics.airy_um * optics.shortest)
    window_um = min(max(WINDOW_AIRY, optics.window_airy(waves)) * optics.airy_um, side_um)
    return grid.whole(blur_on(torus, optics, window_um, cutoff).transfer(waves))
