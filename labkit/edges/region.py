"""An edge and the pixels around it: geometry, the mean that a camera records of it, and its slopes (thesis 5.1-5.27)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from labkit.arrays import real_array
from labkit.edges.blur import MOST_NUMBERS, Blur
from labkit.edges.spread import EdgeBlur, edge_spread
from labkit.imaging.optics import Optics
from labkit.types import Bools, Floats, Indices

LEAST_REGION_PIXELS = 60  # of a region: an edge and its noise are six numbers
LINE_NUMBERS = 4  # numbers of a straight edge between even sides
MOST_BOW_ORDER = 5  # of the polynomial that is an edge's place
BOW_NUMBERS = tuple(range(LINE_NUMBERS, LINE_NUMBERS + MOST_BOW_ORDER - 1))
LIGHT_NUMBERS = tuple(range(BOW_NUMBERS[-1] + 1, BOW_NUMBERS[-1] + 4))
BLUR_NUMBERS = tuple(range(LIGHT_NUMBERS[-1] + 1, LIGHT_NUMBERS[-1] + 1 + MOST_NUMBERS))
SHAPE_STDS = np.array([10.0] * len(BOW_NUMBERS) + [1.0] * len(LIGHT_NUMBERS))
"""Of bow and light among edges: a prior so wide that it says nothing."""


class Edge(NamedTuple):
    """An edge between two sides, as the numbers of its estimate: a straight one has four. Thesis (5.1).

    The edge departs from its line by the sum of bow_k (P_k(t) - P_k(0)), P_k Legendre's polynomials and t the place along the
    line; light changes by 1 + across r + along t + twist r t. Places r and t are counted from the region's centre in its
    half sizes.

    Attributes
    ----------
    angle : of the normal, radians from x (right) towards y (down)
    distance_px : of the line from the region's centre, along the normal
    near, far : radiance before and beyond the line along the normal, counts
    bow2, bow3, bow4, bow5 : pixels along the normal
    across, along, twist : of the light, relative
    blur, blur2 : numbers of the blur that no wavefront makes, of the region's kind
    """

    angle: float
    distance_px: float
    near: float
    far: float
    bow2: float = 0.0
    bow3: float = 0.0
    bow4: float = 0.0
    bow5: float = 0.0
    across: float = 0.0
    along: float = 0.0
    twist: float = 0.0
    blur: float = 0.0
    blur2: float = 0.0

    @property
    def rise(self) -> float:
        """Step along the normal, counts."""
        return self.far - self.near

    @property
    def towards_light(self) -> Edge:
        """The same line with its normal pointing to the brighter side."""
        if self.rise >= 0:
            return self._replace(angle=within_a_turn(self.angle))
        angle = within_a_turn(self.angle + np.pi)
        # along both axes signs are reversed
        odd = (-self.bow2, self.bow3, -self.bow4, self.bow5)
        light = (-self.across, -self.along, self.twist)
        blur = (self.blur, self.blur2)
        return Edge(angle, -self.distance_px, self.far, self.near, *odd, *light, *blur)

    @property
    def bow_px(self) -> float:
        """How far the edge departs from its line along it, from least to most."""
        return float(np.ptp(legendre.legval(np.linspace(-1, 1, 41), self.departure)))

    @property
    def departure(self) -> Floats:
        """(6,) coefficients of Legendre's series of the distance from the line by the place along it, half sizes."""
        bows = np.array(self[LINE_NUMBERS : LINE_NUMBERS + len(BOW_NUMBERS)])
        constant = bows @ legendre.legval(0.0, np.eye(MOST_BOW_ORDER + 1)[:, 2:])
        return np.concatenate([[-constant, 0.0], bows])


