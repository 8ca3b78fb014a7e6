"""The possible gain of a biased estimator: the uniform Cramér-Rao bound of defocus, thesis Figure 3.6."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.estimation.climb import Problem
from labkit.estimation.identifiability import bound_of
from labkit.experiments.conditions import AIRY_UM, FRAME, carpet, draw_trial, optics
from labkit.experiments.methods.bounds import (
    bias_sensitivity,
    fisher_information,
    uniform_bound,
)
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.imaging.model import ForwardModel
from labkit.types import Floats

UNDERSAMPLED = (2.5, 6.25)  # the thesis's prose and its figure's caption differ
MULTIPLIERS = np.geomspace(1e4, 1e-3, 60)  # of the bound itself


@dataclass(frozen=True)
class Answer:
    """covariance: (modes, modes) of the unbiased bound, waves^2."""

    covariance: Floats


def work(task: tuple[float, int]) -> Answer:
    """Return the bound for one wavefront, with pixels at a multiple of Nyquist's distance."""
    times, seed = task
    trial = draw_trial(np.random.default_rng([36, seed]))
    sampled = replace(
        optics(trial.noll), pitch_um=times * AIRY_UM / 2, active_um=times * AIRY_UM / 2
    )
    model = ForwardModel.build(sampled, carpet(), (FRAME, FRAME), trial.pose)
    state = trial.state(trial.waves)
    problem = Problem(model, (trial.frame,), trial.noise)
    bound = bound_of(
        fisher_information(problem, state, 6), state.parameter_names(trial.noll)
    )
    modes = len(trial.noll)
    return Answer(bound.covariance[:modes, :modes])


def run(setting: Setting) -> Outcome:
    """Bound on defocus against the norm of the bias gradient, and its slope at none, over random wavefronts of 0.25 waves."""
    trials = 2 if setting.quick else 40
    tasks = [(times, seed) for times in UNDERSAMPLED for seed in range(trials)]
    answers = all_answers(
        setting, work, tasks, lambda task: f"{task[0]:g} times undersampled"
    )
    rows = list[dict[str, Any]]()
    claims = list[Claim]()
    curves = {}
    for times in UNDERSAMPLED:
        covariances = [
            a.covariance for a, task in zip(answers, tasks, strict=True) if task[0] == times
        ]
        of_times = [
            _row(times, seed, covariance) for seed, covariance in enumerate(covariances)
        ]
        curves[times] = uniform_bound(covariances[0], 0, MULTIPLIERS * covariances[0][0, 0])
        rows += of_times
        claims += _claims(f"{times:g} times undersampled", of_times)
    return Outcome(claims, rows, lambda: draw(curves))


def _row(times: float, seed: int, covariance: Floats) -> dict[str, Any]:
    """Return a row of the table, with the gain at a bias gradient of 1 % of the estimate's own slope."""
    return {
        "undersampled": times,
        "seed": seed,
        "std_defocus": float(np.sqrt(covariance[0, 0])),
        "bias_sensitivity": -bias_sensitivity(covariance, 0),
        "saved_waves": _gain(covariance, 0.01),
    }


def _claims(label: str, rows: list[dict[str, Any]]) -> list[Claim]:
    sensitivity, saved = (
        float(np.median([row[key] for row in rows]))
        for key in ("bias_sensitivity", "saved_waves")
    )
    unbiased = float(np.sqrt(np.median([row["std_defocus"] ** 2 for row in rows])))
    n = len(rows)
    return [
        Claim(
            f"bias sensitivity of defocus, {label}, median", 1e-4, sensitivity, "waves^2", n
        ),
        Claim(
            f"unbiased bound of defocus, {label}, median", None, unbiased, "waves RMS", n
        ),
        Claim(
            f"error saved by a bias gradient of 0.01, {label}, median",
            None,
            saved,
            "waves RMS",
            n,
        ),
    ]


def draw(curves: dict[float, tuple[Floats, Floats]]) -> Figure:
    """Plot bounds on defocus against the norm of the bias gradient."""
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes = figure.subplots()
    for times, (delta, bound) in curves.items():
        axes.plot(delta, 1e3 * np.sqrt(bound), label=f"{times:g} times undersampled")
    axes.set(
        xlabel="norm of the bias gradient",
        ylabel="bound on defocus / 1e-3 waves RMS",
        title="Uniform bound of defocus, one wavefront of 0.25 waves",
        xlim=(0, 1),
        ylim=(0, None),
    )
    axes.legend()
    return figure


def _gain(covariance: Floats, bias: float) -> float:
    """Return the relative decrease of the standard error's bound for a norm of the bias gradient."""
    delta, bound = uniform_bound(
        covariance, 0, np.geomspace(1e6, 1e-3, 400) * covariance[0, 0]
    )
    return float(np.sqrt(covariance[0, 0]) - np.sqrt(np.interp(bias, delta, bound)))
