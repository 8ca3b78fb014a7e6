"""The kind of blur that no wavefront makes, of an edge that the lens's own blur does not explain.

The kind is that which best turns a lens's response into the measured one; then the edge is fitted with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from labkit.edges.blur import BLURS, Blur, Sharpening
from labkit.edges.comparison import REPEATED_TO, Comparison
from labkit.edges.edge_fit import EdgeFit, LensPrior, fit_edges
from labkit.edges.first_fits import NEAR_FOCUS, twin
from labkit.edges.region import BLUR_NUMBERS
from labkit.edges.response import Response, fitted_response
from labkit.edges.spread import EdgeBlur, camera_slice
from labkit.imaging.optics import Optics
from labkit.optics.mtf import modulus
from labkit.types import Complexes, Floats

LEAST_GAIN = 12.0  # of chi-squared, for each number
AS_LIKELY_KIND = 9.0  # of chi-squared: kinds that may be the true one as well
BEYOND = 0.02  # of a response above the best lens's: no aberration does that
USUAL_DEFOCUS_STD = 1.0  # waves RMS


@dataclass(frozen=True)
class OtherBlur:
    """A blur that no wavefront makes.

    Attributes
    ----------
    blur : of the likeliest kind
    kinds : it, and others that explain the response as well
    waves : (modes,) of the lens beside it
    """

    blur: EdgeBlur
    kinds: tuple[Blur, ...]
    waves: Floats

    @property
    def cause(self) -> str:
        """The kinds in words."""
        return ", or ".join(kind.words for kind in self.kinds)


@dataclass(frozen=True)
class Measured:
    """A response that a lens and a kind of blur may explain.

    Attributes
    ----------
    optics, lens : the camera without the blur, and what is known of its modes but defocus
    azimuth : of the edge's normal, radians
    per_um, value, noise : (f,)
    """

    optics: Optics
    lens: LensPrior
    azimuth: float
    per_um: Floats
    value: Floats
    noise: Floats

    @classmethod
    def of(cls, fit: EdgeFit, comparison: Comparison) -> Measured:
        """Return the response of a fit's first edge with what the photograph's has more."""
        problem = fit.problem
        angle = fit.state.edge(0).angle
        return cls.along(
            problem.optics_of(0), problem.lens, angle, fitted_response(fit), comparison
        )

    @classmethod
    def along(
        cls,
        optics: Optics,
        lens: LensPrior,
        azimuth: float,
        response: Response,
        comparison: Comparison,
    ) -> Measured:
        """Return a fit's response along an azimuth with what the photograph's has more."""
        per_mm = comparison.frequency_per_mm
        own = np.interp(per_mm, response.frequency_per_mm, response.value, right=0.0)
        noise = np.hypot(comparison.noise, REPEATED_TO)
        value = own + comparison.difference
        return cls(optics, lens, azimuth, 1e-3 * per_mm, value, noise)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.optics.noll)

    @property
    def beyond_best(self) -> bool:
        """Return whether the response exceeds that of a lens without aberrations."""
        flat = np.zeros(self.modes)
        best = np.abs(self._slice(flat, None)[0])
        return bool(np.any(self.value > best + BEYOND + 3 * self.noise))

    def explained(
        self, kind: Blur | None, start: Sequence[float], defocus: float
    ) -> tuple[float, Floats]:
        """Return chi-squared, priors included, and waves and numbers of the lens and a kind of blur, from a start."""
        lens = self.lens
        known = np.append(0.0, lens.mean)
        root = np.linalg.cholesky(lens.precision).T
        weight = np.zeros((known.size, known.size))
        weight[0, 0] = 1 / USUAL_DEFOCUS_STD
        weight[1:, 1:] = root
        stds = np.array(kind.stds if kind else ())

        def off(numbers: Floats) -> Floats:
            value, _ = self._response(numbers, kind)
            waves, blur = np.split(numbers, [known.size])
            own = (value - self.value) / self.noise
            lens_own = weight @ (waves - known)
            return np.concatenate([own, lens_own, blur / stds])

        def slopes(numbers: Floats) -> Floats:
            _, by_number = self._response(numbers, kind)
            prior = np.zeros((known.size + stds.size, numbers.size))
            prior[: known.size, : known.size] = weight
            prior[known.size :, known.size :] = np.diag(1 / stds)
            return np.concatenate([(by_number / self.noise).T, prior])

        first = np.concatenate([[defocus], lens.mean, start])
        end = least_squares(off, first, slopes, max_nfev=30)
        return 2 * float(end.cost), np.asarray(end.x)

    def _response(self, numbers: Floats, kind: Blur | None) -> tuple[Floats, Floats]:
        """Return the response (f,) of a lens and a blur, and its slopes (n, f)."""
        waves, rest = np.split(numbers, [self.modes])
        blur = None if kind is None else EdgeBlur(kind, tuple(rest.tolist()))
        return modulus(*self._slice(waves, blur))

    def _slice(self, waves: Floats, blur: EdgeBlur | None) -> tuple[Complexes, Complexes]:
        """Return the transfer function along the edge's normal, and its slopes."""
        of = camera_slice(self.optics, waves, self.azimuth, self.per_um, blur)
        return of.value, np.concatenate([of.by_waves, of.by_blur])


def find_blur(measured: Measured, defocus_waves: float) -> OtherBlur | None:
    """Return the kind of blur that explains an edge's response; None where the lens alone explains it as well.

    defocus_waves : of the fit without the blur, RMS
    """
    defoci = sorted({NEAR_FOCUS[0], max(abs(defocus_waves), NEAR_FOCUS[0])})
    alone = min(measured.explained(None, (), defocus)[0] for defocus in defoci)
    costs: dict[Blur, float] = {}
    ends: dict[Blur, Floats] = {}
    for kind in BLURS:
        if isinstance(kind, Sharpening) and not measured.beyond_best:
            continue
        for start in kind.starts:
            for defocus in defoci:
                cost, end = measured.explained(kind, start, defocus)
                blurs = isinstance(kind, Sharpening) or end[measured.modes] > 0
                if blurs and cost < costs.get(kind, alone - kind.size * LEAST_GAIN):
                    costs[kind] = cost
                    ends[kind] = end
    if not costs:
        return None
    kinds = sorted(costs, key=lambda kind: costs[kind])
    likely = [kind for kind in kinds if costs[kind] < costs[kinds[0]] + AS_LIKELY_KIND]
    waves, numbers = np.split(ends[kinds[0]], [measured.modes])
    return OtherBlur(EdgeBlur(kinds[0], tuple(numbers.tolist())), tuple(likely), waves)


def fit_with_blur(ends: Sequence[EdgeFit], other: OtherBlur) -> tuple[EdgeFit, ...]:
    """Fit an edge with a blur that no wavefront makes; the ends without it where they are likelier."""
    end = ends[0]
    kind = other.blur.kind
    regions = tuple(replace(region, blur=kind) for region in end.problem.regions)
    problem = replace(end.problem, regions=regions)
    edges = end.state.edges.copy()
    edges[:, BLUR_NUMBERS[: kind.size]] = other.blur.numbers
    defoci = np.full(1, other.waves[0])
    start = replace(end.state, defoci=defoci, modes=other.waves[1:], edges=edges)
    fit = fit_edges(problem, start)
    if fit.objective < end.objective:
        return tuple(ends)
    known = np.any(fit.problem.lens.mean)
    return (fit,) if known else (fit, twin(fit))
