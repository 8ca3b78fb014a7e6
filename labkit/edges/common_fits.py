"""Fits of several boxes with something in common: an estimated wavefront, or a shared range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import gmean

from labkit.edges.blur import Motion, Sharpening
from labkit.edges.box_fit import BoxFit, fit_box
from labkit.edges.boxes import Place
from labkit.edges.defocus_sides import near_focus, side_of
from labkit.edges.edge_fit import EdgeFit, EdgeProblem, fit_edges
from labkit.edges.first_fits import fit_jointly, twin
from labkit.edges.ranges import Side
from labkit.edges.region import Region
from labkit.estimation.climb import NoisePrior
from labkit.types import Floats

MOST_JOINT = 10  # boxes that a wavefront is estimated with: more add little information, and take long
CONTRADICTS = 5.0  # standard errors from the mean of the others
OTHER_DIRECTION = np.sqrt(0.5)  # sine between the normals of edges
ALIKE_WAVES = 0.01  # RMS by which defoci of one range may differ, for a curved field and a tilted sensor


def in_common(boxes: Sequence[BoxFit], one_range: bool) -> list[BoxFit]:
    """Fit boxes again with what they have in common.

    With a given wavefront only a declared range is common. An estimated wavefront is common to all edges and
    colours, and does not determine the side of best focus; where it contradicts an edge that its own wavefront explains,
    as motion in one direction makes it, each edge keeps its own.
    """
    if boxes and not boxes[0].task.camera.given:
        return _with_wavefront(boxes, one_range)
    if not one_range:
        return list(boxes)
    return [of for every in by_channel(boxes).values() for of in _of_one_range(every)]


def by_channel(boxes: Sequence[BoxFit]) -> dict[str, list[BoxFit]]:
    """Return the boxes of each colour."""
    names = dict.fromkeys(of.channel for of in boxes)
    return {name: [of for of in boxes if of.channel == name] for name in names}


def name_motion(boxes: Sequence[BoxFit]) -> list[BoxFit]:
    """Return boxes with motion as the cause of a blur that edges of the other direction lack.

    Diffusion and filters blur all directions.
    """

    def angle(box: BoxFit) -> float:
        return box.fit.state.edge(box.first).angle

    named = []
    for of in boxes:
        others = [
            other
            for other in boxes
            if other.channel == of.channel
            and abs(np.sin(angle(other) - angle(of))) > OTHER_DIRECTION
        ]
        clean = [other for other in others if not other.cause and not other.contradicted]
        odd = of.contradicted or bool(of.cause)
        blurred = odd and of.cause != Sharpening.words
        named.append(replace(of, cause=Motion.words) if blurred and clean else of)
    return named


def correlation(boxes: Sequence[BoxFit]) -> Floats | None:
    """Return the correlation (colours, colours) of the errors of a box's defoci; None for separate fits."""
    fit = boxes[0].fit
    if any(of.fit is not fit for of in boxes):
        return None
    covariance = fit.among(fit.state.places.defoci[[of.depth for of in boxes]])
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


def contradictions(boxes: Sequence[BoxFit]) -> dict[Place, str]:
    """Return the boxes in contradiction to a declared common range, each with a sentence."""
    found: dict[Place, str] = {}
    for every in by_channel(boxes).values():
        left = [of for of in every if of.task.place not in found]
        value, std = _defoci(_one_side(left))
        while len(left) > 1:
            weight = 1 / std**2
            others = weight.sum() - weight
            mean = (weight @ value - weight * value) / others
            error = 1 / np.sqrt(others)
            pull = np.abs(value - mean) / np.hypot(std, error)
            k = max(range(len(left)), key=lambda j: (pull[j].round(6), std[j]))
            if pull[k] < CONTRADICTS:
                break
            found[left.pop(k).task.place] = (
                f"declared to be at one range with the others, but its defocus, {value[k]:.3f} ± {std[k]:.3f} waves, "
                f"contradicts theirs, {mean[k]:.3f} ± {error[k]:.3f}"
            )
            value, std = np.delete([value, std], k, axis=1)
    return found


def _defoci(ends: Sequence[EdgeFit]) -> Floats:
    """Return defoci and their errors (2, n) as of a common range, waves."""
    value, std = np.reshape([end.defocus() for end in ends], (-1, 2)).T
    return np.stack([value, np.hypot(std, ALIKE_WAVES)])


def _mean(value: Floats, std: Floats) -> tuple[float, float]:
    """Return the weighted mean of numbers, and its standard error."""
    weight = 1 / std**2
    return float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)


def _one_side(boxes: Sequence[BoxFit]) -> list[EdgeFit]:
    """Return an end of each fit, all on the likelier side of best focus, with better agreement."""
    costs = []
    for sign in (1, -1):
        ends = [max(of.ends, key=lambda end: sign * end.defocus()[0]) for of in boxes]
        value, std = _defoci(ends)
        pulls = (value - _mean(value, std)[0]) / std
        # a contradiction counts for no more than it takes to be found
        agreement = float(np.minimum(pulls**2, CONTRADICTS**2).sum())
        lost = sum(
            of.fit.objective - end.objective for of, end in zip(boxes, ends, strict=True)
        )
        costs.append((agreement + 2 * lost, ends))
    return min(costs, key=lambda of: of[0])[1]


