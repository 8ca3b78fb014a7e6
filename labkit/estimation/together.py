"""A search over several stations at once, from nothing, for wavefronts too strong for a search at one station.

With half a wave RMS in high orders a picture has many optima, and most are nearly as good as the right one. Pictures of one
lens with several amounts of defocus leave few (phase diversity: R. A. Gonsalves, Opt. Eng. 21, 829 (1982)), and coarse pictures
fewer still (`coarse`). All modes but defocus are common to the stations, and their distances say how defocus differs. One
frame of each is used, with the stated f-number: the ends are starts for climbs over the whole likelihood of each station.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from labkit.estimation.climb import Problem, Start, State, sane
from labkit.estimation.coarse import Coarse
from labkit.estimation.levenberg_marquardt import Position, Step, climb, damped_step
from labkit.estimation.local import Views
from labkit.estimation.prior import Prior
from labkit.estimation.settings import SETTINGS
from labkit.estimation.starts import settled
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.jobs.processes import say
from labkit.jobs.sharing import Shared
from labkit.target.target import Target
from labkit.types import Floats


@dataclass(frozen=True)
class TogetherTask:
    """One search over several stations as a task.

    Attributes
    ----------
    optics : lens, light and sensor, the first mode defocus
    pupils : the optics with the pupils of the ends: the same one, or cat's eyes in all directions
    target : the target as shown
    stations : frames of each station
    defocus : of each station relative to the first, by the stated lens, waves RMS at the reference wavelength
    """

    optics: Optics
    pupils: tuple[Optics, ...]
    target: Shared[Target]
    stations: tuple[Shared[Views], ...]
    defocus: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _End:
    """The end of a climb over several stations.

    Attributes
    ----------
    optics : with the pupil of the climb
    waves : (modes,) of each station, waves RMS
    poses : of each station's first frame; empty if unknown
    height : log-likelihood
    """

    optics: Optics
    waves: tuple[Floats, ...]
    poses: tuple[Pose, ...] = ()
    height: float = -np.inf

    def same_as(self, other: _End) -> bool:
        """Return whether both are one optimum. Steps between stations give wavefronts their sign, so no twin counts."""
        apart = np.linalg.norm(self.waves[0] - other.waves[0])
        return self.optics == other.optics and bool(apart < SETTINGS.other_coarse_waves)


Ends = tuple[tuple[Optics, tuple[Floats, ...]], ...]
"""Ends of a search, the likeliest first: the optics with its pupil, and (modes,) of each station, waves RMS."""


def search_together(task: TogetherTask) -> Ends:
    """Search several stations from random starts: coarse pictures first, then the best ends in finer ones.

    Other pupils than that of the starts go on from the best end of the coarse pictures.
    """
    coarsest, finer = SETTINGS.coarse_airy
    ends = _from_random_starts(task, coarsest)
    if task.pupils != (task.optics,):
        best = _distinct(ends)[0]
        ends = [
            _climbed(task, coarsest, replace(best, optics=pupil)) for pupil in task.pupils
        ]
    ends = [_climbed(task, finer, end) for end in _distinct(ends)]
    return tuple((end.optics, end.waves) for end in _distinct(ends))


def _coarse(task: TogetherTask, optics: Optics, width_airy: float) -> list[Coarse]:
    """Return the first frame of each station with pixels `width_airy` wide, lambda N."""
    return [
        Coarse.of(optics.in_one_wavelength(), task.target.value, shared.value, width_airy)
        for shared in task.stations
    ]


def _from_random_starts(task: TogetherTask, width_airy: float) -> list[_End]:
    """Climb from random starts until two ended in the best optimum. No start is without defocus: even modes had no slopes."""
    rng = np.random.default_rng(1)
    modes, defocus = len(task.optics.noll) - 1, task.defocus
    beyond = SETTINGS.near_waves
    ends = list[_End]()
    while len(ends) < SETTINGS.strong_starts and not _returned(ends):
        say(f"several ranges at once, start {len(ends) + 1}")
        focus = rng.uniform(min(defocus) - beyond, max(defocus) + beyond)
        others = rng.normal(0, SETTINGS.strong_start_waves, modes)
        start = tuple(np.append(at - focus, others) for at in defocus)
        ends.append(_climbed(task, width_airy, _End(task.optics, start)))
    return ends


def _returned(ends: Sequence[_End]) -> bool:
    """Return whether two ends are the best optimum."""
    if len(ends) < 2:
        return False
    best = max(ends, key=lambda end: end.height)
    return sum(end.same_as(best) for end in ends) > 1


def _distinct(ends: Sequence[_End]) -> list[_End]:
    """Return the best ends that are different optima, the likeliest first."""
    kept = list[_End]()
    for end in sorted(ends, key=lambda end: -end.height):
        if not any(end.same_as(other) for other in kept):
            kept.append(end)
    return kept[: SETTINGS.tried]


def _climbed(task: TogetherTask, width_airy: float, begun: _End) -> _End:
    """Climb from the end of a climb over other pictures of the stations, or from a start."""
    stations, defocus = _coarse(task, begun.optics, width_airy), task.defocus
    poses = begun.poses or (None,) * len(stations)
    problems = tuple(
        station.sketch.holding(waves)
        for station, waves in zip(stations, begun.waves, strict=True)
    )
    firsts = tuple(
        settled(problem, station.state(waves, pose)).state
        for problem, station, waves, pose in zip(
            problems, stations, begun.waves, poses, strict=True
        )
    )
    misfit = np.mean(
        [
            problem.chi2_per_pixel(first, problem.relative(first))
            for problem, first in zip(problems, firsts, strict=True)
        ]
    )
    position = _Stations(
        problems,
        firsts,
        firsts,
        np.array(defocus),
        _precision(defocus),
        Prior.of_lens(begun.optics.noll[1:]),
        # far from an optimum misfit counts as noise, or coarse pictures outweigh what is known of defocus
        1 / max(1.0, float(misfit)),
    )
    end, _, _ = climb(
        position,
        tolerance=SETTINGS.settled_stds,
        max_steps=SETTINGS.strong_steps,
        damping=SETTINGS.first_damping,
    )
    return _End(
        begun.optics,
        tuple(state.waves for state in end.states),
        tuple(one.pose(state) for one, state in zip(stations, end.states, strict=True)),
        end.log_likelihood,
    )


def _precision(defocus: Sequence[float]) -> Floats:
    """Return the inverse covariance (stations, stations) of defocus: best focus is unknown, steps follow the stated lens."""
    steps = np.array(defocus) - np.mean(defocus)
    return np.asarray(
        np.linalg.inv(
            SETTINGS.unknown**2
            + SETTINGS.loose**2 * np.outer(steps, steps)
            + SETTINGS.other_optimum_waves**2 * np.eye(steps.size)
        )
    )


@dataclass(eq=False)
class _Stations(Position):
    """A position of a climb over one frame of each station.

    The parameters are the common modes, then of each station: defocus, pose, light and noise.

    Attributes
    ----------
    problems : the frames and their models
    firsts : where the climb began
    states : the present states, all modes but the first the same
    expected : (stations,) expected defocus, waves RMS, but for best focus
    precision : (stations, stations) inverse covariance of defocus about it
    prior : of the common modes
    weight : weight of the frames beside what is known of modes and defocus
    """

    problems: tuple[Problem, ...]
    firsts: tuple[State, ...]
    states: tuple[State, ...]
    expected: Floats
    precision: Floats
    prior: Prior
    weight: float

    @cached_property
    def _drawn(self) -> list[Start]:
        return [
            problem.drawn(state)
            for problem, state in zip(self.problems, self.states, strict=True)
        ]

    @property
    def _modes(self) -> Floats:
        """The common modes."""
        return self.states[0].waves[1:]

    @property
    def _off(self) -> Floats:
        """Defocus less the expected defocus (stations,)."""
        return np.array([state.waves[0] for state in self.states]) - self.expected

    @cached_property
    def log_likelihood(self) -> float:
        """Log-likelihood of the frames."""
        return sum(
            problem.objective(drawn.state, drawn.relative)
            for problem, drawn in zip(self.problems, self._drawn, strict=True)
        )

    @cached_property
    def objective(self) -> float:
        """Weighted log-likelihood of the frames, with the priors of common modes and defocus."""
        if not all(map(sane, self.states, self.firsts)):
            return -np.inf
        loss = self.prior.loss(self._modes)
        loss += 0.5 * float(self._off @ self.precision @ self._off)
        return self.weight * self.log_likelihood - loss

    @cached_property
    def _slopes(self) -> tuple[Floats, Floats, list[npt.NDArray[np.intp]]]:
        """Gradient, information, and the places of each station's parameters among all."""
        common = self._modes.size
        of_stations = [
            problem.scores(*drawn, by_waves=True)[:2]
            for problem, drawn in zip(self.problems, self._drawn, strict=True)
        ]
        self._drawn[:] = [drawn.undrawn() for drawn in self._drawn]
        ends = common + np.cumsum([g.size - common for g, _ in of_stations])
        gradient, information = np.zeros(ends[-1]), np.zeros((ends[-1], ends[-1]))
        places = []
        for (slope, curvature), end in zip(of_stations, ends, strict=True):
            own = np.arange(end - (slope.size - common), end)
            at = np.concatenate([own[:1], np.arange(common), own[1:]])
            gradient[at] += self.weight * slope
            information[np.ix_(at, at)] += self.weight * curvature
            places.append(at)
        gradient, information = self.prior.joined(gradient, information, self._modes)
        defocus = np.array([at[0] for at in places])
        gradient[defocus] -= self.precision @ self._off
        information[np.ix_(defocus, defocus)] += self.precision
        return gradient, information, places

    def step(self, damping: float) -> Step:
        gradient, information, _ = self._slopes
        return damped_step(gradient, information, damping)

    def moved(self, change: Floats) -> _Stations:
        _, _, places = self._slopes
        states = (
            state.moved(change[at]) for state, at in zip(self.states, places, strict=True)
        )
        return replace(self, states=tuple(states))
