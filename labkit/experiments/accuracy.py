"""Accuracy against the Cramér-Rao bound and SNR, from good starts: thesis Figure 3.11."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure

from labkit.execute import run_all
from labkit.experiments.conditions import draw_trial, random_waves
from labkit.experiments.runner import Claim, Outcome, Setting
from labkit.inference.fisher_scoring import maximize
from labkit.report.style import SOFT
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
    problem, start = trial.problem, trial.state(trial.waves + random_waves(rng, len(trial.noll), START_WAVES))
    began = perf_counter()
    found = maximize(problem, start)
    seconds = perf_counter() - began
    modes = len(trial.noll)
    bound = np.sqrt(np.diag(found.covariance())[:modes])
    return Answer(found.state.waves - trial.waves, bound, found.chi2_per_pixel, seconds)


def run(setting: Setting) -> Outcome:
    """RMS error over RMS bound, in dB, over random wavefronts at each SNR; most of them at the thesis's own."""
    counts = {snr: (2 if setting.quick else 200 if snr == THE_SNR else 40) for snr in SNRS}
    tasks = [Task(seed, snr) for snr, count in counts.items() for seed in range(count)]
    answers: dict[int, Answer] = {}
    for index, answer in run_all(work, tasks, setting.workers):
        answers[index] = answer
        setting.progress(len(answers), len(tasks), f"SNR {tasks[index].snr:g}")
    rows = []
    for snr, count in counts.items():
        own = [answers[k] for k, task in enumerate(tasks) if task.snr == snr]
        errors, bounds = np.array([a.error for a in own]), np.array([a.bound for a in own])
        error, bound = (float(np.sqrt(np.mean(np.sum(e**2, axis=1)))) for e in (errors, bounds))
        z = errors / bounds
        rows.append(
            {
                "snr": snr,
                "trials": count,
                "rms_error_waves": error,
                "rms_bound_waves": bound,
                "error_over_bound_db": 20 * float(np.log10(error / bound)),
                "bias_waves": float(np.linalg.norm(errors.mean(axis=0))),
                "bias_of_chance_waves": float(np.sqrt(np.sum(errors.var(axis=0)) / count)),
                "z_std": float(z.std()),
                "beyond_3": float(np.mean(np.abs(z) > 3)),
                "chi2_per_pixel": float(np.mean([a.chi2 for a in own])),
                "median_seconds": float(np.median([a.seconds for a in own])),
            }
        )
    at = next(row for row in rows if row["snr"] == THE_SNR)
    n = counts[THE_SNR]
    claims = [
        Claim("RMS error over the bound, SNR 75", 2.0, at["error_over_bound_db"], "dB", n),
        Claim("RMS wavefront error, SNR 75", 1e-3, at["rms_error_waves"], "waves RMS", n),
        Claim("norm of the mean error, SNR 75", None, at["bias_waves"], "waves RMS", n),
        Claim("the same expected of chance", None, at["bias_of_chance_waves"], "waves RMS", n),
        Claim("standard deviation of error over standard error", None, at["z_std"], "", n * 12),
        Claim("time of a local fit, median", 18 * 60.0, at["median_seconds"], "s", n),
    ]

    def draw() -> Figure:
        figure = Figure(figsize=(6.0, 3.8), layout="constrained")
        axes = figure.subplots()
        snr = [row["snr"] for row in rows]
        axes.loglog(snr, [row["rms_error_waves"] for row in rows], "o", label="RMS error")
        axes.loglog(snr, [row["rms_bound_waves"] for row in rows], "-", label="Cramér-Rao bound")
        axes.loglog(snr, [row["bias_waves"] for row in rows], "s", mfc="none", label="norm of the mean error")
        axes.loglog(snr, [row["bias_of_chance_waves"] for row in rows], ":", label="the same expected of chance")
        axes.axhline(MARECHAL_WAVES, color=SOFT, linewidth=0.8)
        axes.text(snr[0], MARECHAL_WAVES * 1.08, "Maréchal: 1/14 wave", color=SOFT)
        axes.set(xlabel="SNR", ylabel="waves RMS", title="Wavefront error from a start 0.01 waves off")
        axes.legend()
        return figure

    return Outcome(claims, rows, draw)
