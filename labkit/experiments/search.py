"""The global search against SNR, without prior knowledge: thesis Figure 4.16; and its limits."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.errors import LabkitError
from labkit.estimation.small_problem import PhaseRetrieval
from labkit.experiments.conditions import NOLL, WAVES_RMS, Trial, carpet, draw_trial, optics
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers

STARTS = 12  # single ones that are counted in each trial
SAME_END = 0.05  # waves RMS: ends nearer to one another are one
NOLL_22 = tuple(range(4, 26))


@dataclass(frozen=True)
class Condition:
    """A varied condition. trials: in the full study."""

    snr: float
    noll: tuple[int, ...] = NOLL
    waves_rms: float = WAVES_RMS
    trials: int = 40

    @property
    def label(self) -> str:
        return f"{len(self.noll)} modes, {self.waves_rms:g} waves, SNR {self.snr:g}"


CONDITIONS = (
    Condition(10.0, trials=30),
    Condition(25.0, trials=30),
    Condition(50.0, trials=200),
    Condition(75.0),
    *(Condition(75.0, waves_rms=waves_rms, trials=20) for waves_rms in (0.35, 0.5)),
    *(Condition(75.0, NOLL_22, waves_rms, trials=10) for waves_rms in (0.25, 0.35, 0.5)),
)
QUICK = (Condition(50.0, trials=1), Condition(75.0, waves_rms=0.35, trials=1))


@dataclass(frozen=True)
class Answer:
    """found: the true optimum; error, bound: waves RMS; lost: whether the target was not found.

    right_starts: share of single random starts, the pose known, with the same end as a
    start at the truth; small_error: of this end, waves RMS.
    """

    bound: float
    found: bool = False
    accepted: bool = False
    error: float = np.nan
    starts: int = 0
    seconds: float = np.nan
    right_starts: float = np.nan
    small_error: float = np.nan
    lost: bool = False


def work(task: tuple[Condition, int]) -> Answer:
    """Fit one image without prior knowledge."""
    condition, seed = task
    rng = np.random.default_rng(
        [seed, round(condition.snr), len(condition.noll), round(100 * condition.waves_rms)]
    )
    trial = draw_trial(
        rng, snr=condition.snr, noll=condition.noll, waves_rms=condition.waves_rms
    )
    try:
        fit = trial.fit(rng)
    except LabkitError:
        return Answer(trial.bound, lost=True)
    return Answer(
        trial.bound,
        trial.found(fit.best.waves),
        fit.best.verdict.accepted,
        float(np.linalg.norm(trial.error(fit.best.waves))),
        fit.starts,
        fit.seconds,
        *_single_starts(trial, rng),
    )


def _single_starts(trial: Trial, rng: np.random.Generator) -> tuple[float, float]:
    """Return the share of random starts of the small problem with the right end, and the error of this end."""
    here = trial.state(np.zeros(len(trial.noll)))
    small = PhaseRetrieval.prepare(
        optics(trial.noll), carpet(), trial.frame, trial.noise, here
    )
    right = trial.error(small.descend(trial.waves).state.waves)
    ends = [
        trial.error(small.descend(small.random_waves(rng)).state.waves)
        for _ in range(STARTS)
    ]
    return float(np.mean([np.linalg.norm(end - right) < SAME_END for end in ends])), float(
        np.linalg.norm(right)
    )


def run(setting: Setting) -> Outcome:
    """Measure how often the search reaches the true optimum, whether the tests agree, and the time."""
    conditions = QUICK if setting.quick else CONDITIONS
    tasks = [
        (condition, seed) for condition in conditions for seed in range(condition.trials)
    ]
    answers = all_answers(setting, work, tasks, lambda task: task[0].label)
    rows = list[dict[str, Any]]()
    claims = list[Claim]()
    for condition in conditions:
        row = _row(
            condition,
            [a for a, task in zip(answers, tasks, strict=True) if task[0] is condition],
        )
        rows.append(row)
        claims += _claims(condition.label, row)
    at = next(row for row in rows if row["snr"] == 50.0)
    n = at["trials"]
    claims += [
        Claim(
            "time of a global fit, 95th percentile, SNR 50", None, at["seconds_95"], "s", n
        ),
        Claim("true optima rejected, SNR 50", None, at["found_but_rejected"] / n, "", n),
        Claim(
            "wrong optima accepted, SNR 50", None, float(at["wrong_but_accepted"]), "", n
        ),
    ]
    return Outcome(claims, rows, lambda: draw(rows))


def _row(condition: Condition, answers: Sequence[Answer]) -> dict[str, Any]:
    """Return a row of the table: all trials under one condition."""
    found = [a for a in answers if a.found]
    wrong = [a for a in answers if not a.found and not a.lost]
    seconds = [a.seconds for a in answers if not a.lost]
    return {
        "modes": len(condition.noll),
        "waves_rms": condition.waves_rms,
        "snr": condition.snr,
        "trials": len(answers),
        "found": len(found) / len(answers),
        "target_not_found": sum(a.lost for a in answers),
        "missed_seeds": " ".join(
            str(seed) for seed, a in enumerate(answers) if not a.found
        ),
        "rms_error_when_found": _rms([a.error for a in found]),
        "rms_bound_when_found": _rms([a.bound for a in found]),
        "found_but_rejected": sum(not a.accepted for a in found),
        "wrong_but_accepted": sum(a.accepted for a in wrong),
        "right_starts": float(np.nanmean([a.right_starts for a in answers])),
        "median_error_of_small_problem": float(
            np.nanmedian([a.small_error for a in answers])
        ),
        "median_starts": float(np.median([a.starts for a in answers])),
        "median_seconds": float(np.median(seconds)) if seconds else np.nan,
        "seconds_95": float(np.quantile(seconds, 0.95)) if seconds else np.nan,
    }


def _claims(label: str, row: dict[str, Any]) -> list[Claim]:
    n = row["trials"]
    return [
        Claim(f"global optimum found from nothing, {label}", None, row["found"], "", n),
        Claim(
            f"time of a global fit, median, {label}", None, row["median_seconds"], "s", n
        ),
        Claim(
            f"random starts that end right, {label}",
            None,
            row["right_starts"],
            "",
            STARTS * n,
        ),
    ]


def draw(rows: list[dict[str, Any]]) -> Figure:
    """Plot errors beside their bounds, and the success with stronger wavefronts."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    twelve = [
        row for row in rows if row["modes"] == len(NOLL) and row["waves_rms"] == WAVES_RMS
    ]
    snr = [row["snr"] for row in twelve]
    left.loglog(
        snr,
        [row["rms_error_when_found"] for row in twelve],
        "o",
        label="RMS error, optimum found",
    )
    left.loglog(
        snr, [row["rms_bound_when_found"] for row in twelve], "-", label="Cramér-Rao bound"
    )
    left.set(xlabel="SNR", ylabel="waves RMS", title="From nothing, 0.25 waves, 12 modes")
    for row in twelve:
        left.annotate(
            f"{100 * row['found']:.3g} %",
            (row["snr"], row["rms_error_when_found"]),
            (4, 6),
            textcoords="offset points",
        )
    left.legend()
    for count, marker in ((12, "o-"), (22, "s-")):
        of_count = [row for row in rows if row["modes"] == count and row["snr"] == 75.0]
        waves = [r["waves_rms"] for r in of_count]
        (line,) = right.plot(
            waves,
            [100 * r["found"] for r in of_count],
            marker,
            label=f"{count} modes, found",
        )
        right.plot(
            waves,
            [100 * r["right_starts"] for r in of_count],
            marker[0] + ":",
            color=line.get_color(),
            label=f"{count} modes, of single starts",
        )
    right.set(
        xlabel="waves RMS",
        ylabel="in the right optimum / %",
        ylim=(0, 103),
        title="Stronger wavefronts, SNR 75",
    )
    right.legend()
    return figure


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
