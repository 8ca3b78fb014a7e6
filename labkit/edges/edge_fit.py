"""The joint model of edges and its maximum of likelihood (thesis 5.33-5.69).

Unknowns in the thesis's order: [alpha, c1, c2, sigma_r, beta, theta]: modes but defocus, common to all edges; for each
frame its gain and read variance; for each depth its defocus; for each edge angle, distance and two radiances. Of a frame's
c1, c2 and sigma_r and its edges' radiances two combinations change nothing (a common factor and a common offset of the
radiances; only the variance depends on c1 and c2 alone, as gain and as a part of the read variance). So radiances are in
counts above black, and a frame has two numbers: its gain c1 in counts per electron and the variance sigma_r^2 - c1 c2,
both as logarithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from labkit.edges.region import LINE_NUMBERS, Edge, Region, mean_and_slopes
from labkit.estimation.climb import NoisePrior
from labkit.estimation.identifiability import inverse
from labkit.estimation.levenberg_marquardt import Position, Step, climb, damped_step
from labkit.estimation.likelihood import Slopes
from labkit.imaging.optics import Optics
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats, Indices

MOST_NOISE_STEP = 1.0  # of a logarithm
MOST_WAVES_STEP = 0.5
"""Near best focus the information on defocus vanishes: a step by it is unbounded."""

EXACTLY = 0.03  # standard errors of the last step
ROUGHLY = 0.3  # of a fit that only starts another
USUAL_MODE_STD = 0.05  # waves RMS of a mode of an unknown lens
TINY_VARIANCE = 1e-12
"""Waves squared, so that the prior of exactly known modes is a distribution."""


@dataclass(frozen=True)
class LensPrior:
    """Prior for the modes but defocus.

    Attributes
    ----------
    mean : (m,) waves RMS at the reference
    covariance : (m, m), positive

    Raises
    ------
    ValueError : other shapes, or a covariance not positive
    """

    mean: Floats
    covariance: Floats

    def __post_init__(self) -> None:
        modes = len(self.mean)
        shaped = self.covariance.shape == (modes, modes)
        if not shaped or not np.all(np.linalg.eigvalsh(self.covariance) > 0):
            raise ValueError(
                f"{modes} modes need a positive covariance ({modes}, {modes}), waves RMS squared"
            )

    @cached_property
    def precision(self) -> Floats:
        """Inverse of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), np.float64)

    @classmethod
    def unknown(cls, modes: int) -> LensPrior:
        """Return the prior for an unknown lens."""
        return cls(np.zeros(modes), USUAL_MODE_STD**2 * np.eye(modes))

    @classmethod
    def known(cls, modes: Floats, covariance: Floats | float = 0.0) -> LensPrior:
        """Return the prior of estimated modes (m,), exactly known without a covariance (m, m)."""
        return cls(modes, covariance + TINY_VARIANCE * np.eye(modes.size))


@dataclass(frozen=True)
class EdgeState:
    """A number for each parameter: a point of the parameter space, standard errors, or places.

    Attributes
    ----------
    modes : (m,) alpha, waves RMS
    log_noise : (frames, 2)
    defoci : (depths,) beta, waves RMS
    edges : (regions, 13) theta, see `Edge`
    """

    modes: NDArray[Any]
    log_noise: NDArray[Any]
    defoci: NDArray[Any]
    edges: NDArray[Any]

    @property
    def _parts(self) -> list[NDArray[Any]]:
        return [self.modes, self.log_noise, self.defoci, self.edges]

    @property
    def vector(self) -> Floats:
        """All parameters in the thesis's order."""
        return np.concatenate([part.ravel() for part in self._parts])

    @property
    def places(self) -> EdgeState:
        """Places of the parameters in `vector`."""
        return self.at(np.arange(self.vector.size))

    def at(self, vector: NDArray[Any]) -> EdgeState:
        """Return the state of another vector."""
        ends = np.cumsum([part.size for part in self._parts])
        pieces = zip(np.split(vector, ends[:-1]), self._parts, strict=True)
        return EdgeState(*(piece.reshape(part.shape) for piece, part in pieces))

    def moved(self, step: Floats) -> EdgeState:
        """Return the state after a step, which changes noise by a factor of e and modes by half a wave at most."""
        most = (MOST_WAVES_STEP, MOST_NOISE_STEP, MOST_WAVES_STEP, np.inf)
        limit = np.repeat(most, [part.size for part in self._parts])
        return self.at(self.vector + np.clip(step, -limit, limit))

    def edge(self, k: int) -> Edge:
        """Return the edge of a region."""
        return Edge(*self.edges[k].tolist())


