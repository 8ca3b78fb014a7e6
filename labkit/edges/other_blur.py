"""The kind of blur that no wavefront makes, of an edge that the lens's own blur does not explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.blur import KINDS, Blur
from labkit.edges.edge_fit import EXACTLY, ROUGHLY, EdgeFit, EdgeProblem, fit_edges
from labkit.edges.first_fits import NEAR_FOCUS, twin
from labkit.edges.region import BLUR
from labkit.types import Floats

LEAST_GAIN = 10.0  # of the log-likelihood, less half a logarithm of the pixels for each number
AS_LIKELY = 5.0  # of the log-likelihood: kinds that may be the true one as well


@dataclass(frozen=True)
class OtherBlur:
    """Fits of an edge with a blur that no wavefront makes.

    Attributes
    ----------
    ends : of the likeliest kind, best first
    kinds : it, and others that explain the edge as well
    """

    ends: tuple[EdgeFit, ...]
    kinds: tuple[Blur, ...]

    @property
    def cause(self) -> str:
        """The kinds in words."""
        return ", or ".join(kind.words for kind in self.kinds)


def find_blur(ends: Sequence[EdgeFit]) -> OtherBlur | None:
    """Fit an edge's ends with each kind of blur; None where none explains it better.

    ends : of fits of one edge, in one frame or several, with the lens's blur alone
    """
    best = ends[0]
    pixels = sum(region.counts.size for region in best.problem.regions)
    found: dict[Blur, EdgeFit] = {}
    for kind in KINDS:
        fits = [fit for end in ends for fit in _fits(end, kind)]
        if fits:
            found[kind] = max(fits, key=lambda fit: fit.objective)
    values = {
        kind: fit.objective - kind.size * np.log(pixels) / 2 for kind, fit in found.items()
    }
    if not values or max(values.values()) < best.objective + LEAST_GAIN:
        return None
    kinds = sorted(values, key=lambda kind: -values[kind])
    likely = [kind for kind in kinds if values[kind] > values[kinds[0]] - AS_LIKELY]
    fit = fit_edges(found[kinds[0]].problem, found[kinds[0]].state, EXACTLY)
    both = (fit,) if np.any(fit.problem.lens.mean) else (fit, twin(fit))
    return OtherBlur(both, tuple(likely))


def _fits(end: EdgeFit, kind: Blur) -> list[EdgeFit]:
    """Return fits with a kind of blur, from where a fit without it ended and from best focus."""
    regions = tuple(replace(region, blur=kind) for region in end.problem.regions)
    problem = replace(end.problem, regions=regions)
    focused = np.copysign(NEAR_FOCUS[0], end.state.defoci)
    usual = problem.lens.mean.copy()
    starts = [(focused, usual, numbers) for numbers in kind.starts]
    starts.append((end.state.defoci, end.state.modes, kind.starts[0]))
    fits = []
    for defoci, modes, numbers in starts:
        try:
            fits.append(_fitted(end, problem, defoci, modes, numbers))
        except np.linalg.LinAlgError:
            continue
    return fits


def _fitted(
    end: EdgeFit,
    problem: EdgeProblem,
    defoci: Floats,
    modes: Floats,
    numbers: Sequence[float],
) -> EdgeFit:
    """Fit a problem from a start."""
    edges = end.state.edges.copy()
    edges[:, BLUR[: len(numbers)]] = numbers
    start = replace(end.state, defoci=defoci, modes=modes, edges=edges)
    return fit_edges(problem, start, ROUGHLY)
