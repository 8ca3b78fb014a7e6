"""The joint model of edges and its maximum of likelihood (thesis 5.33-5.69).

Unknowns in the thesis's order: [alpha, c1, c2, sigma_r, beta, theta]: modes but defocus, common to all edges; for each
frame its gain and offset and read noise; for each depth its defocus; for each edge angle, distance and two radiances. Of a
frame's c1, c2 and sigma_r and its edges' radiances two combinations change nothing (a common factor and a common offset of
the radiances; only in the variance do c1 and c2 stand alone, as gain and as a part of the read variance), so radiances are in
counts above black and a frame has two numbers, its gain c1 in counts per electron and the variance sigma_r^2 - c1 c2, both
as logarithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from labkit.edges.region import EDGE_SIZE, Edge, Region, mean_and_slopes
from labkit.estimation.climb import NoisePrior, Position, Step, climb, damped_step
from labkit.estimation.identifiability import Bound, bound_of, inverse
from labkit.estimation.likelihood import Slopes
from labkit.imaging.optics import Optics
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats

NOISE = 2  # log gain, log read variance of a frame
MOST_NOISE_STEP = 1.0
MOST_WAVES_STEP = (
    0.5  # near best focus the information on defocus vanishes, and a step by it has no end
)
EXACTLY, ROUGHLY = (
    0.03,
    0.3,
)  # standard errors of the last step: of a climb, and of one that only begins another
USUAL_MODE_STD = 0.05  # waves RMS of a mode of a lens that nothing is known of, where one is fitted along


@dataclass(frozen=True)
class LensPrior:
    """What is known of the modes but defocus, a measurement that joins the likelihood. mean: (m,) waves RMS at the reference;
    covariance: (m, m). Raises ValueError for other shapes or a covariance that is none."""

    mean: Floats
    covariance: Floats
    precision: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        modes = len(self.mean)
        if self.covariance.shape != (modes, modes) or not np.all(
            np.linalg.eigvalsh(self.covariance) > 0
        ):
            raise ValueError(
                f"{modes} modes need a positive covariance ({modes}, {modes}), waves RMS squared"
            )
        object.__setattr__(self, "precision", np.linalg.inv(self.covariance))

    @classmethod
    def unknown(cls, modes: int, std: float = USUAL_MODE_STD) -> LensPrior:
        """Of a lens that nothing is known of but that it is one."""
        return cls(np.zeros(modes), std**2 * np.eye(modes))


@dataclass(frozen=True)
class EdgeState:
    """A point of the parameter space. modes: (m,) alpha; log_noise: (frames, 2); defoci: (depths,) beta, waves RMS;
    edges: (regions, 4) theta."""

    modes: Floats
    log_noise: Floats
    defoci: Floats
    edges: Floats

    @property
    def vector(self) -> Floats:
        """All parameters in the thesis's order."""
        return np.concatenate(
            [self.modes, self.log_noise.ravel(), self.defoci, self.edges.ravel()]
        )

    def at(self, vector: Floats) -> EdgeState:
        """The state of another vector."""
        ends = np.cumsum([self.modes.size, self.log_noise.size, self.defoci.size])
        modes, noise, defoci, edges = np.split(vector, ends)
        return EdgeState(
            modes,
            noise.reshape(self.log_noise.shape),
            defoci,
            edges.reshape(self.edges.shape),
        )

    def moved(self, step: Floats) -> EdgeState:
        """After a step in all parameters, that of the noise held within a factor of e, those of waves within half a wave."""
        noise = slice(self.modes.size, self.modes.size + self.log_noise.size)
        step = step.copy()
        step[noise] = np.clip(step[noise], -MOST_NOISE_STEP, MOST_NOISE_STEP)
        for waves in (
            slice(0, noise.start),
            slice(noise.stop, noise.stop + self.defoci.size),
        ):
            step[waves] = np.clip(step[waves], -MOST_WAVES_STEP, MOST_WAVES_STEP)
        return self.at(self.vector + step)

    def edge(self, k: int) -> Edge:
        """Of one region."""
        return Edge.of(self.edges[k])


