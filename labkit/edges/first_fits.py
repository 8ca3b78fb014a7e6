"""From a region to its edge: a rough line, trial values of defocus, and fits on both sides of best focus.

No defocus at all is a saddle of the likelihood (thesis chapter IV), and one frame seldom tells the sides of best focus
apart: a fit starts on each side, and both ends are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from labkit.edges.edge_fit import (
    EXACTLY,
    ROUGHLY,
    TINY_VARIANCE,
    EdgeFit,
    EdgeProblem,
    EdgeState,
    LensPrior,
    fit_edges,
)
from labkit.edges.region import EDGE_SIZE, Edge, Region, mean_and_slopes
from labkit.errors import DataError
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
CELL_PX, FEWEST_IN_CELL = 6.0, 4  # of the cells whose mean residuals show structure
WIDTHS_PX = (1.0, 5.0)  # of rough edges, to begin with


@dataclass(frozen=True)
class RoughEdge:
    """An edge blurred by a Gaussian of standard deviation width_px, and the share of the variance that it explains."""

    edge: Edge
    width_px: float
    explained: float

    @property
    def rise(self) -> float:
        """Step of the edge, counts."""
        return self.edge.far - self.edge.near

    def residuals(self, region: Region) -> Floats:
        """Return counts less those of the blurred edge, (n,)."""
        across, _ = region.across_and_along(self.edge)
        return region.counts - self.edge.near - self.rise * ndtr(across / self.width_px)


def rough_edge(region: Region) -> RoughEdge:
    """Fit a straight line between two even sides, of any blur. Raises DataError for an even region."""
    x, y = region.offsets
    dark, bright = np.percentile(region.counts, (10, 90))
    if not bright > dark:
        raise DataError("it holds no edge: all of it is equally bright")
    scale = bright - dark
    counts = region.counts / scale
    variance = float(np.sum((counts - counts.mean()) ** 2))

    def residual(p: Floats) -> Floats:
        r = x * np.cos(p[0]) + y * np.sin(p[0]) - p[1]
        return np.asarray(p[2] + (p[3] - p[2]) * ndtr(r / np.exp(p[4])) - counts)

    def fitted(angle: float) -> RoughEdge:
        ends = [
            least_squares(
                residual,
                [angle, 0.0, dark / scale, bright / scale, np.log(width)],
                max_nfev=40,
                x_scale="jac",
            )
            for width in WIDTHS_PX
        ]
        end = min(ends, key=lambda e: e.cost)
        edge = Edge.of(end.x[:EDGE_SIZE] * [1, 1, scale, scale])
        return RoughEdge(
            edge, float(np.exp(min(end.x[4], 5.0))), 1 - 2 * end.cost / variance
        )

    plane = np.stack([np.ones_like(x), x, y], 1)
    slope = np.linalg.lstsq(plane, region.counts, rcond=None)[0]
    first = float(np.arctan2(slope[2], slope[1]))
    best = fitted(first)
    if best.explained < 2 * LEAST_EXPLAINED:  # try other directions than the plane's
        others = [fitted(first + turn) for turn in np.pi / 4 * np.arange(1, 8)]
        best = max([best, *others], key=lambda rough: rough.explained)
    return best


def refuse_no_edge(region: Region, rough: RoughEdge) -> None:
    """Raise DataError, one line, for a region without a clear line between two sides."""
    if rough.explained < LEAST_EXPLAINED:
        raise DataError(
            f"it holds no edge: a straight line between two even sides explains {max(rough.explained, 0):.0%} of its "
            f"variance, {LEAST_EXPLAINED:.0%} is needed"
        )
    across, _ = region.across_and_along(rough.edge)
    least = min(float(np.mean(side > 0.5 * rough.width_px)) for side in (-across, across))
    if least < LEAST_SIDE:
        raise DataError(
            f"it holds no edge with both of its sides: {least:.0%} of the pixels are on one, "
            f"{LEAST_SIDE:.0%} are needed; move the box so that the line runs through its middle"
        )
    left = rough.residuals(region)
    clear = abs(rough.rise) / (2 * left.std() / np.sqrt(left.size))
    if clear < LEAST_CLEAR:
        raise DataError(
            f"it holds no edge: the step is {clear:.1f} standard errors, {LEAST_CLEAR:g} are needed"
        )


def refuse_uneven(region: Region, rough: RoughEdge) -> None:
    """Raise DataError, one line, for a line that is not straight or sides that are not even."""
    uneven = coherent_rms(region, rough.edge, rough.residuals(region)) / abs(rough.rise)
    if uneven > MOST_UNEVEN:
        raise DataError(
            f"it holds no straight edge between two even sides: what is left varies by {uneven:.0%} of the step, at most "
            f"{MOST_UNEVEN:.0%} is allowed; take a smaller box"
        )


def coherent_rms(region: Region, edge: Edge, left: Floats) -> float:
    """Return the RMS that residuals (n,) share with their neighbours: of the means over cells, less the means' noise."""
    across, along = region.across_and_along(edge)
    key = np.floor(across / (CELL_PX / 2)) * 10_000 + np.floor(along / CELL_PX)
    _, cell, count = np.unique(key, return_inverse=True, return_counts=True)
    many = count >= FEWEST_IN_CELL
    if not many.any():
        return 0.0
    mean = np.bincount(cell, left) / count
    variance = (np.bincount(cell, left**2) / count - mean**2).clip(0)
    squares = variance * count / np.maximum(count - 1, 1) * count
    noise = np.sum(squares[many]) / np.sum(count[many])
    coherent = np.mean(mean[many] ** 2) - noise * np.mean(1 / count[many])
    return float(np.sqrt(max(coherent, 0.0)))


