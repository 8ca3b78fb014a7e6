"""How well tests distinguish global from local optima at the conditions of thesis §3.8: `python -m benchmarks.local_tests`."""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from labkit.estimation.climb import Problem, State, maximize
from labkit.estimation.residuals import judge
from labkit.estimation.settings import SETTINGS
from labkit.experiments.conditions import draw_trial, random_waves
from labkit.experiments.methods.optimum_tests import (
    bootstrap,
    embedding,
    one_sided,
    recalibrated,
    two_sided,
)
from labkit.experiments.methods.psf_basis import shipped_psf_basis
from labkit.experiments.roc import area
from labkit.jobs.execute import default_workers, run_all
from labkit.types import Floats

STARTS = 6
WRONG = 0.03  # waves RMS from the truth and its twin: twenty times the bound


def embedded(problem: Problem, state: State, degrees: int) -> float:
    """p-value of the embedding of so many degrees."""
    return embedding(problem, state, shipped_psf_basis(degrees)).p_value


def residuals(problem: Problem, state: State, model_error: float) -> float:
    """p-value of the test that the search uses."""
    return judge(problem, state, problem.relative(state), model_error).p_value


TESTS: dict[str, Callable[[Problem, State], float]] = {
    "Biernacki, two-sided": lambda p, s: two_sided(p, s).p_value,
    "one-sided": lambda p, s: one_sided(p, s).p_value,
    **{
        f"embedding, {k} degree{'s' if k > 1 else ''}": partial(embedded, degrees=k)
        for k in (1, 4, 16)
    },
    "residuals": partial(residuals, model_error=0.0),
    "residuals, as in use": partial(residuals, model_error=0.01),
}


@dataclass(frozen=True)
class Answer:
    """p-values in the order of TESTS: at the right optimum; at one of data drawn from it, fitted anew; and at a wrong one,
    where a start ended in one. seconds: of each test."""

    right: list[float]
    drawn: list[float]
    wrong: list[float] | None
    seconds: list[float]


def work(task: tuple[float, int, int]) -> Answer:
    """One picture: the optimum beside the truth, and the first wrong one of some random starts."""
    snr, seed, starts = task
    rng = np.random.default_rng([18, round(snr), seed])
    trial = draw_trial(rng, snr=snr)
    problem = replace(trial.problem, noise=recalibrated(trial.noise, rng))

    def all_tests(problem: Problem, state: State) -> list[float]:
        return [float(test(problem, state)) for test in TESTS.values()]

    state = maximize(problem, trial.state(trial.waves)).state
    right, seconds = [], []
    for test in TESTS.values():
        began = perf_counter()
        right.append(float(test(problem, state)))
        seconds.append(perf_counter() - began)
    drawn = bootstrap(problem, state, all_tests, rng, 1)[0].tolist()
    for _ in range(starts):
        end = maximize(
            problem, trial.state(random_waves(rng, len(trial.noll), 0.2)), max_steps=40
        )
        if np.linalg.norm(trial.error(end.state.waves)) > WRONG:
            return Answer(right, drawn, all_tests(problem, end.state), seconds)
    return Answer(right, drawn, None, seconds)


def table(answers: list[Answer]) -> str:
    """False alarms by the tests' fast forms and by the pooled bootstrap, wrong optima rejected, and the areas under the ROC."""
    right, drawn = (
        np.array([getattr(a, name) for a in answers]) for name in ("right", "drawn")
    )
    wrong = np.array([a.wrong for a in answers if a.wrong is not None]).reshape(
        -1, len(TESTS)
    )
    seconds = np.median([a.seconds for a in answers], axis=0)
    ranked = np.array([[rank(p, drawn[:, k]) for k, p in enumerate(row)] for row in right])
    error = [100 * np.sqrt(level * (1 - level) / len(right)) for level in (0.01, 0.05)]
    lines = [
        f"{len(right)} right optima, {len(wrong)} wrong ones; sampling error of the nominal rates: "
        f"{error[0]:.1f} % at 1 %, {error[1]:.1f} % at 5 %, by bootstrap as much again",
        "| test | false alarms at 1 % | at 5 % | by bootstrap at 1 % | at 5 % | wrong rejected at 1 % | at 0.1 % | ROC | ms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for k, name in enumerate(TESTS):
        alarms = [
            np.mean(p[:, k] <= level) for p in (right, ranked) for level in (0.01, 0.05)
        ]
        caught = [
            np.mean(wrong[:, k] <= level) for level in (0.01, SETTINGS.contradiction_chance)
        ]
        cells = [f"{share:.1%}" for share in (*alarms, *caught)]
        cells += [f"{area(-right[:, k], -wrong[:, k]):.4f}", f"{1e3 * seconds[k]:.0f}"]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def rank(p_value: float, drawn: Floats) -> float:
    """Of a p-value among those drawn at right optima: its bootstrapped p-value."""
    return float((1 + np.sum(drawn <= p_value)) / (1 + drawn.size))


def main() -> None:
    """Trials that an earlier run has left in the file are not run again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument(
        "--wrong",
        type=int,
        default=200,
        help="trials in which a wrong optimum is looked for",
    )
    parser.add_argument("--snr", type=float, nargs="+", default=[50.0, 75.0])
    parser.add_argument("--workers", type=int, default=default_workers())
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("build/local_tests.jsonl"),
        help="where trials are kept",
    )
    arguments = parser.parse_args()
    kept: dict[tuple[float, int, int], Answer] = {}
    arguments.keep.parent.mkdir(parents=True, exist_ok=True)
    with arguments.keep.open("a+") as file:
        file.seek(0)
        kept = {tuple(task): Answer(**answer) for task, answer in map(json.loads, file)}
        for snr in arguments.snr:
            tasks = [
                (snr, seed, STARTS if seed < arguments.wrong else 0)
                for seed in range(arguments.trials)
            ]
            left = [task for task in tasks if task not in kept]
            for index, answer in run_all(work, left, arguments.workers):
                kept[left[index]] = answer
                print(json.dumps([left[index], asdict(answer)]), file=file, flush=True)
            print(f"SNR {snr:g}: {table([kept[task] for task in tasks])}", flush=True)


if __name__ == "__main__":
    main()