def within_a_turn(angle: float) -> float:
    """Return an angle, radians, between -pi and pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def turned(angle: float, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return coordinates along a normal at an angle (radians, from x towards y), and along its line."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return x * cosine + y * sine, y * cosine - x * sine


@dataclass(frozen=True)
class Region:
    """Pixels of a colour around an edge in a frame.

    Attributes
    ----------
    rows, columns : (n,) in the raw, pixel centres at integers
    counts : (n,) above black
    centre : (row, column) that distances are counted from
    frame, depth, light : places of its noise, its defocus and its colour among those of a problem
    order : of the polynomial that is the edge's place, to be fitted
    even : whether the light is even; else its three numbers are fitted
    blur : kind of a blur that no wavefront makes; None for none
    half_px : half the size, in which the edge's shape is counted: of a part the whole's; by default the largest distance
        from the centre

    Raises
    ------
    ValueError : arrays of different sizes, or too few pixels
    """

    rows: Floats
    columns: Floats
    counts: Floats
    centre: tuple[float, float]
    frame: int = 0
    depth: int = 0
    light: int = 0
    order: int = 1
    even: bool = True
    blur: Blur | None = None
    half_px: float = 0.0

    def __post_init__(self) -> None:
        size = np.size(self.rows)
        for name, unit in (("rows", "pixels"), ("columns", "pixels"), ("counts", "counts")):
            array = real_array(name, getattr(self, name), (size,), unit)
            object.__setattr__(self, name, array)
        if size < LEAST_REGION_PIXELS:
            raise ValueError(
                f"{size} pixels around an edge: {LEAST_REGION_PIXELS} are needed at least"
            )
        if not self.half_px:
            object.__setattr__(self, "half_px", float(np.hypot(*self.offsets).max()))

    @property
    def offsets(self) -> tuple[Floats, Floats]:
        """(n,) x and y from the centre, pixels."""
        return self.columns - self.centre[1], self.rows - self.centre[0]

    @property
    def free(self) -> Indices:
        """Places of an edge's fitted numbers."""
        light = () if self.even else LIGHT_NUMBERS
        blur = BLUR_NUMBERS[: self.blur.size] if self.blur else ()
        return np.array(
            [*range(LINE_NUMBERS), *BOW_NUMBERS[: self.order - 1], *light, *blur]
        )

    @property
    def shape_stds(self) -> Floats:
        """(k,) standard deviations of the fitted numbers behind the first four: wide priors about 0."""
        shape = [k for k in self.free if LINE_NUMBERS <= k < BLUR_NUMBERS[0]]
        blur = self.blur.stds if self.blur else ()
        return np.array([*SHAPE_STDS[np.array(shape, int) - LINE_NUMBERS], *blur])

    def blur_of(self, edge: Edge) -> EdgeBlur | None:
        """Return an edge's blur that no wavefront makes."""
        if self.blur is None:
            return None
        return EdgeBlur(self.blur, edge[BLUR_NUMBERS[0] : BLUR_NUMBERS[0] + self.blur.size])

    def across_and_along(self, edge: Edge) -> tuple[Floats, Floats]:
        """Return distances (n,) beyond the edge along its normal, and along the line, pixels: r and t of thesis (5.1)."""
        place = self.placed(edge)
        return place.across, place.along

    def placed(self, edge: Edge) -> Placed:
        """Return the pixels as an edge sees them."""
        off, along = turned(edge.angle, *self.offsets)
        t = along / self.half_px
        departure = edge.departure
        slope = np.asarray(legendre.legval(t, legendre.legder(departure)), np.float64)
        lean = slope / self.half_px
        # a distance along the line's normal is longer than along the edge's own
        longer = np.sqrt(1 + lean**2)
        place = np.asarray(edge.distance_px + legendre.legval(t, departure), np.float64)
        across = (off - place) / longer
        u = off / self.half_px
        light = 1 + edge.across * u
        light += edge.along * t
        light += edge.twist * u * t
        return Placed(across, along, off, lean, longer, light)

    def part(self, chosen: Bools) -> Region:
        """Return some of the pixels. chosen: (n,) mask. Raises ValueError for too few."""
        arrays = (self.rows, self.columns, self.counts)
        rows, columns, counts = (array[chosen] for array in arrays)
        return replace(self, rows=rows, columns=columns, counts=counts)


class Placed(NamedTuple):
    """Pixels (n,) as an edge sees them.

    Attributes
    ----------
    across, along : distances beyond the edge and along its line, pixels
    off : distance beyond a parallel through the centre
    lean, longer : slope of the edge against its line, and the length of a step along the line's normal
    light : relative
    """

    across: Floats
    along: Floats
    off: Floats
    lean: Floats
    longer: Floats
    light: Floats


def mean_and_slopes(
    region: Region, edge: Edge, optics: Optics, waves: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return mean counts (n,), their slopes (k, n) by the edge's free numbers, and (modes, n) per wave RMS.

    Thesis (5.12), (5.16), (5.20), (5.25)-(5.27).
    """
    at = region.placed(edge)
    pitch_um = optics.pitch_um
    reach_um = float(np.abs(at.across).max()) * pitch_um + pitch_um
    blur = region.blur_of(edge)
    spread = edge_spread(optics, waves, edge.angle, reach_um, blur)
    step, line, *others = spread.read(at.across * pitch_um)
    by_waves, turning, by_blur = np.split(np.stack(others), [waves.size, waves.size + 1])
    mean, by_edge = blurred_slopes(region, edge, at, step, line * pitch_um, turning[0])
    by_edge = np.concatenate([by_edge, edge.rise * at.light * by_blur])
    return mean, by_edge, edge.rise * at.light * by_waves


def blurred_slopes(
    region: Region, edge: Edge, at: Placed, step: Floats, line: Floats, turning: Floats
) -> tuple[Floats, Floats]:
    """Return mean counts (n,) of any blurred edge, and their slopes (k, n) by the edge's free numbers.

    Parameters
    ----------
    region, edge, at : pixels, and as the edge sees them
    step, line, turning : (n,) the blurred step, from 0 to 1, and its slopes by the distance, a pixel, and by the azimuth
    """
    line = edge.rise * line * at.light
    sides = edge.near + edge.rise * step
    t, u = at.along / region.half_px, at.off / region.half_px
    leaning = at.lean / at.longer
    # the light turns with the line
    twisting = edge.across * t - edge.along * u + edge.twist * (t**2 - u**2)
    curving = legendre.legval(t, legendre.legder(edge.departure, 2)) / region.half_px**2
    turned_off = leaning * at.off * (1 + at.across * curving / at.longer)
    by_angle = (
        (at.along / at.longer + turned_off) * line
        + edge.rise * turning * at.light
        + sides * twisting
    )
    slopes = [by_angle, -line / at.longer, (1 - step) * at.light, step * at.light]
    for order in range(2, region.order + 1):
        series = np.eye(MOST_BOW_ORDER + 1)[order]
        bow = legendre.legval(t, series) - legendre.legval(0.0, series)
        slope = legendre.legval(t, legendre.legder(series)) / region.half_px
        slopes.append(-line / at.longer * (bow + at.across * leaning * slope))
    if not region.even:
        slopes += [sides * u, sides * t, sides * u * t]
    return at.light * sides, np.stack(slopes)
