"""Optima that nobody searched for: of photographs through a 70 mm f/2.8 lens that is focused at 3 m, as its laws have them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labkit.errors import LostTasksError
from labkit.estimation.candidate import Measured
from labkit.estimation.climb import NoisePrior, State
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Found, Optimum
from labkit.estimation.observation import Observation
from labkit.estimation.residuals import Verdict
from labkit.estimation.ridge import Ridge
from labkit.estimation.scores import ScoreTest
from labkit.estimation.searches import Task
from labkit.estimation.session import estimate
from labkit.estimation.together import Ends, TogetherTask, search_together
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.plan import Plan
from labkit.target.target import CellTarget
from labkit.types import Floats
from tests.lens_samples import laws, measured
from tests.plans import PORTRAIT

NOISE = NoisePrior(0.5, 0.01, 4.0, 0.02)
TARGET = CellTarget(np.eye(2), (9.0, 9.0), 0.0)
POSE = Pose.from_corners(np.array([[0.0, 0], [0, 9], [9, 9], [9, 0]]), (9.0, 9.0))
LIGHTS = [
    {"name": name, "wavelength_nm": nm}
    for name, nm in (("G", 550.0), ("R", 620.0), ("B", 470.0))
]
PLAN = Plan.from_tables(
    {
        **PORTRAIT,
        "channel": LIGHTS,
        "fit": {"zernike_noll": [4, 5], "reference_wavelength_nm": 450.0},
    }
)
RANGES_MM = (2900.0, 3010.0, 3100.0, 3200.0)
FOCUS_MM = 3000.0
ASTIGMATISM = 0.02
"""Waves RMS, of all wavefronts."""
PIXELS = 1000
"""Of each photograph."""


def observations(
    channels: str = "G", ranges_mm: Sequence[float] = RANGES_MM
) -> list[Observation]:
    """One photograph at each range, cut for each channel from the same pixel."""
    return [
        Observation(r, r, c, (f"{r:g}.dng",), (), (), NOISE, ((0, 0),), 1, order=k)
        for k, r in enumerate(ranges_mm)
        for c in channels
    ]


def true_values(range_mm: float) -> Floats:
    """(4,) defocus, astigmatism, ln cone, ln scale."""
    waves, cone, scale = laws(range_mm, FOCUS_MM, FOCUS_MM, 70.0, 2.8, 1.0)
    return np.array([waves, ASTIGMATISM, cone, scale])


def measured_by(
    optics: Optics, range_mm: float, off: Sequence[float], square: float | Floats
) -> Measured:
    """What a fit measures whose modes are off by some waves, and whose camera parts have one number, or some, known to 0.01."""
    defocus, astigmatism, cone, scale = true_values(range_mm) + np.array([*off, 0.0, 0.0])
    plain = measured(np.array([defocus, cone, scale]), {5: astigmatism})
    labels = optics.camera_labels
    inserted = [2] * len(labels)
    covariance = np.diag(np.insert(np.zeros(4), inserted, 1e-4))
    others = [0, 1, -2, -1]
    covariance[np.ix_(others, others)] = plain.covariance
    values = np.insert(plain.values, inserted, square)
    return replace(
        plain,
        values=values,
        covariance=covariance,
        calibration=0 * covariance,
        parts=labels,
    )


def optimum(
    optics: Optics,
    range_mm: float,
    *,
    off: Sequence[float] = (0.0, 0.0),
    square: float | Floats = 0.0,
    height: float = 0.0,
    explained: bool = True,
    unexplained: float = 0.0,
    scores: Mapping[str, ScoreTest] | None = None,
) -> Optimum:
    """An optimum that measures `measured_by`. height: log-likelihood; unexplained: log-likelihood that residuals lack."""
    of = measured_by(optics, range_mm, off, square)
    return Optimum(
        State(of.values[:2], (POSE,), np.ones(1), np.zeros(1), NOISE.centre),
        optics.with_camera_parameters(of.values[2:-1]),
        of.covariance[:2, :2],
        of,
        replace(of, covariance=100 * of.covariance, model=99 * of.covariance),
        Ridge(of.values, np.eye(of.values.size)),
        height,
        1 + 2 * unexplained / PIXELS,
        Verdict(0.5 if explained else 0.0, explained, 0.0, 0.0),
        (np.ones(PIXELS),),
        np.ones(1),
        scores or {},
    )


def range_of(task: Task) -> float:
    """mm, of the frames of a task."""
    return float(task.label.split()[2])


def right(task: Task) -> Found:
    """The right optimum."""
    return Found((optimum(task.optics, range_of(task)),))


"""Of a search over several stations: wavefronts (modes,) of each station."""


@dataclass
class Play:
    """A run whose searches end as a function of their tasks has it.

    Attributes
    ----------
    ends : what a search finds; None where its process is killed
    together : ends of a search over several stations; None where its process is killed
    order : of the results, given how many they are
    batches : searches, as they were asked for
    common : searches over several stations, as they were asked for
    """

    ends: Callable[[Task], Found | None] = right
    together: Callable[[TogetherTask], Ends | None] = lambda task: None
    order: Callable[[int], Sequence[int]] = range
    batches: list[list[Task]] = field(default_factory=list)
    common: list[TogetherTask] = field(default_factory=list)

    def __call__(
        self, function: Callable[[Any], Any], tasks: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        results: list[Any]
        if function is search_together:
            self.common += tasks
            results = [self.together(task) for task in tasks]
        else:
            self.batches.append([*tasks])
            results = [self.ends(task) for task in tasks]
        yield from (
            (k, results[k]) for k in self.order(len(tasks)) if results[k] is not None
        )
        if lost := [
            (task, "killed")
            for task, result in zip(tasks, results, strict=True)
            if result is None
        ]:
            raise LostTasksError(lost)

    @property
    def labels(self) -> list[list[str]]:
        """Of the tasks."""
        return [[task.label for task in batch] for batch in self.batches]


def played(
    play: Play,
    channels: str = "G",
    *,
    ranges_mm: Sequence[float] = RANGES_MM,
    plan: Plan = PLAN,
    plain: bool = False,
) -> Estimate:
    """The estimate of a session whose searches are played."""
    shown = dict.fromkeys(channels, TARGET)
    seen = observations(channels, ranges_mm)
    return estimate(seen, plan, shown, play, lambda done, of, what: None, plain=plain)