@dataclass(frozen=True)
class EdgeProblem:
    """Regions, their camera and its priors.

    Attributes
    ----------
    optics : of each colour, with the same modes, defocus first; the other modes are the same path difference for all colours
    regions : regions of all frames and colours
    noise : prior for each frame, and colour
    lens : prior for the modes but defocus

    Raises
    ------
    ValueError : contradictory sizes
    """

    optics: tuple[Optics, ...]
    regions: tuple[Region, ...]
    noise: tuple[NoisePrior, ...]
    lens: LensPrior

    def __post_init__(self) -> None:
        if any(of.noll != self.noll for of in self.optics) or self.noll[:1] != (DEFOCUS,):
            raise ValueError(
                f"noll = {[of.noll for of in self.optics]}: the same of all colours is needed, defocus first"
            )
        if len(self.lens.mean) != len(self.noll) - 1:
            raise ValueError(
                f"{len(self.lens.mean)} modes in the lens's prior: {len(self.noll) - 1} are needed"
            )
        if not self.regions or max(r.frame for r in self.regions) >= len(self.noise):
            raise ValueError(
                f"{len(self.regions)} regions, noise of {len(self.noise)} frames: each needs its frame's"
            )

    @property
    def noll(self) -> tuple[int, ...]:
        """The modes, defocus first."""
        return self.optics[0].noll

    @property
    def depths(self) -> int:
        """Number of defoci."""
        return max(region.depth for region in self.regions) + 1

    def optics_of(self, k: int) -> Optics:
        """Return the optics of a region's colour."""
        return self.optics[self.regions[k].light]

    def start(
        self,
        defoci: Sequence[float] | Floats,
        edges: Sequence[Edge] | Floats,
        log_noise: Floats | None = None,
    ) -> EdgeState:
        """Return a state with these defoci, edges and noise (frames, 2), all else at its prior mean."""
        noise = self.usual_noise if log_noise is None else log_noise
        return EdgeState(
            self.lens.mean.copy(), noise, np.array(defoci, float), np.array(edges)
        )

    @property
    def usual_noise(self) -> Floats:
        """(frames, 2) prior mean of the logarithms of gain and read variance."""
        return np.array([of.centre for of in self.noise])

    def wavefront(self, values: EdgeState, k: int) -> NDArray[Any]:
        """Return the numbers (modes,) of a region's wavefront, defocus first."""
        return np.append(values.defoci[self.regions[k].depth], values.modes)

    def slopes(self, state: EdgeState, k: int) -> tuple[Slopes, Indices]:
        """Return a region's mean and variance with slopes, (5.47)-(5.48), and the places of their parameters.

        The places are of the mean's parameters, then of the noise's two.
        """
        region = self.regions[k]
        mean, by_edge, by_waves = mean_and_slopes(
            region, state.edge(k), self.optics_of(k), self.wavefront(state, k)
        )
        gain, read_variance = np.exp(state.log_noise[region.frame])
        at = state.places
        edge = at.edges[k][region.free]
        places = [self.wavefront(at, k), edge, at.log_noise[region.frame]]
        of_mean = np.concatenate([by_waves, by_edge])
        return Slopes(mean, gain, read_variance, of_mean=of_mean), np.concatenate(places)

    def score(self, state: EdgeState) -> tuple[float, Floats, Floats]:
        """Return log-likelihood, gradient (p,) and Fisher information (p, p), priors included.

        Thesis (5.49)-(5.69), (3.15), (3.19).
        """
        vector = state.vector
        gradient = np.zeros(vector.size)
        information = np.zeros((vector.size, vector.size))
        total = 0.0
        for k, region in enumerate(self.regions):
            of, places = self.slopes(state, k)
            total += of.log_likelihood(region.counts)
            gradient[places] += of.gradient(region.counts)
            information[np.ix_(places, places)] += of.information()
        mean, precision = self._prior
        known = slice(0, mean.size)
        away = vector[known] - mean
        gradient[known] -= precision @ away
        information[known, known] += precision
        at = state.places.edges
        for k, region in enumerate(self.regions):
            shape = region.free[LINE_NUMBERS:]
            weak = region.shape_stds**-2
            gradient[at[k][shape]] -= weak * state.edges[k][shape]
            total -= 0.5 * float(weak @ state.edges[k][shape] ** 2)
            information[at[k][shape], at[k][shape]] += weak
            # numbers that are not fitted are known, in no relation to others
            held = np.delete(at[k], region.free)
            information[held, held] = 1.0
        return total - 0.5 * float(away @ precision @ away), gradient, information

    @cached_property
    def _prior(self) -> tuple[Floats, Floats]:
        """Mean and precision of the parameters with a prior: modes and noise, the first ones."""
        mean = np.append(self.lens.mean, self.usual_noise)
        noise = np.concatenate([of.precision for of in self.noise])
        return mean, np.asarray(block_diag(self.lens.precision, np.diag(noise)))

    def alone(self, k: int) -> EdgeProblem:
        """Return the problem of a region."""
        region = self.regions[k]
        return EdgeProblem(
            (self.optics_of(k),),
            (replace(region, frame=0, depth=0, light=0),),
            (self.noise[region.frame],),
            self.lens,
        )


