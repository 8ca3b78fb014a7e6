"""Rate of wrong optima of a quasi-Newton maximisation from zero wavefront: thesis §4.1."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

from labkit.estimation.climb import maximize
from labkit.experiments.conditions import Trial, draw_trial, random_waves
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.types import Floats

SADDLE_WAVES = 1e-3  # RMS: at exactly zero the likelihood has a saddle
RIGHT_WAVES = 0.02  # RMS error below which the right optimum, or its twin, was reached


@dataclass(frozen=True)
class Answer:
    """Errors, waves RMS: of quasi-Newton and of Fisher scoring from near zero, and of the latter from 0.2 waves."""

    quasi_newton: float
    scoring: float
    scoring_from_random: float


def work(seed: int) -> Answer:
    """Maximise three times in one image, its pose known each time."""
    rng = np.random.default_rng([41, seed])
    trial = draw_trial(rng)
    near = random_waves(rng, len(trial.noll), SADDLE_WAVES)
    problem = trial.problem
    ends = [
        quasi_newton(trial, near),
        maximize(problem, trial.state(near)).state.waves,
        maximize(problem, trial.state(random_waves(rng, len(trial.noll), 0.2))).state.waves,
    ]
    return Answer(*(float(np.linalg.norm(trial.error(end))) for end in ends))


def quasi_newton(trial: Trial, start: Floats) -> Floats:
    """Maximise the likelihood of the wavefront by SciPy's L-BFGS-B, all other parameters at the truth."""
    problem = trial.problem
    modes = len(trial.noll)
    drawing = problem.draw(trial.state(start))

    def lowered(waves: Floats) -> tuple[float, Floats]:
        state = trial.state(waves)
        gradient, _, scores, _ = problem.scores(state, drawing, by_waves=True)
        return -scores[0].log_likelihood, -gradient[:modes]

    return np.asarray(
        minimize(lowered, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
    )


def run(setting: Setting) -> Outcome:
    """Measure the share of random wavefronts of 0.25 waves for which each maximisation ends in a wrong optimum."""
    trials = 2 if setting.quick else 50
    answers = all_answers(setting, work, list(range(trials)), lambda seed: "wavefronts")
    rows = [
        {
            "seed": seed,
            "quasi_newton_from_zero": answer.quasi_newton,
            "fisher_scoring_from_zero": answer.scoring,
            "fisher_scoring_from_0.2_waves": answer.scoring_from_random,
        }
        for seed, answer in enumerate(answers)
    ]
    wrong = [
        float(np.mean([float(row[key]) > RIGHT_WAVES for row in rows]))
        for key in list(rows[0])[1:]
    ]
    whats = (
        "quasi-Newton from near zero",
        "Fisher scoring from near zero",
        "Fisher scoring from 0.2 waves at random",
    )
    claims = [
        Claim(f"wrong optimum, {what}", thesis, share, "", trials)
        for what, thesis, share in zip(whats, (0.96, None, None), wrong, strict=True)
    ]
    return Outcome(claims, rows, lambda: draw(rows, wrong))


def draw(rows: list[dict[str, Any]], wrong: Sequence[float]) -> Figure:
    """Plot histograms of the final errors.

    wrong: shares, in the order of the columns
    """
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    edges = [float(edge) for edge in np.geomspace(3e-4, 1.0, 40)]
    names = (
        "quasi-Newton from zero",
        "Fisher scoring from zero",
        "Fisher scoring from 0.2 waves",
    )
    for key, name, share in zip(list(rows[0])[1:], names, wrong, strict=True):
        errors = [float(row[key]) for row in rows]
        axes.hist(
            errors,
            edges,
            histtype="step",
            linewidth=1.4,
            label=f"{name}: {share:.0%} wrong",
        )
    title = "Where maximisations end, 0.25 waves, 12 modes"
    axes.set(xscale="log", xlabel="error / waves RMS", ylabel="wavefronts", title=title)
    axes.legend()
    return figure
