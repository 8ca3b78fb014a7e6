"""Fits of several boxes with something in common: a wavefront that is estimated with them, or the range that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.edges.box_fit import BoxFit, fit_box
from labkit.edges.boxes import Place
from labkit.edges.defocus_sides import near_focus, side_of
from labkit.edges.edge_fit import EdgeFit, EdgeProblem, fit_edges
from labkit.edges.first_fits import fit_jointly, twin
from labkit.edges.ranges import Side
from labkit.edges.region import Region
from labkit.types import Floats

MOST_JOINT = 10  # boxes that a wavefront is estimated with: more add little information, and take long
CONTRADICTS = 5.0  # standard errors from the mean of the others
ALIKE_WAVES = 0.01  # RMS by which defoci of one range may differ, for a curved field and a tilted sensor

Fits = dict[Place, dict[str, BoxFit]]
"""By box and channel."""


def in_common(fits: Fits, one_range: bool) -> Fits:
    """Fit boxes again with what they have in common.

    With a given wavefront only a declared range is common. A wavefront that is estimated is common to all edges and
    colours, and does not determine the side of best focus.
    """
    first = next((of for by_name in fits.values() for of in by_name.values()), None)
    if first is None:
        return fits
    if not first.task.camera.given:
        return _with_wavefront(fits, one_range)
    return _of_one_range(fits) if one_range else fits


def correlation(fits: Sequence[BoxFit]) -> Floats | None:
    """Return the correlation (colours, colours) of the errors of a box's defoci; None for separate fits."""
    if any(of.fit is not fits[0].fit for of in fits):
        return None
    covariance = fits[0].fit.defocus_covariance([of.depth for of in fits])
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


def contradictions(fits: Fits) -> dict[Place, str]:
    """Return the boxes that contradict the range that all are declared to have, each with a sentence."""
    found: dict[Place, str] = {}
    for name in _names(fits):
        boxes = {p: of[name] for p, of in fits.items() if name in of and p not in found}
        ends = [end.defocus() for end in _one_side([*boxes.values()])]
        value = np.array([defocus for defocus, _ in ends])
        std = np.hypot([error for _, error in ends], ALIKE_WAVES)
        places = [*boxes]
        left = list(range(len(boxes)))
        while len(left) > 1:
            pulls = {}
            for k in left:
                others = [j for j in left if j != k]
                mean, error = _mean(value[others], std[others])
                pull = abs(value[k] - mean) / float(np.hypot(std[k], error))
                pulls[k] = pull, float(std[k]), mean, error
            worst = max(left, key=lambda k: (round(pulls[k][0], 6), pulls[k][1]))
            pull, own, mean, error = pulls[worst]
            if pull < CONTRADICTS:
                break
            found[places[worst]] = (
                f"declared to be at one range with the others, but its defocus, {value[worst]:.3f} ± {own:.3f} waves, "
                f"contradicts theirs, {mean:.3f} ± {error:.3f}"
            )
            left.remove(worst)
    return found


def _names(fits: Fits) -> list[str]:
    """Return the names of all channels."""
    return list(dict.fromkeys(name for by_name in fits.values() for name in by_name))


def _mean(value: Floats, std: Floats) -> tuple[float, float]:
    """Return the weighted mean of numbers, and its standard error."""
    weight = 1 / std**2
    return float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)


def _one_side(fits: Sequence[BoxFit]) -> list[EdgeFit]:
    """Return an end of each fit, all on the side of best focus that is likelier and agrees better."""
    best = [of.fit for of in fits]
    least = np.inf
    for sign in (1, -1):
        ends = [max(of.ends, key=lambda end: sign * end.defocus()[0]) for of in fits]
        value = np.array([end.defocus()[0] for end in ends])
        std = np.hypot([end.defocus()[1] for end in ends], ALIKE_WAVES)
        mean, _ = _mean(value, std)
        # a contradiction counts for no more than it takes to be found
        cost = float(np.sum(np.minimum(((value - mean) / std) ** 2, CONTRADICTS**2)))
        cost -= 2 * sum(
            end.objective - of.fit.objective for end, of in zip(ends, fits, strict=True)
        )
        if cost < least:
            best = ends
            least = cost
    return best


