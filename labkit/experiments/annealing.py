"""Time to the optimum, our search beside SciPy's `dual_annealing` with the same likelihood and gradient: thesis Figure 4.19."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import dual_annealing

from labkit.experiments.conditions import NOLL, SEVEN, draw_trial
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.types import Floats

BOUND_WAVES = 0.25  # of every mode, for the annealing
FOUND = 50.0  # log-likelihoods below that of the true wavefront that still belong to its optimum


@dataclass(frozen=True)
class Task:
    noll: tuple[int, ...]
    seed: int
    cap_s: float


@dataclass(frozen=True)
class Answer:
    """Seconds of both methods; the annealing's is the cap if it failed. found: whether labkit succeeded."""

    search: float
    annealing: float
    found: bool
    capped: bool


class _EnoughError(Exception):
    """The annealing has found the optimum, or its time is up."""


def work(task: Task) -> Answer:
    """Search one image by both methods.

    The annealing knows the pose, and stops as soon as it is in the right optimum; labkit
    knows nothing.
    """
    rng = np.random.default_rng([43, len(task.noll), task.seed])
    trial = draw_trial(rng, noll=task.noll)
    fit = trial.fit(rng)
    problem = trial.problem
    modes = len(task.noll)
    drawing = problem.draw(trial.state(trial.waves))

    def height(waves: Floats) -> float:
        state = trial.state(waves)
        return -problem.objective(state, problem.relative(state, drawing))

    def slope(waves: Floats) -> Floats:
        return -problem.scores(trial.state(waves), drawing, by_waves=True)[0][:modes]

    goal = height(trial.waves) + FOUND
    began = perf_counter()

    def watched(waves: Floats) -> float:
        value = height(waves)
        if value < goal or perf_counter() - began > task.cap_s:
            raise _EnoughError(value < goal)
        return value

    capped = False
    local: Any = {"method": "L-BFGS-B", "jac": slope, "bounds": [(-0.5, 0.5)] * modes}
    limits = [(-BOUND_WAVES, BOUND_WAVES)] * modes
    try:
        dual_annealing(
            watched, limits, maxiter=10**6, maxfun=10**9, rng=rng, minimizer_kwargs=local
        )
    except _EnoughError as enough:
        capped = not enough.args[0]
    annealing = task.cap_s if capped else perf_counter() - began
    return Answer(fit.seconds, annealing, trial.found(fit.best.waves), capped)


def run(setting: Setting) -> Outcome:
    """Measure mean times over wavefronts of 0.25 waves with 7 and with 12 modes."""
    cap = 4.0 if setting.quick else 600.0
    tasks = [
        Task(noll, seed, cap)
        for noll in (SEVEN, NOLL)
        for seed in range(1 if setting.quick else 20)
    ]
    answers = all_answers(setting, work, tasks, lambda task: f"{len(task.noll)} modes")
    rows = [
        {
            "modes": len(task.noll),
            "seed": task.seed,
            "search_seconds": answer.search,
            "search_found": answer.found,
            "annealing_seconds": answer.annealing,
            "annealing_capped": answer.capped,
        }
        for task, answer in zip(tasks, answers, strict=True)
    ]
    claims = []
    for noll, thesis in ((SEVEN, 5.0), (NOLL, None)):
        claims += _claims(
            len(noll),
            thesis,
            cap,
            [a for a, t in zip(answers, tasks, strict=True) if t.noll == noll],
        )
    return Outcome(claims, rows, lambda: draw(rows, cap))


def _claims(
    modes: int, thesis: float | None, cap: float, answers: Sequence[Answer]
) -> list[Claim]:
    ours, theirs = (
        float(np.mean([getattr(a, key) for a in answers]))
        for key in ("search", "annealing")
    )
    label = f"{modes} modes"
    n = len(answers)
    return [
        Claim(
            f"mean time of the annealing over that of the search, {label}",
            thesis,
            theirs / ours,
            "",
            n,
        ),
        Claim(f"mean time of the search, {label}", None, ours, "s", n),
        Claim(
            f"mean time of the annealing, {label}, capped at {cap:g} s",
            None,
            theirs,
            "s",
            n,
        ),
        Claim(
            f"annealings that ran into the cap, {label}",
            None,
            float(sum(a.capped for a in answers)),
            "",
            n,
        ),
    ]


def draw(rows: list[dict[str, Any]], cap: float) -> Figure:
    """Plot the times of both methods for each image."""
    figure = Figure(figsize=(5.2, 3.8), layout="constrained")
    axes = figure.subplots()
    for modes, marker in ((len(SEVEN), "o"), (len(NOLL), "s")):
        of_both = [
            (row["search_seconds"], row["annealing_seconds"])
            for row in rows
            if row["modes"] == modes
        ]
        axes.loglog(*zip(*of_both, strict=True), marker, label=f"{modes} modes")
    axes.axhline(cap, linewidth=0.8, linestyle=":", color="0.5")
    axes.set(
        xlabel="our search / s",
        ylabel="dual annealing / s",
        title="Time to the optimum, from nothing",
    )
    axes.legend()
    return figure