@dataclass(frozen=True)
class EdgeProblem:
    """Regions, the camera they were seen by, and what is known beforehand.

    optics: of each colour, with the same modes, of which the first is defocus: the others are one path difference for all
    colours. noise: of each frame, and colour. Raises ValueError for others.
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

    def optics_of(self, k: int) -> Optics:
        """Of a region's colour."""
        return self.optics[self.regions[k].light]

    @property
    def depths(self) -> int:
        """How many defoci there are."""
        return max(region.depth for region in self.regions) + 1

    def waves(self, state: EdgeState, k: int) -> Floats:
        """(modes,) of the wavefront behind a region."""
        return np.concatenate([state.defoci[self.regions[k].depth, None], state.modes])

    def start(
        self,
        defoci: Sequence[float],
        edges: Sequence[Edge],
        log_noise: Floats | None = None,
    ) -> EdgeState:
        """Defoci, edges and noise (frames, 2), and all else as it is expected to be."""
        noise = (
            np.array([of.centre for of in self.noise]) if log_noise is None else log_noise
        )
        return EdgeState(
            self.lens.mean.copy(),
            noise,
            np.array(defoci, float),
            np.array([e.theta for e in edges]),
        )

    def slopes(self, state: EdgeState, k: int) -> tuple[Slopes, list[int]]:
        """A region's mean and variance with their slopes, (5.47)-(5.48), and where its parameters stand among all: those of the
        mean, then the noise's two."""
        region = self.regions[k]
        mean, by_edge, by_waves = mean_and_slopes(
            region, state.edge(k), self.optics_of(k), self.waves(state, k)
        )
        gain, read_variance = np.exp(state.log_noise[region.frame])
        modes, noise = state.modes.size, state.modes.size + state.log_noise.size
        places = [noise + region.depth, *range(modes)]
        places += [noise + state.defoci.size + EDGE_SIZE * k + i for i in range(EDGE_SIZE)]
        places += [modes + NOISE * region.frame, modes + NOISE * region.frame + 1]
        return Slopes(
            mean, gain, read_variance, of_mean=np.concatenate([by_waves, by_edge])
        ), places

    def objective(self, state: EdgeState) -> float:
        """Log-likelihood of everything measured, the priors included, but for its constant. Thesis (5.49)."""
        return self.score(state, slopes=False)[0]

    def score(self, state: EdgeState, slopes: bool = True) -> tuple[float, Floats, Floats]:
        """Log-likelihood, gradient (p,) and Fisher information (p, p). Thesis (5.49)-(5.69), (3.15), (3.19)."""
        size = state.vector.size
        total, gradient, information = 0.0, np.zeros(size), np.zeros((size, size))
        for k, region in enumerate(self.regions):
            of, places = self.slopes(state, k)
            total += of.log_likelihood(region.counts)
            if slopes:
                gradient[places] += of.gradient(region.counts)
                information[np.ix_(places, places)] += of.information()
        modes = state.modes.size
        away = state.modes - self.lens.mean
        total -= 0.5 * float(away @ self.lens.precision @ away)
        gradient[:modes] -= self.lens.precision @ away
        information[:modes, :modes] += self.lens.precision
        for j, of_frame in enumerate(self.noise):
            at = slice(modes + NOISE * j, modes + NOISE * (j + 1))
            departure = state.log_noise[j] - of_frame.centre
            total -= 0.5 * float(of_frame.precision @ departure**2)
            gradient[at] -= of_frame.precision * departure
            information[at, at] += np.diag(of_frame.precision)
        return total, gradient, information

    def names(self, state: EdgeState) -> tuple[str, ...]:
        """Of all parameters, in the thesis's order."""
        per_edge = ("angle", "distance", "near", "far")
        return (
            *(f"mode {j}" for j in self.noll[1:]),
            *(
                f"{name} of frame {j}"
                for j in range(len(self.noise))
                for name in ("gain", "read variance")
            ),
            *(f"defocus {g}" for g in range(state.defoci.size)),
            *(f"{name} of edge {k}" for k in range(len(self.regions)) for name in per_edge),
        )

    def bound(self, state: EdgeState) -> Bound:
        """The Cramér-Rao bound of all parameters, the priors' information included."""
        return bound_of(self.score(state)[2], self.names(state))

    def alone(self, k: int) -> EdgeProblem:
        """One region by itself."""
        region = replace(self.regions[k], frame=0, depth=0, light=0)
        return replace(
            self,
            optics=(self.optics_of(k),),
            regions=(region,),
            noise=(self.noise[self.regions[k].frame],),
        )


@dataclass(frozen=True)
class EdgeFit:
    """Where a maximisation ended. covariance: (p, p) in the thesis's order; steps: evaluations of the slopes."""

    problem: EdgeProblem
    state: EdgeState
    objective: float
    covariance: Floats
    steps: int
    converged: bool

    def defocus(self, depth: int = 0) -> tuple[float, float]:
        """Waves RMS at the reference, and its standard error."""
        return float(self.state.defoci[depth]), float(
            np.sqrt(self.defocus_covariance([depth])[0, 0])
        )

    def defocus_covariance(self, depths: Sequence[int]) -> Floats:
        """(n, n) of some defoci, waves RMS squared."""
        at = self.state.modes.size + self.state.log_noise.size + np.asarray(depths)
        return np.asarray(self.covariance[np.ix_(at, at)])

    def wavefront_covariance(self, depth: int = 0) -> Floats:
        """(modes, modes) of defocus and the others, in the order of the optics' modes."""
        modes = self.state.modes.size
        at = [modes + self.state.log_noise.size + depth, *range(modes)]
        return np.asarray(self.covariance[np.ix_(at, at)])

    def edge_std(self, k: int) -> Floats:
        """(4,) standard errors of an edge's angle (radians), distance (pixels) and radiances (counts)."""
        first = (
            self.state.modes.size
            + self.state.log_noise.size
            + self.state.defoci.size
            + EDGE_SIZE * k
        )
        return np.asarray(np.sqrt(np.diag(self.covariance)[first : first + EDGE_SIZE]))

    def residuals(self, k: int) -> Floats:
        """(n,) of a region's counts, in standard deviations."""
        of, _ = self.problem.slopes(self.state, k)
        return np.asarray((self.problem.regions[k].counts - of.mean) / np.sqrt(of.variance))


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
    held : places, in the thesis's order, of parameters that stay

    Raises
    ------
    ValueError : at no defocus and no other mode the likelihood is flat in defocus by symmetry: start elsewhere
        (`labkit.edges.search`)
    """
    if np.any((start.defoci == 0) & (np.abs(start.modes).sum() == 0)):
        raise ValueError(
            "no defocus and no other mode: the likelihood is flat there by symmetry; start elsewhere"
        )
    end, steps, converged = climb(
        _Scored(problem, start, tuple(held)), tolerance=tolerance, max_steps=max_steps
    )
    information = end.scored[2]
    return EdgeFit(
        problem, end.state, end.objective, inverse(information), steps, converged
    )


@dataclass(frozen=True, eq=False)
class _Scored(Position):
    """Where a climb over edges stands."""

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