def _of_one_range(fits: Fits) -> Fits:
    """Fit the boxes of each colour with one defocus, the wavefront given."""
    found: Fits = {place: {} for place in fits}
    for name in _names(fits):
        boxes = {place: of[name] for place, of in fits.items() if name in of}
        every = [*boxes.values()]
        ends = _one_side(every)
        task = every[0].task.problem
        regions = tuple(region for of in every for region in of.task.regions)
        problem = EdgeProblem(task.optics, regions, task.noise, task.lens)
        start, _ = _mean(*np.array([end.defocus() for end in ends]).T)
        edges = [end.state.edge(k) for end in ends for k in range(len(end.state.edges))]
        fit = fit_edges(problem, problem.start([start], edges))
        sides = near_focus(fit) or _both(fit, every)
        first = 0
        for place, of in boxes.items():
            found[place][name] = replace(of, ends=(fit,), sides=sides, first=first)
            first += len(of.task.regions)
    return found


def _both(fit: EdgeFit, fits: Sequence[BoxFit]) -> tuple[Side, ...]:
    """Return the side of a fit of one depth, and the other side if each box by itself may be on it."""
    sign = np.sign(fit.defocus()[0])
    lost = 0.0
    values = []
    for of in fits:
        other = [end for end in of.ends if np.sign(end.defocus()[0]) != sign]
        same = [end for end in of.ends if np.sign(end.defocus()[0]) == sign]
        if not other:
            return (side_of(fit),)
        lost += other[0].objective - (same or other)[0].objective
        values.append(other[0].defocus())
    return side_of(fit), Side(*_mean(*np.array(values).T), fit.objective + lost)


def _with_wavefront(fits: Fits, one_range: bool) -> Fits:
    """Fit the clearest boxes in all colours with one wavefront, and the others with the wavefront so estimated."""
    clear = sorted(
        fits, key=lambda place: min(of.fit.edge_std(0)[1] for of in fits[place].values())
    )
    few = clear if one_range else clear[:MOST_JOINT]
    found = _fitted_along({place: fits[place] for place in few}, one_range)
    lens = next(iter(found[few[0]].values())).fit.lens
    for place in clear[len(few) :]:
        found[place] = {}
        for name, of in fits[place].items():
            camera = replace(of.task.camera, lens=lens, given=True)
            known = fit_box(replace(of.task, camera=camera, planes=()))
            ends = known.ends or of.ends
            side = known.sides[0] if known.sides else side_of(ends[0])
            sides = side, replace(side, defocus=-side.defocus)
            found[place][name] = replace(of, ends=ends, sides=sides)
    return found


def _fitted_along(fits: Fits, one_range: bool) -> Fits:
    """Fit boxes in all colours and the wavefront together."""
    names = _names(fits)
    boxes = [of for by_name in fits.values() for of in by_name.values()]
    of_name = {name: [f[name] for f in fits.values() if name in f] for name in names}
    tasks = [of_name[name][0].task for name in names]
    regions: list[Region] = []
    defoci: dict[int, float] = {}
    groups: dict[int, int] = {}
    placed: dict[int, tuple[int, int]] = {}
    for group, by_name in enumerate(fits.values()):
        for name, of in by_name.items():
            light = names.index(name)
            depth = light if one_range else len(defoci)
            placed[id(of)] = len(regions), depth
            defoci.setdefault(depth, of.fit.defocus()[0])
            groups.setdefault(depth, 0 if one_range else group)
            for region in of.task.regions:
                frame = region.frame + len(of.task.regions) * light
                regions.append(replace(region, frame=frame, depth=depth, light=light))
    joint = fit_jointly(
        EdgeProblem(
            tuple(task.camera.optics for task in tasks),
            tuple(regions),
            tuple(noise for task in tasks for noise in task.problem.noise),
            tasks[0].camera.lens,
        ),
        [*defoci.values()],
        np.concatenate([of.fit.state.edges for of in boxes]),
        [*groups.values()],
        np.concatenate(
            [
                np.median([of.fit.state.log_noise for of in of_name[name]], axis=0)
                for name in names
            ]
        ),
    )
    other = twin(joint)

    def standing(of: BoxFit) -> BoxFit:
        first, depth = placed[id(of)]
        sides = side_of(joint, depth), side_of(other, depth)
        return replace(of, ends=(joint,), sides=sides, first=first, depth=depth)

    return {
        place: {name: standing(of) for name, of in by_name.items()}
        for place, by_name in fits.items()
    }