def joint_problem(
    boxes: Sequence[BoxFit], depths: Sequence[int]
) -> tuple[EdgeProblem, list[BoxFit]]:
    """Return the problem of boxes in any colours, each at a depth, and the boxes with their places in it."""
    tasks = {name: of[0].task for name, of in by_channel(boxes).items()}
    regions: list[Region] = []
    placed = []
    for of, depth in zip(boxes, depths, strict=True):
        light = [*tasks].index(of.channel)
        placed.append(replace(of, first=len(regions), depth=depth))
        first = light * len(of.task.regions)
        regions += [
            replace(region, frame=first + region.frame, depth=depth, light=light)
            for region in of.task.regions
        ]
    problems = [task.problem for task in tasks.values()]
    problem = EdgeProblem(
        tuple(of.optics[0] for of in problems),
        tuple(regions),
        tuple(noise for every in by_channel(boxes).values() for noise in _noises(every)),
        problems[0].lens,
    )
    return problem, placed


def _noises(boxes: Sequence[BoxFit]) -> list[NoisePrior]:
    """Return the noise of each frame of a colour: the geometric mean over boxes."""
    every = [of.task.problem.noise for of in boxes]
    noises = []
    for frame in zip(*every, strict=True):
        gains = [of.gain for of in frame]
        variances = [of.read_variance for of in frame]
        gain = float(gmean(gains))
        read_variance = float(gmean(variances))
        noises.append(replace(frame[0], gain=gain, read_variance=read_variance))
    return noises


def _of_one_range(boxes: Sequence[BoxFit]) -> list[BoxFit]:
    """Fit the boxes of a colour with a common defocus, the wavefront given."""
    ends = _one_side(boxes)
    problem, placed = joint_problem(boxes, [0] * len(boxes))
    start, _ = _mean(*np.array([end.defocus() for end in ends]).T)
    edges = np.concatenate([end.state.edges for end in ends])
    fit = fit_edges(problem, problem.start([start], edges))
    sides = near_focus(fit) or _both(fit, boxes)
    return [replace(of, ends=(fit,), sides=sides).compared() for of in placed]


def _both(fit: EdgeFit, boxes: Sequence[BoxFit]) -> tuple[Side, ...]:
    """Return the side of a fit of one depth, and the other side if each box by itself may be on it."""
    beyond = fit.defocus()[0] > 0
    lost = 0.0
    values = []
    for of in boxes:
        ends = {end.defocus()[0] > 0: end for end in of.ends[::-1]}
        other = ends.get(not beyond)
        if other is None:
            return (side_of(fit),)
        lost += other.objective - ends.get(beyond, other).objective
        values.append(other.defocus())
    return side_of(fit), Side(*_mean(*np.array(values).T), fit.objective + lost)


def _with_wavefront(boxes: Sequence[BoxFit], one_range: bool) -> list[BoxFit]:
    """Fit the clearest boxes in all colours with a common wavefront, and the others with the wavefront so estimated."""
    error: dict[Place, float] = {}
    for of in boxes:
        known = error.get(of.task.place, np.inf)
        error[of.task.place] = min(known, of.fit.std.edges[0, 1])
    clear = sorted(boxes, key=lambda of: error[of.task.place])
    few = [*dict.fromkeys(of.task.place for of in clear)]
    few = few if one_range else few[:MOST_JOINT]
    joint = _fitted_along([of for of in clear if of.task.place in few], one_range)
    others = [of for of in clear if of.task.place not in few]
    together = joint + [_with_lens(of, joint[0].fit) for of in others]
    if not one_range and _pulled(together, clear):
        return [_alone(of) for of in clear]
    return together


def _pulled(together: Sequence[BoxFit], alone: Sequence[BoxFit]) -> bool:
    """Return whether a common wavefront contradicts an edge that its own does not."""
    own = {(of.task.place, of.channel): of for of in alone}
    return any(
        of.contradicted and not own[of.task.place, of.channel].contradicted
        for of in together
    )


def _alone(box: BoxFit) -> BoxFit:
    """Return a box with its own wavefront, which does not determine the side of best focus."""
    fit = fit_edges(box.fit.problem, box.fit.state)
    ends = (fit, twin(fit))
    return replace(box, ends=ends, sides=tuple(map(side_of, ends))).compared()


def _with_lens(box: BoxFit, joint: EdgeFit) -> BoxFit:
    """Fit a box with the wavefront estimated from others."""
    camera = replace(box.task.camera, lens=joint.lens, given=True)
    known = fit_box(replace(box.task, camera=camera, planes=()))
    ends = known.ends or box.ends
    side = known.sides[0] if known.sides else side_of(ends[0])
    sides = (side, replace(side, defocus=-side.defocus))
    return replace(box, ends=ends, sides=sides).compared()


def _fitted_along(boxes: Sequence[BoxFit], one_range: bool) -> list[BoxFit]:
    """Fit boxes in all colours and the wavefront together."""
    colours = by_channel(boxes)
    names = [*colours]
    depths = [names.index(of.channel) if one_range else k for k, of in enumerate(boxes)]
    problem, placed = joint_problem(boxes, depths)
    first = [depths.index(depth) for depth in range(problem.depths)]
    noise = [
        np.median([of.fit.state.log_noise for of in every], axis=0)
        for every in colours.values()
    ]
    start = problem.start(
        [boxes[k].fit.defocus()[0] for k in first],
        np.concatenate([of.fit.state.edges for of in boxes]),
        np.concatenate(noise),
    )
    places = [*dict.fromkeys(of.task.place for of in boxes)]
    groups = [0 if one_range else places.index(boxes[k].task.place) for k in first]
    joint = fit_jointly(problem, start, groups)
    ends = (joint, twin(joint))
    return [
        replace(
            of, ends=(joint,), sides=tuple(side_of(end, of.depth) for end in ends)
        ).compared()
        for of in placed
    ]
