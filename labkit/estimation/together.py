"""A climb over several stations at once, from nothing, for wavefronts too strong for a search at one station.

With half a wave RMS in high orders a picture has many optima, and most are nearly as good as the right one. Pictures of one
lens with several amounts of defocus leave few (phase diversity: R. A. Gonsalves, Opt. Eng. 21, 829 (1982)). All modes but
defocus are common to the stations. One frame of each is sketched, with the stated f-number: the end is a start for climbs over
the whole likelihood of each station.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from labkit.estimation.climb import (
    Position,
    Problem,
    Start,
    State,
    Step,
    climb,
    damped_step,
    sane,
)
from labkit.estimation.local import Views, first_state
from labkit.estimation.settings import SETTINGS
from labkit.estimation.starts import Sketches, fitted_light, settle
from labkit.imaging.optics import Optics
from labkit.processes import say
from labkit.sharing import Shared
from labkit.target import Target
from labkit.types import Floats


@dataclass(frozen=True)
class TogetherTask:
    """One climb over several stations as a task.

    Attributes
    ----------
    optics : lens, light and sensor, the first mode defocus
    target : the target as shown
    stations : frames of each station
    defocus : of each station relative to the first, by the stated lens, waves RMS at the reference wavelength
    rank : place of the best focus to start from, among the likeliest
    """

    optics: Optics
    target: Shared[Target]
    stations: tuple[Shared[Views], ...]
    defocus: tuple[float, ...]
    rank: int


def climb_together(task: TogetherTask) -> tuple[Floats, ...]:
    """Climb from one of the likeliest best foci, all modes but defocus from zero.

    Returns
    -------
    (modes,) of each station, waves RMS
    """
    say(f"several ranges at once, start {task.rank + 1}")
    optics = task.optics.in_one_wavelength()
    sketches = [
        Sketches(optics, task.target.value, v.frames[0], v.poses[0], v.noise)
        for v in (shared.value for shared in task.stations)
    ]
    states = _from_best_focus(sketches, task.defocus, task.rank)
    problems = tuple(one.wide for one in sketches)
    firsts = tuple(
        settle(problem, state) for problem, state in zip(problems, states, strict=True)
    )
    end, _, _ = climb(
        _Stations(problems, firsts, firsts),
        tolerance=1.0,
        max_steps=SETTINGS.strong_steps,
        damping=SETTINGS.first_damping,
    )
    return tuple(state.waves for state in end.states)


def _from_best_focus(
    sketches: Sequence[Sketches], defocus: Sequence[float], rank: int
) -> list[State]:
    """Return a state for each station, without other modes, for the best focus of a rank.

    Misfits of all stations are added. Of best foci nearer than `SETTINGS.near_waves` to each other the likeliest counts.
    """
    optics = sketches[0].optics
    scale = optics.wavelength_um / optics.reference_um
    beyond, step = (
        SETTINGS.swept_waves[-1] * scale,
        SETTINGS.foci_waves * scale,
    )
    # no focus is on a station: without any defocus all even modes have no slopes
    foci = np.arange(min(defocus) - beyond, max(defocus) + beyond, step) + step / 3
    tried = list[tuple[float, float, list[State]]]()
    firsts = [first_state(s.frame, s.pose, s.noise, len(optics.noll)) for s in sketches]
    drawings = [s.wide.draw(first) for s, first in zip(sketches, firsts, strict=True)]
    for focus in foci:
        lit = [
            fitted_light(
                sketch.wide,
                replace(first, waves=np.append(at - focus, np.zeros(first.waves.size - 1))),
                drawing,
            )
            for sketch, first, drawing, at in zip(
                sketches, firsts, drawings, defocus, strict=True
            )
        ]
        tried.append(
            (sum(misfit for misfit, _ in lit), float(focus), [state for _, state in lit])
        )
    likeliest = list[tuple[float, list[State]]]()
    for _, focus, states in sorted(tried, key=lambda one: one[0]):
        if all(abs(focus - other) > SETTINGS.near_waves * scale for other, _ in likeliest):
            likeliest.append((focus, states))
    return likeliest[min(rank, len(likeliest) - 1)][1]


@dataclass(eq=False)
class _Stations(Position):
    """A position of a climb over one frame of each station.

    The parameters are the common modes, then of each station: defocus, pose, light and noise.

    Attributes
    ----------
    problems : the frames and their models
    firsts : where the climb began
    states : the present states, all modes but the first the same
    """

    problems: tuple[Problem, ...]
    firsts: tuple[State, ...]
    states: tuple[State, ...]

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

    @cached_property
    def objective(self) -> float:
        """Log-likelihood of the frames, with the prior of the common modes."""
        if not all(map(sane, self.states, self.firsts)):
            return -np.inf
        fits = (
            problem.objective(drawn.state, drawn.relative)
            for problem, drawn in zip(self.problems, self._drawn, strict=True)
        )
        away = self._modes / SETTINGS.strong_modes_std
        return sum(fits) - 0.5 * float(away @ away)

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
            gradient[at] += slope
            information[np.ix_(at, at)] += curvature
            places.append(at)
        precision = SETTINGS.strong_modes_std**-2
        gradient[:common] -= precision * self._modes
        information[np.arange(common), np.arange(common)] += precision
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
