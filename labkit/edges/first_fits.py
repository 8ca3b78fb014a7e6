"""From a region to its edge: a rough line, trial values of defocus, and fits on both sides of best focus.

No defocus at all is a saddle of the likelihood (thesis chapter IV), and one frame seldom tells the sides of best focus
apart: a fit starts on each side, and both ends are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.special import ndtr

from labkit.edges.edge_fit import (
    EXACTLY,
    ROUGHLY,
    EdgeFit,
    EdgeProblem,
    EdgeState,
    LensPrior,
    fit_edges,
)
from labkit.edges.region import (
    BOW_NUMBERS,
    LIGHT_NUMBERS,
    LINE_NUMBERS,
    MOST_BOW_ORDER,
    Edge,
    Region,
    blurred_slopes,
    mean_and_slopes,
)
from labkit.errors import DataError
from labkit.estimation.identifiability import inverse
from labkit.estimation.likelihood import NormalCounts
from labkit.imaging.optics import Optics
from labkit.optics.lens import blur_per_wave_um
from labkit.optics.zernike import twin_signs
from labkit.types import Floats

SHARES = (0.55, 0.75, 0.9, 1.0, 1.15, 1.4)
"""Trial values of defocus, relative to the value by the width of the rough edge."""

NEAR_FOCUS = (0.06, 0.2, 0.4)  # further trial values, waves RMS
LEAST_EXPLAINED = 0.3  # share of a region's variance, by a rough edge
MOST_UNEVEN = 0.1  # of the step: structure of sides that should be even, RMS
LEAST_SIDE = 0.08  # share of a region's pixels on either side of the blurred line
LEAST_CLEAR = 15.0  # standard errors of a step
SAME_DEFOCUS = 1e-3  # waves: nearer ends are one
CELL_PX = 6.0  # length of the cells whose mean residuals show structure, twice their depth
FEWEST_IN_CELL = 4
WIDTHS_PX = (1.0, 5.0)  # of rough edges, to begin with
LARGEST_LOG_WIDTH = 5.0
MOST_ROUGH_STEPS = 30  # of a rough fit
NO_STRAIGHT_EDGE = (
    "it holds no straight edge between two even sides: what {left} varies by {share:.0%} of the step, at most {most:.0%} is "
    "allowed; take a smaller box"
)


@dataclass(frozen=True)
class RoughEdge:
    """The edge of a region, with the free numbers of its shape, blurred by a Gaussian of standard deviation width_px."""

    region: Region
    edge: Edge
    width_px: float

    @cached_property
    def residuals(self) -> Floats:
        """Counts less the blurred edge's, (n,)."""
        return np.asarray(self.region.counts - self.mean_and_slopes()[0])

    def mean_and_slopes(self) -> tuple[Floats, Floats]:
        """Return mean counts (n,), and slopes (k + 1, n) by the edge's free numbers and by the logarithm of the width."""
        at = self.region.placed(self.edge)
        r = at.across / self.width_px
        line = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi) / self.width_px
        turning = np.zeros_like(r)
        mean, slopes = blurred_slopes(self.region, self.edge, at, ndtr(r), line, turning)
        by_width = -self.edge.rise * at.light * line * at.across
        return mean, np.vstack([slopes, by_width])

    def with_shape(self) -> RoughEdge:
        """Return the edge with as many numbers of its shape, and of uneven light, as the counts call for.

        Their number is that of the least Bayesian information criterion, by the costs of leaving numbers out of a fit with all.
        """
        every = _settled(replace(self, region=replace(self.region, order=5, even=False)))
        left = every.residuals
        _, slopes = every.mean_and_slopes()
        information = slopes @ slopes.T
        scale = np.sqrt(np.diag(information))
        covariance = inverse(information / np.outer(scale, scale))
        numbers = np.array(every.edge)[every.region.free] * scale[:-1]
        costs = {}
        for order, even in product(range(1, MOST_BOW_ORDER + 1), (True, False)):
            out = [*BOW_NUMBERS[order - 1 :], *(LIGHT_NUMBERS if even else ())]
            fall = 0.0
            if out:
                within = np.linalg.inv(covariance[np.ix_(out, out)])
                fall = float(numbers[out] @ within @ numbers[out]) / float(np.mean(left**2))
            saved = len(out) * np.log(left.size)
            costs[order, even] = fall - saved
        order, even = min(costs, key=lambda of: costs[of])
        return _settled(replace(self, region=replace(self.region, order=order, even=even)))

    @property
    def explained(self) -> float:
        """Share of the counts' variance explained by the edge."""
        return float(1 - np.mean(self.residuals**2) / np.var(self.region.counts))

    def refuse_no_edge(self) -> None:
        """Raise DataError, one line, for a region without a clear line between two sides."""
        if self.explained < LEAST_EXPLAINED:
            raise DataError(
                f"it holds no edge: a straight line between two even sides explains {max(self.explained, 0):.0%} of its "
                f"variance, {LEAST_EXPLAINED:.0%} is needed"
            )
        across, _ = self.region.across_and_along(self.edge)
        least = min(np.mean(side > 0.5 * self.width_px) for side in (-across, across))
        if least < LEAST_SIDE:
            raise DataError(
                f"it holds no edge with both of its sides: {least:.0%} of the pixels are on one, "
                f"{LEAST_SIDE:.0%} are needed; move the box so that the line runs through its middle"
            )
        error = 2 * self.residuals.std() / np.sqrt(self.residuals.size)
        if abs(self.edge.rise) < LEAST_CLEAR * error:
            raise DataError(
                f"it holds no edge: the step is {abs(self.edge.rise) / error:.1f} standard errors, "
                f"{LEAST_CLEAR:g} are needed"
            )

    def refuse_uneven(self) -> None:
        """Raise DataError, one line, for a curved line or uneven sides."""
        refuse_structure(self.region, self.edge, self.residuals, "is left", MOST_UNEVEN)


