"""What a biased estimator could gain: the uniform Cramér-Rao bound of defocus, thesis Figure 3.6."""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from labkit.execute import run_all
from labkit.experiments.conditions import AIRY_UM, FRAME, carpet, draw_trial, optics
from labkit.experiments.runner import Claim, Outcome, Setting
from labkit.imaging.model import ForwardModel
from labkit.inference.bounds import bias_sensitivity, fisher_information, parameter_names, uniform_bound
from labkit.inference.fisher_scoring import Problem
from labkit.inference.identifiability import bound_of
from labkit.types import Floats

UNDERSAMPLED = (2.5, 6.25)  # the thesis's prose and its figure's caption differ
MULTIPLIERS = np.geomspace(1e4, 1e-3, 60)  # of the bound itself


@dataclass(frozen=True)
class Answer:
    """covariance: (modes, modes) of the unbiased bound, waves^2."""

    covariance: Floats


def work(task: tuple[float, int]) -> Answer:
    """The bound for one wavefront, the pixels so many times as far apart as Nyquist asks."""
    times, seed = task
    trial = draw_trial(np.random.default_rng([36, seed]))
    seen_as = replace(optics(trial.noll), pitch_um=times * AIRY_UM / 2, active_um=times * AIRY_UM / 2)
    model = ForwardModel.build(seen_as, carpet(), (FRAME, FRAME), trial.pose)
    state = trial.state(trial.waves)
    problem = Problem(model, (trial.frame,), trial.noise)
    bound = bound_of(fisher_information(problem, state, 6), parameter_names(state, trial.noll))
    modes = len(trial.noll)
    return Answer(bound.covariance[:modes, :modes])


def run(setting: Setting) -> Outcome:
    """Bound on defocus against the norm of the bias gradient, and its slope at none, over random wavefronts of 0.25 waves."""
    trials = 2 if setting.quick else 40
    tasks = [(times, seed) for times in UNDERSAMPLED for seed in range(trials)]
    answers: dict[int, Answer] = {}
    for index, answer in run_all(work, tasks, setting.workers):
        answers[index] = answer
        setting.progress(len(answers), len(tasks), f"{tasks[index][0]:g} times undersampled")
    rows, claims, curves = [], [], {}
    for times in UNDERSAMPLED:
        own = [answers[k].covariance for k, task in enumerate(tasks) if task[0] == times]
        sensitivity = [-bias_sensitivity(c, 0) for c in own]
        unbiased = [c[0, 0] for c in own]
        # at a bias gradient of 1 % of the estimate's own slope
        gain = [_gain(c, 0.01) for c in own]
        curves[times] = uniform_bound(own[0], 0, MULTIPLIERS * own[0][0, 0])
        label = f"{times:g} times undersampled"
        claims += [
            Claim(
                f"bias sensitivity of defocus, {label}, median", 1e-4, float(np.median(sensitivity)), "waves^2", trials
            ),
            Claim(
                f"unbiased bound of defocus, {label}, median",
                None,
                float(np.sqrt(np.median(unbiased))),
                "waves RMS",
                trials,
            ),
            Claim(
                f"error saved by a bias gradient of 0.01, {label}, median",
                None,
                float(np.median(gain)),
                "waves RMS",
                trials,
            ),
        ]
        rows += [
            {
                "undersampled": times,
                "seed": k,
                "std_defocus": float(np.sqrt(u)),
                "bias_sensitivity": s,
                "saved_waves": g,
            }
            for k, (u, s, g) in enumerate(zip(unbiased, sensitivity, gain, strict=True))
        ]

    def draw() -> Figure:
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

    return Outcome(claims, rows, draw)


def _gain(covariance: Floats, bias: float) -> float:
    """By how much the bound on the standard error falls where the bias gradient may have a norm."""
    delta, bound = uniform_bound(covariance, 0, np.geomspace(1e6, 1e-3, 400) * covariance[0, 0])
    return float(np.sqrt(covariance[0, 0]) - np.sqrt(np.interp(bias, delta, bound)))
