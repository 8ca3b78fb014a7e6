"""Runs the thesis's experiments: each ends in a few claims beside the thesis's, a table and a figure."""

import csv
import importlib
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from labkit.errors import InputError
from labkit.experiments.studies import STUDIES
from labkit.figure_style import png, styled
from labkit.jobs.execute import default_workers, run_all
from labkit.jobs.threads import one_thread
from labkit.storage.files import write_atomically
from labkit.types import Progress, no_progress

Task = TypeVar("Task")
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Claim:
    """One figure. thesis: its value in the thesis, None if absent; n: trials."""

    what: str
    thesis: float | None
    measured: float
    unit: str
    n: int


@dataclass(frozen=True)
class Setting:
    """Settings of a study. quick: few trials, a minute at most; workers: processes."""

    quick: bool
    workers: int
    progress: Progress = lambda done, total, step: None


@dataclass(frozen=True)
class Outcome:
    """claims; rows: of the table, all with the same keys; draw: makes the figure, under the house's style."""

    claims: Sequence[Claim]
    rows: Sequence[Mapping[str, Any]]
    draw: Callable[[], Figure]


def all_answers(
    setting: Setting,
    work: Callable[[Task], Answer],
    tasks: Sequence[Task],
    label: Callable[[Task], str],
) -> list[Answer]:
    """Return the answer to every task, in the tasks' order; progress names the last finished task."""
    answers: dict[int, Answer] = {}
    for index, answer in run_all(work, tasks, setting.workers):
        answers[index] = answer
        setting.progress(len(answers), len(tasks), label(tasks[index]))
    return [answers[index] for index in range(len(tasks))]


@one_thread
def run_study(
    name: str,
    *,
    quick: bool = False,
    folder: Path | str | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Run an experiment of the thesis.

    Parameters
    ----------
    name : of the study
    quick : whether to run a few trials only
    folder : where to write NAME.json, NAME.csv and NAME.png; None to write nothing
    workers : number of processes, by default one for each core
    progress : called as the work goes on

    Returns
    -------
    the study's claims, each with the thesis's value, as `labkit study` prints them

    Raises
    ------
    InputError
        there is no study of that name

    >>> labkit.run_study("crb", quick=True)["claims"]
    """
    if name not in STUDIES:
        raise InputError(f"no study {name!r}: there are {', '.join(STUDIES)}")
    setting = Setting(quick, workers or default_workers(), progress)
    folder = None if folder is None else Path(folder)
    began = perf_counter()
    outcome: Outcome = importlib.import_module(f"labkit.experiments.{STUDIES[name]}").run(
        setting
    )
    summary = {
        "schema": 1,
        "study": name,
        "quick": setting.quick,
        "seconds": round(perf_counter() - began, 1),
        "claims": [
            asdict(claim) | {"measured": _or_none(claim.measured)}
            for claim in outcome.claims
        ],
    }
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        table = io.StringIO()
        writer = csv.DictWriter(table, list(outcome.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(outcome.rows)
        with styled():
            figure = outcome.draw()
            _label_logs_plainly(figure)
        write_atomically(folder / f"{name}.csv", table.getvalue().encode())
        write_atomically(folder / f"{name}.png", png(figure))
        write_atomically(
            folder / f"{name}.json", json.dumps(summary, indent=1).encode() + b"\n"
        )
    return summary


def _label_logs_plainly(figure: Figure) -> None:
    """Label logarithmic axes with plain numbers: the report's style sets no formulas."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                low, high = axis.get_view_interval()
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter(
                    _twos_and_fives if high < 1000 * low else NullFormatter()
                )


def _twos_and_fives(value: float, _: object) -> str:
    return f"{value:g}" if f"{value:.0e}"[0] in "25" else ""


def _or_none(value: float) -> float | None:
    """Return a value, or None for NaN, which JSON lacks."""
    return value if math.isfinite(value) else None