def rough_edge(region: Region) -> RoughEdge:
    """Fit a straight line between two even sides, of any blur. Raises DataError for an even region."""
    dark, bright = np.percentile(region.counts, (10, 90))
    if not bright > dark:
        raise DataError("it holds no edge: all of it is equally bright")
    scale = bright - dark
    scaled = replace(region, counts=region.counts / scale)

    def blurred(numbers: Floats) -> RoughEdge:
        width_px = float(np.exp(min(numbers[-1], LARGEST_LOG_WIDTH)))
        return RoughEdge(scaled, Edge(*numbers[:-1].tolist()), width_px)

    def residuals(numbers: Floats) -> Floats:
        return blurred(numbers).residuals

    def fitted(angle: float) -> RoughEdge:
        light = [0.0, dark / scale, bright / scale]
        starts = [[angle, *light, np.log(width)] for width in WIDTHS_PX]
        ends = [
            least_squares(residuals, start, max_nfev=40, x_scale="jac").x
            for start in starts
        ]
        return max(map(blurred, ends), key=lambda rough: rough.explained)

    plane = np.stack([np.ones(region.counts.size), *region.offsets], 1)
    slope = np.linalg.lstsq(plane, region.counts, rcond=None)[0]
    first = float(np.arctan2(slope[2], slope[1]))
    best = fitted(first)
    if best.explained < 2 * LEAST_EXPLAINED:  # try other directions than the plane's
        others = [fitted(first + turn) for turn in np.pi / 4 * np.arange(1, 8)]
        best = max([best, *others], key=lambda rough: rough.explained)
    angle, distance_px, near, far, *_ = best.edge
    edge = Edge(angle, distance_px, near * scale, far * scale)
    return RoughEdge(region, edge, best.width_px)


def _settled(rough: RoughEdge) -> RoughEdge:
    """Fit all free numbers of an edge, and its width, from a start."""
    free = rough.region.free
    rise = abs(rough.edge.rise)
    scale = np.ones(len(Edge._fields))
    scale[2:LINE_NUMBERS] = rise

    def at(numbers: Floats) -> RoughEdge:
        edge = np.zeros(len(Edge._fields))
        edge[free] = numbers[:-1] * scale[free]
        width_px = float(np.exp(min(numbers[-1], LARGEST_LOG_WIDTH)))
        return replace(rough, edge=Edge(*edge.tolist()), width_px=width_px)

    def slopes(numbers: Floats) -> Floats:
        _, by_number = at(numbers).mean_and_slopes()
        return np.asarray(-by_number.T * np.append(scale[free], 1.0) / rise)

    def residuals(numbers: Floats) -> Floats:
        return at(numbers).residuals / rise

    start = np.append(np.array(rough.edge)[free] / scale[free], np.log(rough.width_px))
    end = least_squares(residuals, start, slopes, max_nfev=MOST_ROUGH_STEPS)
    return at(end.x)