@dataclass(frozen=True)
class EdgeFit:
    """The end of a maximisation.

    Attributes
    ----------
    problem, state : the regions, and the estimate
    objective : log-likelihood, priors included
    covariance : (p, p) in the thesis's order
    """

    problem: EdgeProblem
    state: EdgeState
    objective: float
    covariance: Floats

    @property
    def std(self) -> EdgeState:
        """Standard errors of the estimate."""
        return self.state.at(np.sqrt(np.diag(self.covariance)))

    def among(self, places: Indices) -> Floats:
        """Return the covariance (n, n) of some parameters. places: (n,), see `EdgeState.places`."""
        return self.covariance[np.ix_(places, places)]

    def defocus(self, depth: int = 0) -> tuple[float, float]:
        """Return a defocus, waves RMS at the reference, and its standard error."""
        return float(self.state.defoci[depth]), float(self.std.defoci[depth])

    @property
    def lens(self) -> LensPrior:
        """The estimated modes, as a prior for other fits."""
        return LensPrior.known(self.state.modes, self.among(self.state.places.modes))

    def residuals(self, k: int) -> Floats:
        """Return a region's residuals (n,), in standard deviations."""
        of, _ = self.problem.slopes(self.state, k)
        return (self.problem.regions[k].counts - of.mean) / np.sqrt(of.variance)


def fit_edges(
    problem: EdgeProblem,
    start: EdgeState,
    tolerance: float = EXACTLY,
    max_steps: int = 40,
    held: Sequence[int] = (),
) -> EdgeFit:
    """Climb to the maximum of the likelihood near a start.

    Parameters
    ----------
    problem : regions and their camera
    start : where to begin
    tolerance, max_steps : as in `labkit.estimation.climb.climb`
    held : places, in the thesis's order, of constant parameters

    Raises
    ------
    ValueError : at no defocus and no other mode the likelihood is flat in defocus by symmetry: start elsewhere
        (`labkit.edges.first_fits`)
    """
    if not start.modes.any() and not start.defoci.all():
        raise ValueError(
            "no defocus and no other mode: the likelihood is flat there by symmetry; start elsewhere"
        )
    first = _Scored(problem, start, tuple(held))
    end, _, _ = climb(first, tolerance=tolerance, max_steps=max_steps)
    return EdgeFit(problem, end.state, end.objective, inverse(end.scored[2]))


@dataclass(frozen=True, eq=False)
class _Scored(Position):
    """A position of a climb over edges."""

    problem: EdgeProblem
    state: EdgeState
    held: tuple[int, ...]

    @cached_property
    def scored(self) -> tuple[float, Floats, Floats]:
        return self.problem.score(self.state)

    @property
    def objective(self) -> float:
        return self.scored[0]

    def step(self, damping: float) -> Step:
        _, gradient, information = self.scored
        free = np.ones(gradient.size)
        free[list(self.held)] = 0
        return damped_step(gradient * free, information * np.outer(free, free), damping)

    def moved(self, change: Floats) -> _Scored:
        return replace(self, state=self.state.moved(change))
