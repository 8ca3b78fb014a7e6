"""How well tests tell global from local optima at the conditions of thesis §3.8: `python -m benchmarks.local_tests`."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from labkit.execute import default_workers, run_all
from labkit.inference.localmin import embedding, one_sided, recalibrated, shipped_relaxation, two_sided
from labkit.inference.solve import State, climb
from labkit.inference.verdict import judge
from labkit.study.conditions import draw_trial, random_waves
from labkit.study.roc import area

DEGREES = (1, 4, 16)
CLIMBS = 6
NAMES = ("Biernacki, two-sided", "one-sided", *(f"embedding, {k} degrees" for k in DEGREES), "residuals (in use)")


@dataclass(frozen=True)
class Answer:
    """p-values in the order of NAMES at the right optimum, and at a wrong one where a climb ended in one; seconds of each."""

    right: tuple[float, ...]
    wrong: tuple[float, ...] | None
    seconds: tuple[float, ...]


def work(task: tuple[float, int, int]) -> Answer:
    """One picture: the optimum beside the truth, and the first wrong one of some climbs from random starts."""
    snr, seed, climbs = task
    rng = np.random.default_rng([17, round(snr), seed])
    trial = draw_trial(rng, snr=snr)
    problem = replace(trial.problem, noise=recalibrated(trial.noise, rng))
    seconds: list[float] = []

    def embedded(state: State, degrees: int) -> float:
        return embedding(problem, state, shipped_relaxation(degrees)).p_value

    def all_tests(state: State) -> tuple[float, ...]:
        tests: list[Callable[[], float]] = [
            lambda: two_sided(problem, state).p_value,
            lambda: one_sided(problem, state).p_value,
            *(partial(embedded, state, k) for k in DEGREES),
            lambda: judge(problem, state, problem.relative(state), model_error=0.0).p_value,
        ]
        values = []
        for test in tests:
            began = perf_counter()
            values.append(float(test()))
            seconds.append(perf_counter() - began)
        return tuple(values)

    right = all_tests(climb(problem, trial.state(trial.waves)).state)
    for _ in range(climbs):
        found = climb(problem, trial.state(random_waves(rng, len(trial.noll), 0.2)), max_steps=40)
        if np.linalg.norm(trial.error(found.state.waves)) > 0.03:
            return Answer(right, all_tests(found.state), tuple(seconds[-len(NAMES) :]))
    return Answer(right, None, tuple(seconds))


def main() -> None:
    """False alarms at 1 % and 5 %, and wrong optima rejected at 1 %."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--wrong", type=int, default=200, help="trials in which a wrong optimum is looked for")
    parser.add_argument("--snr", type=float, nargs="+", default=[50.0, 75.0])
    parser.add_argument("--workers", type=int, default=default_workers())
    asked = parser.parse_args()
    for snr in asked.snr:
        tasks = [(snr, seed, CLIMBS if seed < asked.wrong else 0) for seed in range(asked.trials)]
        answers = [answer for _, answer in run_all(work, tasks, asked.workers)]
        right = np.array([a.right for a in answers])
        wrong = np.array([a.wrong for a in answers if a.wrong is not None])
        seconds = np.median([a.seconds for a in answers], axis=0)
        print(f"SNR {snr:g}: {len(right)} right optima, {len(wrong)} wrong ones", flush=True)
        for k, name in enumerate(NAMES):
            at = [np.mean(right[:, k] < level) for level in (0.01, 0.05)]
            caught = np.mean(wrong[:, k] < 0.01)
            print(
                f"  {name:24s} false alarms {at[0]:6.1%} at 1 %, {at[1]:6.1%} at 5 %; "
                f"wrong optima rejected {caught:6.1%}; area under the ROC {area(-right[:, k], -wrong[:, k]):.4f}; "
                f"{seconds[k]:.3f} s"
            )


if __name__ == "__main__":
    main()