def refuse_structure(
    region: Region, edge: Edge, residuals: Floats, left: str, most: float
) -> None:
    """Raise DataError, one line, for residuals (n,) common to neighbours.

    left : what leaves the residuals, in words
    most : largest RMS of the cells' means, without their noise, over the step
    """
    across, along = region.across_and_along(edge)
    cells = np.floor(np.stack([2 * across, along]) / CELL_PX)
    _, cell, count = np.unique(cells, axis=1, return_inverse=True, return_counts=True)
    many = np.flatnonzero(count >= FEWEST_IN_CELL)
    if not many.size:
        return
    count = count[many]
    mean, variance = (
        np.asarray(of(residuals, cell.ravel(), many))
        for of in (ndimage.mean, ndimage.variance)
    )
    noise = np.average(variance * count / (count - 1), weights=count)
    coherent = np.mean(mean**2) - noise * np.mean(1 / count)
    share = float(np.sqrt(max(coherent, 0.0))) / abs(edge.rise)
    if share > most:
        raise DataError(NO_STRAIGHT_EDGE.format(left=left, share=share, most=most))


def likely_defocus(optics: Optics, width_px: float) -> float:
    """Return the defocus, waves RMS at the reference, with a Gaussian's blur of an edge.

    Defocus spreads a point over a disc 8 N times its peak to valley across, whose line-spread function has a quarter of
    the diameter as its standard deviation. The pixel's own blur is subtracted.
    """
    pixel = optics.active_um**2 / 12 + (0.3 * optics.airy_um) ** 2
    spread_um = np.sqrt(max((width_px * optics.pitch_um) ** 2 - pixel, 0.0))
    return float(4 * spread_um / blur_per_wave_um(optics.f_number, optics.reference_um))


def fit_depth(
    problem: EdgeProblem, rough: Sequence[RoughEdge], tolerance: float = EXACTLY
) -> tuple[EdgeFit, ...]:
    """Fit a problem with a common defocus.

    Parameters
    ----------
    problem : regions of equal depth
    rough : the rough edge of each region
    tolerance : as in `fit_edges`

    Returns
    -------
    the likeliest ends, best first: one, or one on each side of best focus

    Raises
    ------
    ValueError : the problem has several depths
    """
    if problem.depths != 1:
        raise ValueError(f"{problem.depths} depths: one is searched at a time")
    regions = [
        replace(region, order=of.region.order, even=of.region.even)
        for region, of in zip(problem.regions, rough, strict=True)
    ]
    ends = _both_sides(replace(problem, regions=tuple(regions)), rough, tolerance)
    uneven = [k for k, region in enumerate(regions) if not region.even]
    seeming = [k for k in uneven if not _light_is_uneven(ends[0], k)]
    if not seeming:
        return ends
    # a Gaussian's tails are not the camera's: light that only made up for the difference is left out
    even = list(rough)
    for k in seeming:
        regions[k] = replace(regions[k], even=True)
        even[k] = replace(rough[k], edge=rough[k].edge._replace(across=0, along=0, twist=0))
    return _both_sides(replace(problem, regions=tuple(regions)), even, tolerance)


def _light_is_uneven(fit: EdgeFit, k: int) -> bool:
    """Return whether the counts of a region call for uneven light, by the Bayesian information criterion."""
    places = fit.state.places.edges[k, list(LIGHT_NUMBERS)]
    light = fit.state.edges[k, list(LIGHT_NUMBERS)]
    gain = float(light @ np.linalg.solve(fit.among(places), light))
    return gain > light.size * float(np.log(fit.problem.regions[k].counts.size))


def _both_sides(
    problem: EdgeProblem, rough: Sequence[RoughEdge], tolerance: float
) -> tuple[EdgeFit, ...]:
    """Return the ends of fits on both sides of best focus, the likelier first; of equal ones only that."""
    edges = [of.edge for of in rough]
    widths = enumerate(of.width_px for of in rough)
    likely = np.median([likely_defocus(problem.optics_of(k), w) for k, w in widths])
    far = [likely * share for share in SHARES if likely * share > max(NEAR_FOCUS)]
    pixels = sum(region.counts.size for region in problem.regions)
    symmetric = not problem.lens.mean[np.array(twin_signs(problem.noll[1:])) < 0].any()
    ends = []
    for sign in (1,) if symmetric else (1, -1):
        trials = [sign * value for value in sorted({*NEAR_FOCUS, *far})]
        misfit, best = min((_misfit(problem, edges, value), value) for value in trials)
        noise = problem.usual_noise + np.log(max(misfit / pixels, 1.0))
        ends.append(fit_edges(problem, problem.start([best], edges, noise), tolerance))
    if symmetric:
        ends.append(twin(ends[0]))
    ends.sort(key=lambda end: -end.objective)
    apart = abs(ends[0].defocus()[0] - ends[-1].defocus()[0]) > SAME_DEFOCUS
    return tuple(ends if apart else ends[:1])


