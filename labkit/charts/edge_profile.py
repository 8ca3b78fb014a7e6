"""An edge of a chart as a profile across it: a line that may bow, light that may slope, and means in narrow bins.

The line and the light are fitted with a blurred step. Means of counts by the distance from the line then hold all that the
edge shows of the lens, in a tenth of the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.special import ndtr

from labkit.edges.found_edges import FoundEdge
from labkit.edges.region import Region, turned
from labkit.errors import DataError
from labkit.types import Floats

BINS_PER_SAMPLE = 8
MOST_BOW = 5  # degree of the polynomial of the line
SURE_BOW = 5.0  # standard errors of a term of the polynomial, from which the line has it
FIRST_WIDTH = 1.5  # samples, of the blur
MOST_LINE_STEPS, SETTLED_LINE = 10, 2e-3  # of Gauss and Newton; samples
MOST_STEP = (1.0, 0.5)  # samples of the line, and of the width's logarithm
CLEAR_STEP = 15.0  # standard errors
MOST_ROUGH = 0.5  # of the step: noise and structure of single pixels
TINY_SQUARE = 1e-30
RIDGE = 1e-12


@dataclass(frozen=True)
class EdgeProfile:
    """Mean counts across an edge.

    Attributes
    ----------
    middle_px : (row, column) of the line in the middle of its length
    azimuth : of its normal towards the brighter side, radians from x (right) towards y (down)
    length_px : of the line
    bow_px : (k,) Legendre coefficients of the line, from the second degree on
    width_px : standard deviation of the blur as a Gaussian's
    distance_px, counts, number : (bins,) means across the edge, of the light in the middle, and pixels in each
    near, far : counts on either side, about
    scatter : (bins,) sum of squares of the pixels about each bin's mean, counts²
    light_per_px : relative slope of the light across the edge, about
    place : where the line lies
    """

    middle_px: tuple[float, float]
    azimuth: float
    length_px: float
    bow_px: Floats
    width_px: float
    distance_px: Floats
    counts: Floats
    number: Floats
    near: float
    far: float
    scatter: Floats
    light_per_px: float
    place: ProfilePlace

    def drawn(self, mean: Floats, rows: Floats, columns: Floats) -> Floats:
        """Return the counts of pixels (n,) at rows and columns (n,), by mean counts (bins,) across the edge."""
        distance, light = self.place.across(rows, columns)
        return np.interp(distance, self.distance_px, mean) * light


@dataclass(frozen=True)
class ProfilePlace:
    """The line of a profile, and the light along the line.

    Attributes
    ----------
    middle_px, angle : (row, column) of a point and the normal's angle, radians, that the line is counted from
    half_px : half of the length along the line
    line_px : Legendre coefficients of the line's distance
    light : relative slope of the light along the line
    """

    middle_px: tuple[float, float]
    angle: float
    half_px: float
    line_px: Floats
    light: float

    def across(self, rows: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """Return distances (n,) from the line and the relative light (n,) at rows and columns (n,)."""
        row, column = self.middle_px
        across, along = turned(self.angle, columns - column, rows - row)
        place = along / self.half_px
        return across - legendre.legval(place, self.line_px), 1 + self.light * place


def edge_profile(
    region: Region,
    found: FoundEdge,
    sample_px: float,
) -> EdgeProfile:
    """Return the profile across the edge in a region.

    Parameters
    ----------
    region : pixels of one colour around the edge
    found : where the edge is, about
    sample_px : distance of neighbouring pixels of the colour

    Raises
    ------
    DataError : the region holds no clear step
    """
    row, column = found.middle
    across, along = turned(found.angle, region.columns - column, region.rows - row)
    half = float(np.abs(along).max())
    basis = np.asarray(legendre.legvander(along / half, MOST_BOW).T, float)
    step = _Step(region.counts, across, basis)
    sides = (np.median(region.counts[s * across > sample_px]) for s in (-1, 1))
    numbers = np.array([*sides, 0, 0, np.log(FIRST_WIDTH * sample_px), 0, 0], float)
    most = np.array([MOST_STEP[0] * sample_px, MOST_STEP[1]])
    numbers = step.climbed(numbers, most)
    bowed = step.bowed(numbers)
    if len(bowed) > len(numbers):
        numbers = step.climbed(bowed, most)
    left = region.counts - step.at(numbers)[0]
    _refuse_unclear(numbers, left)
    line = numbers[BLUR_LINE:]
    light_along = float(numbers[LIGHT_ALONG])
    place = ProfilePlace(found.middle, found.angle, half, line, light_along)
    distance, light = place.across(region.rows, region.columns)
    flat = region.counts / light
    means, number, scatter = _binned(distance, flat, left, sample_px / BINS_PER_SAMPLE)
    angle = found.angle - float(np.arctan(line[1] / half))
    shift = float(legendre.legval(0.0, line))
    middle = np.array(found.middle) + shift * np.array([np.sin(angle), np.cos(angle)])
    near, far = numbers[:2].tolist()
    return EdgeProfile(
        (float(middle[0]), float(middle[1])),
        angle,
        2 * half,
        line[2:],
        float(np.exp(numbers[BLUR_WIDTH])),
        *means,
        number,
        near,
        far,
        scatter,
        float(numbers[LIGHT_ACROSS]),
        place,
    )


NEAR_SIDE, FAR_SIDE, LIGHT_ALONG, LIGHT_ACROSS, BLUR_WIDTH, BLUR_LINE = range(6)
"""Places of the numbers of a blurred step: its sides, relative slopes of the light along and across it, the logarithm of its
width, and the Legendre coefficients of its line."""


@dataclass(frozen=True)
class _Step:
    """A step blurred by a Gaussian, in pixels.

    Attributes
    ----------
    counts, across : (n,) and distances along the normal, px
    basis : (degrees, n) Legendre polynomials of the place along the line
    """

    counts: Floats
    across: Floats
    basis: Floats

    def at(
        self,
        numbers: Floats,
    ) -> tuple[Floats, Floats]:
        """Return mean counts (n,) and their slopes (numbers, n)."""
        near, far, along, sloped, log_width = numbers[:BLUR_LINE]
        width = np.exp(log_width)
        basis = self.basis[: len(numbers) - BLUR_LINE]
        distance = self.across - numbers[BLUR_LINE:] @ basis
        scaled = distance / width
        step = ndtr(scaled)
        line = np.exp(-0.5 * scaled**2) / (width * np.sqrt(2 * np.pi))
        dark = near + (far - near) * step
        light = (1 + along * self.basis[1]) * (1 + sloped * self.across)
        by_line = -(far - near) * line * light
        slopes = [
            (1 - step) * light,
            step * light,
            dark * self.basis[1] * (1 + sloped * self.across),
            dark * self.across * (1 + along * self.basis[1]),
            by_line * distance,
            *by_line * basis,
        ]
        return dark * light, np.array(slopes)

    def climbed(
        self,
        numbers: Floats,
        most: Floats,
    ) -> Floats:
        """Return numbers after steps of least squares. most : largest steps of the line and of the width."""
        for _ in range(MOST_LINE_STEPS):
            mean, slopes = self.at(numbers)
            change = _solved(slopes @ slopes.T, slopes @ (self.counts - mean))
            if np.abs(change[BLUR_WIDTH:]).max() < SETTLED_LINE * most[0]:
                break
            change[BLUR_LINE:] = np.clip(change[BLUR_LINE:], -most[0], most[0])
            change[BLUR_WIDTH] = np.clip(change[BLUR_WIDTH], -most[1], most[1])
            numbers = numbers + change
        return numbers

    def bowed(
        self,
        numbers: Floats,
    ) -> Floats:
        """Return numbers with as many degrees of the line as the counts are sure to show."""
        whole = np.append(numbers, np.zeros(len(self.basis) - (len(numbers) - BLUR_LINE)))
        mean, slopes = self.at(whole)
        left = self.counts - mean
        normal = slopes @ slopes.T
        change = _solved(normal, slopes @ left)
        std = np.std(left) * np.sqrt(np.diag(_solved(normal, np.eye(len(whole)))))
        sure = np.abs(change) > SURE_BOW * std
        sure[: BLUR_LINE + 2] = True
        return whole[: np.flatnonzero(sure)[-1] + 1]


def _solved(
    normal: Floats,
    right: Floats,
) -> Floats:
    """Return the solution of normal equations of numbers of any units."""
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), TINY_SQUARE))
    scaled = normal * np.outer(scale, scale) + RIDGE * np.eye(len(normal))
    turned_right = (right.T * scale).T
    return np.asarray((np.linalg.solve(scaled, turned_right).T * scale).T)


def _binned(
    distance: Floats,
    counts: Floats,
    left: Floats,
    width: float,
) -> tuple[tuple[Floats, Floats], Floats, Floats]:
    """Return means of distance and counts in bins, the number of pixels in each, and the scatter of what is left."""
    bins = np.floor((distance - distance.min()) / width).astype(np.intp)
    number = np.bincount(bins).astype(float)
    used = number > 0
    sums = [np.bincount(bins, of)[used] for of in (distance, counts, left, left**2)]
    number = number[used]
    return (sums[0] / number, sums[1] / number), number, sums[3] - sums[2] ** 2 / number


def _refuse_unclear(
    numbers: Floats,
    left: Floats,
) -> None:
    """Raise DataError where there is no clear step."""
    rise = abs(numbers[FAR_SIDE] - numbers[NEAR_SIDE])
    error = 2 * float(np.std(left)) / np.sqrt(left.size)
    if not rise > CLEAR_STEP * error:
        raise DataError(
            f"it holds no edge: the step is {rise / error:.1f} standard errors, {CLEAR_STEP:g} are needed"
        )
    rough = float(np.std(left)) / rise
    if rough > MOST_ROUGH:
        raise DataError(
            f"it holds no straight edge between two even sides: what is left varies by {rough:.0%} of the step"
        )
