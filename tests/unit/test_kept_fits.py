"""Fits kept as they end: what was made is not made again, what is altered or meant to do harm is."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.estimation.residual_tests import Verdict
from labkit.kept_fits import KeptFits

HALF = np.arange(8.0)[::2]


@dataclass
class Played:
    """A run that notes what it was asked to do."""

    asked: list[Any] = field(default_factory=list)

    def __call__(
        self, function: Callable[[Any], Any], tasks: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        self.asked += tasks
        for index in reversed(range(len(tasks))):
            yield index, function(tasks[index])


def judged(task: Any) -> Verdict:
    return Verdict(float(len(task[0])), True, 0.0, 0.0)


@pytest.fixture
def run() -> Played:
    return Played()


def test_what_is_kept_is_not_made_again(run: Played, tmp_path: Path) -> None:
    tasks = [("a", HALF), ("bb", HALF), ("ccc", HALF)]
    assert list(KeptFits(run, tmp_path / "f")(judged, tasks[1:2])) == [
        (0, judged(tasks[1]))
    ]
    again = [
        (name, np.array(values)) for name, values in tasks
    ]  # equal, but lying otherwise in memory
    assert [(k, v.p_value) for k, v in KeptFits(run, tmp_path / "f")(judged, again)] == [
        (1, 2.0),
        (2, 3.0),
        (0, 1.0),
    ]
    assert [name for name, _ in run.asked] == ["bb", "a", "ccc"]


def test_another_task_or_function_is_not_taken_for_it(run: Played, tmp_path: Path) -> None:
    kept = KeptFits(run, tmp_path)
    list(kept(judged, [("a", 1.0)]))
    list(kept(judged, [("a", 1.0 + 1e-16), ("a", np.nextafter(1.0, 2))]))
    list(kept(pickle.dumps, [("a", 1.0)]))
    assert run.asked == [("a", 1.0), ("a", np.nextafter(1.0, 2)), ("a", 1.0)]


def test_a_damaged_one_is_made_again(run: Played, tmp_path: Path) -> None:
    list(KeptFits(run, tmp_path)(judged, ["a"]))
    (kept,) = tmp_path.iterdir()
    kept.write_bytes(kept.read_bytes()[:-5])
    assert list(KeptFits(run, tmp_path)(judged, ["a"])) == [(0, judged("a"))]
    assert run.asked == ["a", "a"]


class Harmful:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("harm"),)


def test_what_somebody_put_there_runs_nothing(
    run: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    list(KeptFits(run, tmp_path / "f")(judged, ["a"]))
    (kept,) = (tmp_path / "f").iterdir()
    kept.write_bytes(pickle.dumps(Harmful()))
    list(KeptFits(run, tmp_path / "f")(judged, ["a"]))
    assert not (tmp_path / "harm").exists()
    assert run.asked == ["a", "a"]


def test_a_folder_that_cannot_be_written_to_costs_no_fit(
    run: Played, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    kept = KeptFits(run, tmp_path / "file" / "f")
    assert list(kept(judged, ["a"])) == [(0, judged("a"))]
    assert kept.problem is not None
    assert "cannot write" in kept.problem
