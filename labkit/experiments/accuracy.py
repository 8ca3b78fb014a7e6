"""Accuracy against the Cramér-Rao bound and SNR, from good starts: thesis Figure 3.11."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.estimation.climb import maximize
from labkit.experiments.conditions import draw_trial, random_waves
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.figure_style import SOFT_INK
from labkit.types import Floats

SNRS = (5.0, 10.0, 20.0, 40.0, 75.0, 150.0)
THE_SNR = 75.0
START_WAVES = 0.01  # RMS from the truth, as in the thesis
MARECHAL_WAVES = 1 / 14


@dataclass(frozen=True)
class Task:
    seed: int
    snr: float


@dataclass(frozen=True)
class Answer:
    """error, bound: (modes,) waves RMS; seconds: of the local fit."""

    error: Floats
    bound: Floats
    chi2: float
    seconds: float


def work(task: Task) -> Answer:
    """Fit one picture from a start near the truth."""
    rng = np.random.default_rng([task.seed, round(task.snr)])
    trial = draw_trial(rng, snr=task.snr)
    problem = trial.problem
    start = trial.state(trial.waves + random_waves(rng, len(trial.noll), START_WAVES))
    began = perf_counter()
    solution = maximize(problem, start)
    seconds = perf_counter() - began
    modes = len(trial.noll)
    bound = np.sqrt(np.diag(solution.covariance())[:modes])
    return Answer(
        solution.state.waves - trial.waves, bound, solution.chi2_per_pixel, seconds
    )


def run(setting: Setting) -> Outcome:
    """Measure RMS error over RMS bound, in dB, over random wavefronts at each SNR; most at the thesis's own."""
    counts = {snr: (1 if setting.quick else 200 if snr == THE_SNR else 40) for snr in SNRS}
    tasks = [Task(seed, snr) for snr, count in counts.items() for seed in range(count)]
    answers = all_answers(setting, work, tasks, lambda task: f"SNR {task.snr:g}")
    rows = [
        _row(snr, [a for a, task in zip(answers, tasks, strict=True) if task.snr == snr])
        for snr in counts
    ]
    return Outcome(
        _claims(next(row for row in rows if row["snr"] == THE_SNR)),
        rows,
        lambda: draw(rows),
    )


def _row(snr: float, answers: Sequence[Answer]) -> dict[str, Any]:
    """Return a row of the table: all trials at one SNR."""
    errors = np.array([a.error for a in answers])
    bounds = np.array([a.bound for a in answers])
    error, bound = (float(np.sqrt(np.mean(np.sum(e**2, axis=1)))) for e in (errors, bounds))
    z = errors / bounds
    return {
        "snr": snr,
        "trials": len(answers),
        "rms_error_waves": error,
        "rms_bound_waves": bound,
        "error_over_bound_db": 20 * float(np.log10(error / bound)),
        "bias_waves": float(np.linalg.norm(errors.mean(axis=0))),
        "bias_of_chance_waves": float(np.sqrt(np.sum(errors.var(axis=0)) / len(answers))),
        "z_std": float(z.std()),
        "beyond_3": float(np.mean(np.abs(z) > 3)),
        "chi2_per_pixel": float(np.mean([a.chi2 for a in answers])),
        "median_seconds": float(np.median([a.seconds for a in answers])),
    }


def _claims(row: dict[str, Any]) -> list[Claim]:
    n = row["trials"]
    return [
        Claim("RMS error over the bound, SNR 75", 2.0, row["error_over_bound_db"], "dB", n),
        Claim("RMS wavefront error, SNR 75", 1e-3, row["rms_error_waves"], "waves RMS", n),
        Claim("norm of the mean error, SNR 75", None, row["bias_waves"], "waves RMS", n),
        Claim(
            "the same expected of chance", None, row["bias_of_chance_waves"], "waves RMS", n
        ),
        Claim(
            "standard deviation of error over standard error",
            None,
            row["z_std"],
            "",
            n * 12,
        ),
        Claim("time of a local fit, median", 18 * 60.0, row["median_seconds"], "s", n),
    ]


def draw(rows: list[dict[str, Any]]) -> Figure:
    """Plot errors, bounds and biases against SNR."""
    figure = Figure(figsize=(6.0, 3.8), layout="constrained")
    axes = figure.subplots()
    snr = [row["snr"] for row in rows]
    axes.loglog(snr, [row["rms_error_waves"] for row in rows], "o", label="RMS error")
    axes.loglog(
        snr, [row["rms_bound_waves"] for row in rows], "-", label="Cramér-Rao bound"
    )
    axes.loglog(
        snr,
        [row["bias_waves"] for row in rows],
        "s",
        mfc="none",
        label="norm of the mean error",
    )
    axes.loglog(
        snr,
        [row["bias_of_chance_waves"] for row in rows],
        ":",
        label="the same expected of chance",
    )
    axes.axhline(MARECHAL_WAVES, color=SOFT_INK, linewidth=0.8)
    axes.text(snr[0], MARECHAL_WAVES * 1.08, "Maréchal: 1/14 wave", color=SOFT_INK)
    axes.set(
        xlabel="SNR",
        ylabel="waves RMS",
        title="Wavefront error from a start 0.01 waves off",
    )
    axes.legend()
    return figure
