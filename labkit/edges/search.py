"""From a region to its edge: a rough line, a row of defocus values, climbs on both sides of best focus.

No defocus at all is a saddle of the likelihood (thesis chapter IV), and one frame seldom tells the sides of best focus apart: a
climb starts on each, and both ends are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from labkit.edges.joint import (
    EXACTLY,
    ROUGHLY,
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

ROW = (
    0.55,
    0.75,
    0.9,
    1.0,
    1.15,
    1.4,
)  # of the defocus that the rough edge's width makes likely
NEAR_FOCUS = (0.06, 0.2, 0.4)  # waves RMS, tried besides
LEAST_EXPLAINED = 0.3  # of a region's variance by a rough edge
MOST_UNEVEN = 0.1  # of the step: what of sides that are to be even is no noise, RMS
LEAST_SIDE = 0.08  # of a region's pixels on either side of the blurred line
LEAST_CLEAR = 15.0  # standard errors of a step
SAME_DEFOCUS = 1e-3  # waves: ends nearer than that are one
CELL_PX = 6.0  # of the cells that coherent residuals are looked for in
FEWEST_IN_CELL = 4
TINY_VARIANCE = (
    1e-12  # waves squared: what is known of modes is a distribution, however narrow
)


@dataclass(frozen=True)
class RoughEdge:
    """An edge blurred by a Gaussian of standard deviation width_px; explained: share of the variance."""

    edge: Edge
    width_px: float
    explained: float


def rough_edge(region: Region) -> RoughEdge:
    """The straight line between two even sides that is most like a region, of any blur. Raises DataError where none is."""
    x, y = region.offsets
    plane = np.linalg.lstsq(
        np.stack([np.ones_like(x), x, y], 1), region.counts, rcond=None
    )[0]
    dark, bright = np.percentile(region.counts, (10, 90))
    if not bright > dark:
        raise DataError("it holds no edge: all of it is equally bright")
    first = float(np.arctan2(plane[2], plane[1]))
    best = _blurred(region, first, dark, bright)
    if best.explained < 2 * LEAST_EXPLAINED:  # not the plane's direction: any other
        others = [
            _blurred(region, first + turn, dark, bright)
            for turn in np.pi / 4 * np.arange(1, 8)
        ]
        best = max([best, *others], key=lambda rough: rough.explained)
    return best


def _blurred(region: Region, angle: float, dark: float, bright: float) -> RoughEdge:
    """From a direction of the normal."""
    x, y = region.offsets
    scale = bright - dark

    def residual(p: Floats) -> Floats:
        r = x * np.cos(p[0]) + y * np.sin(p[0]) - p[1]
        return np.asarray(
            p[2] + (p[3] - p[2]) * ndtr(r / np.exp(p[4])) - region.counts / scale
        )

    ends = [
        least_squares(
            residual,
            [angle, 0.0, dark / scale, bright / scale, np.log(width)],
            max_nfev=40,
            x_scale="jac",
        )
        for width in (1.0, 5.0)
    ]
    end = min(ends, key=lambda e: e.cost)
    total = float(np.sum((region.counts - region.counts.mean()) ** 2)) / scale**2
    theta = end.x[:EDGE_SIZE] * [1, 1, scale, scale]
    return RoughEdge(
        Edge.of(theta), float(np.exp(min(end.x[4], 5.0))), 1 - 2 * end.cost / total
    )


def refuse_no_edge(region: Region, rough: RoughEdge) -> None:
    """Raise DataError, one line, where a region holds no clear line with two sides."""
    if rough.explained < LEAST_EXPLAINED:
        raise DataError(
            f"it holds no edge: a straight line between two even sides explains {max(rough.explained, 0):.0%} of its "
            f"variance, {LEAST_EXPLAINED:.0%} is needed"
        )
    across, _ = region.across_and_along(rough.edge)
    sides = [float(np.mean(side > 0.5 * rough.width_px)) for side in (-across, across)]
    if min(sides) < LEAST_SIDE:
        raise DataError(
            f"it holds no edge with both of its sides: {min(sides):.0%} of the pixels are on one, "
            f"{LEAST_SIDE:.0%} are needed; move the box so that the line runs through its middle"
        )
    rise = rough.edge.far - rough.edge.near
    left = region.counts - rough.edge.near - rise * ndtr(across / rough.width_px)
    clear = abs(rise) / (2 * left.std() / np.sqrt(left.size))
    if clear < LEAST_CLEAR:
        raise DataError(
            f"it holds no edge: the step is {clear:.1f} standard errors, {LEAST_CLEAR:g} are needed"
        )


def refuse_uneven(region: Region, rough: RoughEdge) -> None:
    """Raise DataError, one line, where the line is not straight or its sides are not even."""
    across, _ = region.across_and_along(rough.edge)
    rise = rough.edge.far - rough.edge.near
    left = region.counts - rough.edge.near - rise * ndtr(across / rough.width_px)
    uneven = coherent_rms(region, rough.edge, left) / abs(rise)
    if uneven > MOST_UNEVEN:
        raise DataError(
            f"it holds no straight edge between two even sides: what is left varies by {uneven:.0%} of the step, at most "
            f"{MOST_UNEVEN:.0%} is allowed; take a smaller box"
        )


def coherent_rms(region: Region, edge: Edge, left: Floats) -> float:
    """RMS of what residuals (n,) have in common with their neighbours: of the means over cells, their noise taken off."""
    across, along = region.across_and_along(edge)
    key = np.floor(across / (CELL_PX / 2)) * 10_000 + np.floor(along / CELL_PX)
    _, cell, count = np.unique(key, return_inverse=True, return_counts=True)
    many = count >= FEWEST_IN_CELL
    mean = np.bincount(cell, left) / count
    within = (
        (np.bincount(cell, left**2) / count - mean**2).clip(0)
        * count
        / np.maximum(count - 1, 1)
    )
    if not many.any():
        return 0.0
    noise = np.sum((within * count)[many]) / np.sum(count[many])
    return float(
        np.sqrt(max(np.mean(mean[many] ** 2) - noise * np.mean(1 / count[many]), 0.0))
    )


def likely_defocus(optics: Optics, width_px: float) -> float:
    """Waves RMS at the reference that blur an edge by a Gaussian's width, the pixel's own blur taken off.

    Defocus spreads a point over a disc 8 N times its peak to valley across, whose line-spread function has a quarter of that
    as its standard deviation.
    """
    pixel = optics.active_um**2 / 12 + (0.3 * optics.airy_um) ** 2
    spread_um = np.sqrt(max((width_px * optics.pitch_um) ** 2 - pixel, 0.0))
    return float(4 * spread_um / blur_per_wave_um(optics.f_number, optics.reference_um))


def fit_depth(
    problem: EdgeProblem, rough: Sequence[RoughEdge], tolerance: float = EXACTLY
) -> tuple[EdgeFit, ...]:
    """The likeliest ends of a problem with one defocus, best first: one, or one on either side of best focus.

    rough: of its regions; tolerance: as `fit_edges` has it. Raises ValueError for a problem with several depths.
    """
    if problem.depths != 1:
        raise ValueError(f"{problem.depths} depths: one is searched at a time")
    each = [likely_defocus(problem.optics_of(k), r.width_px) for k, r in enumerate(rough)]
    likely = float(np.median(each))
    row = sorted(
        {
            *NEAR_FOCUS,
            *(likely * share for share in ROW if likely * share > max(NEAR_FOCUS)),
        }
    )
    even = np.array(twin_signs(problem.noll[1:])) < 0
    symmetric = not np.any(problem.lens.mean[even])
    ends = []
    for sign in (1,) if symmetric else (1, -1):
        misfit = {sign * value: _misfit(problem, rough, sign * value) for value in row}
        at = min(misfit, key=misfit.__getitem__)
        noise = _noise_left(problem, misfit[at])
        ends.append(
            fit_edges(
                problem,
                problem.start([at], [r.edge for r in rough], noise),
                tolerance=tolerance,
            )
        )
    if symmetric:
        ends.append(twin(ends[0]))
    ends.sort(key=lambda end: -end.objective)
    apart = abs(ends[0].defocus()[0] - ends[-1].defocus()[0]) > SAME_DEFOCUS
    return tuple(ends) if apart else (ends[0],)


def _misfit(problem: EdgeProblem, rough: Sequence[RoughEdge], defocus: float) -> float:
    """What a defocus leaves, once the edges have made one linear step. Weighed by the counts themselves."""
    waves, total = np.concatenate([[defocus], problem.lens.mean]), 0.0
    for k, (region, start) in enumerate(zip(problem.regions, rough, strict=True)):
        mean, by_edge, _ = mean_and_slopes(region, start.edge, problem.optics_of(k), waves)
        noise = problem.noise[region.frame]
        weight = 1 / np.sqrt(NormalCounts(mean, noise.gain, noise.read_variance).variance)
        left = (region.counts - mean) * weight
        slopes = (by_edge * weight).T
        total += float(
            np.sum((left - slopes @ np.linalg.lstsq(slopes, left, rcond=None)[0]) ** 2)
        )
    return total


def _noise_left(problem: EdgeProblem, misfit: float) -> Floats:
    """(frames, 2) noise to begin with: as expected, or as much larger as a misfit, squares over variance, has it."""
    pixels = sum(region.counts.size for region in problem.regions)
    return np.asarray(
        np.array([of.centre for of in problem.noise]) + np.log(max(misfit / pixels, 1.0))
    )


def twin(fit: EdgeFit) -> EdgeFit:
    """The fit on the other side of best focus that looks just the same: all even modes reversed. Thesis §3.6.

    For a prior that has none of them; elsewhere it is a start.
    """
    signs = np.array(twin_signs(fit.problem.noll[1:]), float)
    state, size = fit.state, fit.state.vector.size
    turned = replace(state, modes=state.modes * signs, defoci=-state.defoci)
    first = state.modes.size + state.log_noise.size
    flips = np.ones(size)
    flips[: state.modes.size], flips[first : first + state.defoci.size] = signs, -1
    return replace(fit, state=turned, covariance=fit.covariance * np.outer(flips, flips))


def fit_jointly(
    problem: EdgeProblem,
    defoci: Sequence[float],
    edges: Floats,
    groups: Sequence[int],
    log_noise: Floats,
) -> EdgeFit:
    """All depths at once, from what each is by itself: the modes, common to all, are what they tell together.

    defoci: (depths,) waves RMS, of which only the sizes count; edges: (regions, 4); groups: of each depth the edge that it
    is of, whose colours lie on one side of best focus; log_noise: (frames, 2) to begin with. Edges join one after another,
    each on the side that is likelier by what those before it tell of the modes; the first one's side is as good as the other.
    """
    lens, start = problem.lens, np.array(defoci, float)
    for group in dict.fromkeys(groups):
        depths = [d for d, of in enumerate(groups) if of == group]
        part, places = _of_depths(problem, depths)
        signs = (
            (1,)
            if np.array_equal(lens.mean, problem.lens.mean) and not lens.mean.any()
            else (1, -1)
        )
        size = np.abs(start[depths])
        beginnings = [
            replace(part, lens=lens).start(
                sign * size, [Edge.of(edges[k]) for k in places], log_noise
            )
            for sign in signs
        ]
        part = replace(part, lens=lens)
        best = max(
            (fit_edges(part, at, tolerance=ROUGHLY) for at in beginnings),
            key=lambda end: end.objective,
        )
        modes = best.state.modes.size
        lens = LensPrior(
            best.state.modes,
            best.covariance[:modes, :modes] + TINY_VARIANCE * np.eye(modes),
        )
        start[depths] = best.state.defoci
    return fit_edges(problem, EdgeState(lens.mean.copy(), log_noise, start, edges))


def _of_depths(
    problem: EdgeProblem, depths: Sequence[int]
) -> tuple[EdgeProblem, list[int]]:
    """Only the regions of some depths, which are numbered anew, and their places."""
    places = [k for k, region in enumerate(problem.regions) if region.depth in depths]
    regions = tuple(
        replace(r, depth=depths.index(r.depth))
        for r in (problem.regions[k] for k in places)
    )
    return replace(problem, regions=regions), places


def halves(fit: EdgeFit, k: int = 0) -> tuple[EdgeFit, EdgeFit] | None:
    """One region's two halves along its line, each fitted with the fit's modes held; None where they are too small."""
    region, edge = fit.problem.regions[k], fit.state.edge(k)
    _, along = region.across_and_along(edge)
    middle = float(np.median(along))
    waves = fit.problem.waves(fit.state, k)
    held = LensPrior(fit.state.modes, 1e-12 * np.eye(fit.state.modes.size))
    ends = []
    for chosen in (along < middle, along >= middle):
        try:
            part = replace(region.part(chosen), frame=0, depth=0, light=0)
        except ValueError:
            return None
        problem = replace(fit.problem.alone(k), regions=(part,), lens=held)
        start = problem.start(
            [float(waves[0])], [edge], fit.state.log_noise[region.frame : region.frame + 1]
        )
        ends.append(fit_edges(problem, start, max_steps=15, tolerance=ROUGHLY))
    return ends[0], ends[1]