def likely_defocus(optics: Optics, width_px: float) -> float:
    """Return the defocus, waves RMS at the reference, that blurs an edge by a Gaussian's width.

    Defocus spreads a point over a disc 8 N times its peak to valley across, whose line-spread function has a quarter of
    the diameter as its standard deviation. The pixel's own blur is subtracted.
    """
    pixel = optics.active_um**2 / 12 + (0.3 * optics.airy_um) ** 2
    spread_um = np.sqrt(max((width_px * optics.pitch_um) ** 2 - pixel, 0.0))
    return float(4 * spread_um / blur_per_wave_um(optics.f_number, optics.reference_um))


def fit_depth(
    problem: EdgeProblem, rough: Sequence[RoughEdge], tolerance: float = EXACTLY
) -> tuple[EdgeFit, ...]:
    """Fit a problem with one defocus.

    Parameters
    ----------
    problem : regions of one depth
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
    edges = [of.edge for of in rough]
    likely = float(
        np.median(
            [
                likely_defocus(problem.optics_of(k), of.width_px)
                for k, of in enumerate(rough)
            ]
        )
    )
    far = [likely * share for share in SHARES if likely * share > max(NEAR_FOCUS)]
    trials = sorted({*NEAR_FOCUS, *far})
    even = np.array(twin_signs(problem.noll[1:])) < 0
    symmetric = not np.any(problem.lens.mean[even])
    ends = []
    for sign in (1,) if symmetric else (1, -1):
        misfit = {sign * value: _misfit(problem, edges, sign * value) for value in trials}
        best = min(misfit, key=misfit.__getitem__)
        pixels = sum(region.counts.size for region in problem.regions)
        expected = np.array([of.centre for of in problem.noise])
        noise = expected + np.log(max(misfit[best] / pixels, 1.0))
        start = problem.start([best], edges, np.asarray(noise))
        ends.append(fit_edges(problem, start, tolerance=tolerance))
    if symmetric:
        ends.append(twin(ends[0]))
    ends.sort(key=lambda end: -end.objective)
    apart = abs(ends[0].defocus()[0] - ends[-1].defocus()[0]) > SAME_DEFOCUS
    return tuple(ends) if apart else (ends[0],)


def _misfit(problem: EdgeProblem, edges: Sequence[Edge], defocus: float) -> float:
    """Return the sum of squared residuals at a defocus, in standard deviations, after a linear step of the edges."""
    waves = np.concatenate([[defocus], problem.lens.mean])
    total = 0.0
    for k, (region, edge) in enumerate(zip(problem.regions, edges, strict=True)):
        mean, by_edge, _ = mean_and_slopes(region, edge, problem.optics_of(k), waves)
        noise = problem.noise[region.frame]
        weight = 1 / np.sqrt(NormalCounts(mean, noise.gain, noise.read_variance).variance)
        left = (region.counts - mean) * weight
        slopes = (by_edge * weight).T
        change = np.linalg.lstsq(slopes, left, rcond=None)[0]
        total += float(np.sum((left - slopes @ change) ** 2))
    return total


def twin(fit: EdgeFit) -> EdgeFit:
    """Return the fit on the other side of best focus with the same image: all even modes reversed. Thesis §3.6.

    It is a fit if the prior's mean has no even modes, else only a start.
    """
    signs = np.array(twin_signs(fit.problem.noll[1:]), float)
    state = fit.state
    flips = EdgeState(
        signs,
        np.ones_like(state.log_noise),
        -np.ones_like(state.defoci),
        np.ones_like(state.edges),
    ).vector
    turned = state.at(state.vector * flips)
    return replace(fit, state=turned, covariance=fit.covariance * np.outer(flips, flips))


def fit_jointly(
    problem: EdgeProblem,
    defoci: Sequence[float],
    edges: Floats,
    groups: Sequence[int],
    log_noise: Floats,
) -> EdgeFit:
    """Fit all depths at once, with modes common to all, from fits of each depth.

    Edges join one after another, each on the side of best focus that is likelier by the modes estimated so far; the first
    edge's side is arbitrary.

    Parameters
    ----------
    problem : all regions
    defoci : (depths,) waves RMS, whose signs are ignored
    edges : (regions, 4)
    groups : for each depth its edge, whose colours are on one side of best focus
    log_noise : (frames, 2) to begin with
    """
    lens = problem.lens
    start = np.array(defoci, float)
    for group in dict.fromkeys(groups):
        depths = [depth for depth, of in enumerate(groups) if of == group]
        places = [k for k, region in enumerate(problem.regions) if region.depth in depths]
        regions = tuple(
            replace(problem.regions[k], depth=depths.index(problem.regions[k].depth))
            for k in places
        )
        part = replace(problem, regions=regions, lens=lens)
        free = lens is problem.lens and not lens.mean.any()
        own = [Edge.of(edges[k]) for k in places]
        ends = [
            fit_edges(
                part, part.start(sign * np.abs(start[depths]), own, log_noise), ROUGHLY
            )
            for sign in ((1,) if free else (1, -1))
        ]
        best = max(ends, key=lambda end: end.objective)
        lens, start[depths] = best.lens, best.state.defoci
    return fit_edges(problem, EdgeState(lens.mean.copy(), log_noise, start, edges))


def halves(fit: EdgeFit, k: int = 0) -> tuple[EdgeFit, EdgeFit] | None:
    """Fit both halves of a region along its line with the modes held; None for too few pixels."""
    region = fit.problem.regions[k]
    edge = fit.state.edge(k)
    _, along = region.across_and_along(edge)
    middle = float(np.median(along))
    alone = fit.problem.alone(k)
    modes = fit.state.modes
    held = LensPrior(modes, TINY_VARIANCE * np.eye(modes.size))
    noise = fit.state.log_noise[region.frame : region.frame + 1]
    ends = []
    for chosen in (along < middle, along >= middle):
        try:
            part = alone.regions[0].part(chosen)
        except ValueError:
            return None
        problem = replace(alone, regions=(part,), lens=held)
        start = problem.start([fit.state.defoci[region.depth]], [edge], noise)
        ends.append(fit_edges(problem, start, max_steps=15, tolerance=ROUGHLY))
    return ends[0], ends[1]
