"""What edges have in common: nothing, a wavefront that is fitted along, or the range that they are declared to have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.box_fit import BoxFit, fit_box
from labkit.edges.boxes import Place
from labkit.edges.joint import EdgeFit, EdgeProblem, LensPrior
from labkit.edges.one_range import fit_together
from labkit.edges.profile import near_focus, side_of
from labkit.edges.ranges import Side
from labkit.edges.region import Region
from labkit.edges.search import fit_jointly, twin
from labkit.types import Floats

MOST_JOINT = 10  # boxes that a wavefront is fitted along with: what more of them tell of it is little, and they take long

Fits = Mapping[Place, Mapping[str, BoxFit]]
"""By box and channel."""


@dataclass(frozen=True)
class Standing:
    """Of one box in one colour: the fit that it is part of, which of its regions is the box's first, which of its defoci is the
    box's, and the sides of best focus on which it may stand, that of the fit first."""

    fit: EdgeFit
    first: int
    depth: int
    sides: tuple[Side, ...]


def standings(fits: Fits, one_range: bool) -> dict[tuple[Place, str], Standing]:
    """Where every box stands in every colour.

    A given wavefront leaves edges nothing in common but a declared range: each is as fitted by itself. One that is fitted
    along is common to all edges and colours, and tells nothing of the side of best focus.
    """
    every = [
        (place, name, of)
        for place, by_channel in fits.items()
        for name, of in by_channel.items()
    ]
    if not every:
        return {}
    if not every[0][2].task.camera.given:
        return _with_wavefront(fits, one_range)
    if one_range:
        return _of_one_range(every)
    return {
        (place, name): Standing(of.ends[0], 0, 0, of.sides) for place, name, of in every
    }


def correlation(standing: Sequence[Standing]) -> Floats | None:
    """(colours, colours) of the errors of one box's defoci; None where they are of fits apart."""
    if any(of.fit is not standing[0].fit for of in standing):
        return None
    covariance = standing[0].fit.defocus_covariance([of.depth for of in standing])
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


def _with_wavefront(fits: Fits, one_range: bool) -> dict[tuple[Place, str], Standing]:
    """The clearest boxes in all colours with one wavefront; the others with what these tell of it."""
    clear = sorted(
        fits,
        key=lambda place: min(of.ends[0].edge_std(0)[1] for of in fits[place].values()),
    )
    few = clear if one_range else clear[:MOST_JOINT]
    joint, placed = _climbed({place: fits[place] for place in few}, one_range)
    other = twin(joint)
    found = {
        key: Standing(joint, first, depth, (side_of(joint, depth), side_of(other, depth)))
        for key, (first, depth) in placed.items()
    }
    modes = joint.state.modes.size
    lens = LensPrior(
        joint.state.modes, joint.covariance[:modes, :modes] + 1e-12 * np.eye(modes)
    )
    for place in clear[len(few) :]:
        for name, of in fits[place].items():
            known = fit_box(
                replace(
                    of.task,
                    camera=replace(of.task.camera, lens=lens, given=True),
                    planes=(),
                )
            )
            fit = (known.ends or of.ends)[0]
            side = known.sides[0] if known.sides else side_of(fit)
            found[place, name] = Standing(
                fit, 0, 0, (side, replace(side, defocus=-side.defocus))
            )
    return found


def _climbed(
    fits: Fits, one_range: bool
) -> tuple[EdgeFit, dict[tuple[Place, str], tuple[int, int]]]:
    """The joint fit, and of each box and channel its first region and its defocus in it."""
    names = list(dict.fromkeys(name for of in fits.values() for name in of))
    tasks = {
        name: next(of[name].task for of in fits.values() if name in of) for name in names
    }
    noise = [each for name in names for each in tasks[name].problem.noise]
    frames = len(noise) // len(names)
    regions: list[Region] = []
    apart: list[EdgeFit] = []
    groups: list[int] = []
    placed: dict[tuple[Place, str], tuple[int, int]] = {}
    for group, (place, by_channel) in enumerate(fits.items()):
        for name, of in by_channel.items():
            light = names.index(name)
            depth = light if one_range else len(apart)
            placed[place, name] = len(regions), depth
            regions += [
                replace(
                    region, frame=region.frame + frames * light, depth=depth, light=light
                )
                for region in of.task.regions
            ]
            apart.append(of.ends[0])
            groups.append(group)
    optics = tuple(tasks[name].camera.optics for name in names)
    problem = EdgeProblem(
        optics, tuple(regions), tuple(noise), next(iter(tasks.values())).camera.lens
    )
    if one_range:
        groups = [0] * len(names)
        apart = [
            next(a for a, r in zip(apart, _depths(placed), strict=True) if r == light)
            for light in range(len(names))
        ]
    edges = [
        end for of in fits.values() for b in of.values() for end in b.ends[0].state.edges
    ]
    found = [
        np.median(
            [of[name].ends[0].state.log_noise for of in fits.values() if name in of], axis=0
        )
        for name in names
    ]
    defoci = [end.defocus()[0] for end in apart]
    return fit_jointly(
        problem, defoci, np.array(edges), groups, np.concatenate(found)
    ), placed


def _depths(placed: Mapping[tuple[Place, str], tuple[int, int]]) -> list[int]:
    return [depth for _, depth in placed.values()]


def _of_one_range(
    every: Sequence[tuple[Place, str, BoxFit]],
) -> dict[tuple[Place, str], Standing]:
    """Each colour's boxes with one defocus, the wavefront given."""
    found = {}
    for name in dict.fromkeys(name for _, name, _ in every):
        having = [(place, of) for place, channel, of in every if channel == name]
        fit = fit_together([of for _, of in having])
        sides, first = near_focus(fit) or _both(fit, [of for _, of in having]), 0
        for place, of in having:
            found[place, name] = Standing(fit, first, 0, sides)
            first += len(of.task.regions)
    return found


def _both(fit: EdgeFit, fits: Sequence[BoxFit]) -> tuple[Side, ...]:
    """Of a fit of one depth its side, and the other one where every box by itself has it too."""
    sign = np.sign(fit.defocus()[0])
    others = [[end for end in of.ends if np.sign(end.defocus()[0]) != sign] for of in fits]
    if not all(others):
        return (side_of(fit),)
    same = [[end for end in of.ends if np.sign(end.defocus()[0]) == sign] for of in fits]
    lost = sum(
        o[0].objective - (s[0].objective if s else o[0].objective)
        for o, s in zip(others, same, strict=True)
    )
    values = np.array([o[0].defocus() for o in others])
    weight = 1 / values[:, 1] ** 2
    mean = float(weight @ values[:, 0] / weight.sum())
    return side_of(fit), Side(mean, float(weight.sum() ** -0.5), fit.objective + lost)
