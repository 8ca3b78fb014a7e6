"""Cramér-Rao bounds of a wavefront from each target against read noise, thesis Figure 3.9."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.estimation.climb import NoisePrior, Problem
from labkit.estimation.identifiability import Bound, bound_of
from labkit.experiments.conditions import (
    FRAME,
    GAIN,
    NOISE_STD,
    Trial,
    carpet,
    draw_trial,
    optics,
)
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.imaging.model import ForwardModel
from labkit.plan import TargetSpec
from labkit.target.target import Target, open_target
from labkit.types import Floats

READ_NOISES = (0.25, 0.5, 0.68, 1.0, 2.0, 4.0, 8.0)  # counts
THE_READ_NOISE = 0.68  # the thesis's, in §3.8
SIZE_MM = carpet().size_mm[0]
SPECS = {
    "carpet": TargetSpec(kind="sierpinski", order=5, size_mm=SIZE_MM),
    "tri-bar": TargetSpec(kind="tribar", order=5, size_mm=SIZE_MM),
    "checkerboard": TargetSpec(kind="checkerboard", cells=9, size_mm=SIZE_MM),
    "slanted edge": TargetSpec(kind="slanted_edge", angle_deg=5.0, size_mm=SIZE_MM),
    "noise": TargetSpec(kind="noise", cells=35, size_mm=SIZE_MM),
}
"""Squares of checkerboard and noise in the best size of a few: 7.8 and 2 pixels."""


@dataclass(frozen=True)
class Task:
    seed: int
    target: str


def bounds(target: Target, trial: Trial, read_noises: Sequence[float]) -> list[Bound]:
    """Return the bounds of all parameters for each read noise in counts.

    The trial's wavefront, pose and light are kept, with another target.
    """
    model = ForwardModel.build(optics(trial.noll), target, (FRAME, FRAME), trial.pose)
    bounds_ = []
    for read_noise in read_noises:
        noise = NoisePrior(GAIN, NOISE_STD, read_noise**2, NOISE_STD)
        problem = Problem(model, (trial.frame,), noise)
        state = Trial(trial.frame, trial.pose, trial.waves, trial.noll, read_noise).state(
            trial.waves
        )
        information = problem.scores(state, by_waves=True)[1]
        bounds_.append(bound_of(information, state.parameter_names(trial.noll)))
    return bounds_


def work(task: Task) -> tuple[Floats, str]:
    """Return the RMS bound of the wavefront (read noises,), infinite if undetermined, and the reason in words."""
    trial = draw_trial(np.random.default_rng(task.seed))
    by_noise = bounds(open_target(SPECS[task.target]), trial, READ_NOISES)
    open_ = "; ".join(
        dict.fromkeys(words for bound in by_noise for words in bound.undetermined)
    )
    return np.array([bound.rms(0, len(trial.noll)) for bound in by_noise]), open_


def run(setting: Setting) -> Outcome:
    """Compute each target's RMS bound over random wavefronts, with the same white, pose and light."""
    trials = 2 if setting.quick else 40
    tasks = [Task(seed, name) for name in SPECS for seed in range(trials)]
    answers = all_answers(setting, work, tasks, lambda task: task.target)
    rows = []
    rms = {}
    for name in SPECS:
        of_target = [
            answer
            for answer, task in zip(answers, tasks, strict=True)
            if task.target == name
        ]
        rms[name] = np.sqrt(np.mean([bound**2 for bound, _ in of_target], axis=0))
        rows += _rows(name, rms[name], of_target)
    at = READ_NOISES.index(THE_READ_NOISE)
    carpets = float(rms["carpet"][at])
    claims = [
        Claim(
            "bound with the carpet, read noise 0.68 counts",
            None,
            carpets,
            "waves RMS",
            trials,
        )
    ]
    claims += [
        Claim(
            f"bound with {name} over that with the carpet",
            None,
            float(rms[name][at]) / carpets,
            "",
            trials,
        )
        for name in SPECS
        if name != "carpet"
    ]
    return Outcome(claims, rows, lambda: draw(rms))


def _rows(
    name: str, rms: Floats, answers: Sequence[tuple[Floats, str]]
) -> list[dict[str, Any]]:
    """Return rows of the table: one target, a row for each read noise."""
    bounds_ = np.array([bound for bound, _ in answers])
    open_ = sorted({words for _, words in answers} - {""})
    return [
        {
            "target": name,
            "read_noise_counts": read_noise,
            "trials": len(answers),
            "rms_bound_waves": float(rms[k]),
            "least": float(bounds_[:, k].min()),
            "most": float(bounds_[:, k].max()),
            "undetermined": "; ".join(open_),
        }
        for k, read_noise in enumerate(READ_NOISES)
    ]


def draw(rms: dict[str, Floats]) -> Figure:
    """Plot bounds of all targets against read noise."""
    figure = Figure(figsize=(6.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for name, mark in zip(SPECS, "so^Dv", strict=True):
        known = np.isfinite(rms[name])
        label = name if known.all() else f"{name} (not all modes determined)"
        axes.loglog(
            np.array(READ_NOISES)[known],
            rms[name][known],
            marker=mark,
            markersize=4,
            label=label,
        )
    axes.set(
        xlabel="read noise (counts)",
        ylabel="waves RMS",
        title="Least error of a wavefront, by target",
    )
    axes.legend()
    return figure
