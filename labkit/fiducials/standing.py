"""What edges of one colour have in common: nothing, a wavefront that is fitted along, or the range that they are declared to have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.joint import EdgeFit, EdgeProblem
from labkit.edges.ranges import Side, symmetric_error
from labkit.edges.search import fit_jointly, twin
from labkit.fiducials.box_fit import BoxFit
from labkit.fiducials.one_range import fit_together
from labkit.fiducials.photographs import Place


@dataclass(frozen=True)
class Standing:
    """Of one box: the fit that it is part of, which of its regions is the box's first, and the sides of best focus on which it
    may stand, that of the fit first."""

    fit: EdgeFit
    first: int
    sides: tuple[Side, ...]


def standings(fits: Sequence[BoxFit], one_range: bool) -> dict[Place, Standing]:
    """Of one channel where each box stands.

    A given wavefront leaves nothing that edges have in common: each is as fitted by itself. One that is fitted along is common.
    """
    if not fits:
        return {}
    if one_range:
        fit = fit_together(fits)
        ends = _both(fit, fits)
        firsts = np.cumsum([0, *(len(of.task.regions) for of in fits)])
        return {of.task.place: Standing(fit, int(k), ends) for of, k in zip(fits, firsts, strict=False)}
    if fits[0].task.camera.given or len(fits) == 1:
        return {of.task.place: Standing(of.ends[0], 0, tuple(_side(end) for end in of.ends)) for of in fits}
    regions = [replace(region, depth=d) for d, of in enumerate(fits) for region in of.task.regions]
    first = fits[0].task.problem
    problem = EdgeProblem(first.optics, tuple(regions), first.noise, first.lens)
    fit = fit_jointly(problem, [of.ends[0] for of in fits])
    firsts = np.cumsum([0, *(len(of.task.regions) for of in fits)])
    other = twin(fit)
    return {of.task.place: Standing(fit, int(firsts[d]), (_side(fit, d), _side(other, d))) for d, of in enumerate(fits)}


def _both(fit: EdgeFit, fits: Sequence[BoxFit]) -> tuple[Side, ...]:
    """Of a fit of one depth its side, and the other one where no box by itself excludes it."""
    if not fits[0].task.camera.given:
        return _side(fit), _side(twin(fit))
    sign = np.sign(fit.defocus()[0])
    others = [[end for end in of.ends if np.sign(end.defocus()[0]) != sign] for of in fits]
    if not all(others):
        return (_side(fit),)
    same = [[end for end in of.ends if np.sign(end.defocus()[0]) == sign] for of in fits]
    lost = sum(o[0].objective - (s[0].objective if s else o[0].objective) for o, s in zip(others, same, strict=True))
    values = np.array([o[0].defocus() for o in others])
    weight = 1 / values[:, 1] ** 2
    mean = float(weight @ values[:, 0] / weight.sum())
    return _side(fit), Side(mean, float(weight.sum() ** -0.5), fit.objective + lost)


def _side(fit: EdgeFit, depth: int = 0) -> Side:
    """Of an end. Where no other even mode is known, only the square of defocus is near zero."""
    value, std = fit.defocus(depth)
    return Side(value, std if np.any(fit.problem.lens.mean) else symmetric_error(value, std), fit.objective)
