"""Fits kept as they end: what was made is not made again, what is altered or meant to do harm is."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.analysis.kept_fits import SIGNATURE_BYTES, KeptFits
from labkit.estimation.residuals import Verdict
from labkit.storage import typed_file

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


def counted(task: Any) -> int:
    return len(task)


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
    list(kept(counted, [("a", 1.0)]))
    assert run.asked == [("a", 1.0), ("a", np.nextafter(1.0, 2)), ("a", 1.0)]


def altered(content: bytes) -> bytes:
    """A fit with another verdict, in a file that is whole."""
    forged = replace(judged("a"), p_value=0.9)
    return content[:SIGNATURE_BYTES] + typed_file.dump(forged, Verdict)


def signed_by_anybody(content: bytes) -> bytes:
    body = altered(content)[SIGNATURE_BYTES:]
    return hashlib.sha256(body).digest() + body


class Harmful:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("harm"),)


@pytest.mark.parametrize(
    "forge",
    [
        lambda content: content[:-5],
        lambda _: b"",
        lambda _: pickle.dumps(Harmful()),
        altered,
        signed_by_anybody,
    ],
)
def test_what_somebody_put_there_is_not_used_and_the_findings_say_so(
    run: Played,
    tmp_path: Path,
    forge: Callable[[bytes], bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    list(KeptFits(run, tmp_path / "f")(judged, ["a"]))
    (file,) = (tmp_path / "f").iterdir()
    file.write_bytes(forge(file.read_bytes()))
    kept = KeptFits(run, tmp_path / "f")
    assert list(kept(judged, ["a"])) == [(0, judged("a"))]
    assert run.asked == ["a", "a"]
    assert [finding.code for finding in kept.findings] == ["kept-fits-refused"]
    assert not (tmp_path / "harm").exists()


def test_a_fit_is_not_taken_for_that_of_another_task(run: Played, tmp_path: Path) -> None:
    list(KeptFits(run, tmp_path)(judged, ["a", "bb"]))
    first, second = tmp_path.iterdir()
    first.write_bytes(second.read_bytes())
    list(KeptFits(run, tmp_path)(judged, ["a", "bb"]))
    assert len(run.asked) == 3


def test_fits_of_another_user_are_made_again(
    run: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for user in ("one", "other"):
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / user))
        list(KeptFits(run, tmp_path / "f")(judged, ["a"]))
    assert run.asked == ["a", "a"]


def test_a_link_to_another_folder_is_replaced(run: Played, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "f").symlink_to(tmp_path / "elsewhere")
    list(KeptFits(run, tmp_path / "f")(judged, ["a"]))
    assert not list((tmp_path / "elsewhere").iterdir())
    assert len(list((tmp_path / "f").iterdir())) == 1


def test_a_folder_that_cannot_be_written_to_costs_no_fit(
    run: Played, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    kept = KeptFits(run, tmp_path / "file" / "f")
    assert list(kept(judged, ["a"])) == [(0, judged("a"))]
    assert kept.problem is not None
    assert "cannot write" in kept.problem