def _misfit(problem: EdgeProblem, edges: Sequence[Edge], defocus: float) -> float:
    """Return the sum of squared residuals at a defocus, in standard deviations, after a linear step of the edges."""
    waves = np.append(defocus, problem.lens.mean)
    total = 0.0
    for k, (region, edge) in enumerate(zip(problem.regions, edges, strict=True)):
        mean, by_edge, _ = mean_and_slopes(region, edge, problem.optics_of(k), waves)
        noise = problem.noise[region.frame]
        counts = NormalCounts(mean, noise.gain, noise.read_variance)
        left = (region.counts - mean) / np.sqrt(counts.variance)
        slopes = (by_edge / np.sqrt(counts.variance)).T
        change = np.linalg.lstsq(slopes, left, rcond=None)[0]
        total += float(np.sum((left - slopes @ change) ** 2))
    return total


def twin(fit: EdgeFit) -> EdgeFit:
    """Return the fit on the other side of best focus with the same image: all even modes reversed. Thesis §3.6.

    It is a fit if the prior's mean has no even modes, else only a start.
    """
    state = fit.state
    signs = np.array(twin_signs(fit.problem.noll[1:]), float)
    same = state.at(np.ones(state.vector.size))
    flips = replace(same, modes=signs, defoci=-same.defoci).vector
    turned = state.at(state.vector * flips)
    return replace(fit, state=turned, covariance=fit.covariance * np.outer(flips, flips))


def fit_jointly(problem: EdgeProblem, start: EdgeState, groups: Sequence[int]) -> EdgeFit:
    """Fit all depths at once, with modes common to all, from fits of each depth.

    Edges join one after another, each on the likelier side of best focus by the modes estimated so far; the first
    edge's side is arbitrary.

    Parameters
    ----------
    problem : all regions
    start : where to begin; the signs of its defoci are ignored
    groups : for each depth its edge, whose colours are on one side of best focus
    """
    lens = problem.lens
    defoci = start.defoci.copy()
    for group in dict.fromkeys(groups):
        depths = [depth for depth, of in enumerate(groups) if of == group]
        places = [k for k, region in enumerate(problem.regions) if region.depth in depths]
        regions = [problem.regions[k] for k in places]
        regions = [replace(of, depth=depths.index(of.depth)) for of in regions]
        part = replace(problem, regions=tuple(regions), lens=lens)
        starts = [
            part.start(sign * np.abs(defoci[depths]), start.edges[places], start.log_noise)
            for sign in ((1, -1) if lens.mean.any() else (1,))
        ]
        ends = [fit_edges(part, at, ROUGHLY) for at in starts]
        best = max(ends, key=lambda end: end.objective)
        lens = best.lens
        defoci[depths] = best.state.defoci
    return fit_edges(problem, replace(start, modes=lens.mean.copy(), defoci=defoci))


def halves(fit: EdgeFit, k: int = 0) -> list[EdgeFit]:
    """Fit both halves of a region along its line with the modes held; none for too few pixels."""
    region = fit.problem.regions[k]
    edge = fit.state.edge(k)
    _, along = region.across_and_along(edge)
    alone = replace(fit.problem.alone(k), lens=LensPrior.known(fit.state.modes))
    # a half shows too little of the shape: that of the whole stays
    whole = replace(alone.regions[0], order=1, even=True)
    before = along < np.median(along)
    try:
        parts = [whole.part(chosen) for chosen in (before, ~before)]
    except ValueError:
        return []
    problems = [replace(alone, regions=(part,)) for part in parts]
    defocus = fit.state.defoci[region.depth]
    noise = fit.state.log_noise[[region.frame]]
    return [
        fit_edges(of, of.start([defocus], [edge], noise), ROUGHLY, max_steps=15)
        for of in problems
    ]
