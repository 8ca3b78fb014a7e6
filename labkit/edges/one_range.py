"""Edges declared to stand at one range: which of them contradict the others, and the defocus that the rest have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.edges.box_fit import BoxFit
from labkit.edges.joint import EdgeFit, EdgeProblem, fit_edges

CONTRADICTS = 5.0  # standard errors from what the others have in common
ALIKE_WAVES = 0.01  # RMS: as far may the defoci of one range differ, for a curved field and a tilted sensor


def contradicting(fits: Sequence[BoxFit]) -> dict[int, str]:
    """Of fits of one colour the places of those whose defocus contradicts the others', with a line that says how."""
    chosen = _one_side(fits)
    value = np.array([end.defocus()[0] for end in chosen])
    std = np.hypot([end.defocus()[1] for end in chosen], ALIKE_WAVES)
    left, found = list(range(len(fits))), dict[int, str]()
    while len(left) > 1:
        pulls = {}
        for k in left:
            others = [j for j in left if j != k]
            weight = 1 / std[others] ** 2
            mean, error = (
                float(weight @ value[others] / weight.sum()),
                float(weight.sum() ** -0.5),
            )
            pulls[k] = (
                abs(value[k] - mean) / float(np.hypot(std[k], error)),
                float(std[k]),
                mean,
                error,
            )
        worst = max(left, key=lambda k: (round(pulls[k][0], 6), pulls[k][1]))
        pull, own, mean, error = pulls[worst]
        if pull < CONTRADICTS:
            break
        found[worst] = (
            f"declared to be at one range with the others, but its defocus, {value[worst]:.3f} ± {own:.3f} waves, contradicts "
            f"theirs, {mean:.3f} ± {error:.3f}"
        )
        left.remove(worst)
    return found


def _one_side(fits: Sequence[BoxFit]) -> list[EdgeFit]:
    """Of each fit the end on the side of best focus on which all together are likelier and agree better."""
    best, least = [fit.ends[0] for fit in fits], np.inf
    for sign in (1, -1):
        ends = [max(fit.ends, key=lambda end: sign * end.defocus()[0]) for fit in fits]
        value = np.array([end.defocus()[0] for end in ends])
        std = np.hypot([end.defocus()[1] for end in ends], ALIKE_WAVES)
        mean = np.average(value, weights=1 / std**2)
        # a contradiction counts for no more than it takes to be found
        cost = float(np.sum(np.minimum(((value - mean) / std) ** 2, CONTRADICTS**2)))
        cost -= 2 * sum(
            end.objective - fit.ends[0].objective
            for end, fit in zip(ends, fits, strict=True)
        )
        if cost < least:
            best, least = ends, cost
    return best


def fit_together(fits: Sequence[BoxFit]) -> EdgeFit:
    """All regions of some boxes of one colour with one defocus: one of one depth for all of them."""
    ends = _one_side(fits)
    regions = tuple(replace(region, depth=0) for fit in fits for region in fit.task.regions)
    first = fits[0].task.problem
    problem = EdgeProblem(first.optics, regions, first.noise, first.lens)
    value = np.array([end.defocus() for end in ends])
    start = float(np.average(value[:, 0], weights=1 / value[:, 1] ** 2))
    edges = [end.state.edge(k) for end in ends for k in range(len(end.problem.regions))]
    return fit_edges(problem, problem.start([start], edges))
