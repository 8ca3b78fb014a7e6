"""What passed before is not run again, unless the code that it depends on says something else."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests import accuracy

TEST = "tests/system/test_golden.py::test_noise_is_right[golden_bench]"


@pytest.fixture(autouse=True)
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(accuracy, "RECORD", tmp_path / "accuracy.json")
    monkeypatch.setattr(accuracy, "digest", lambda file: f"of {file.name}")
    return tmp_path / "accuracy.json"


def report(outcome: str) -> pytest.TestReport:
    return pytest.TestReport(TEST, ("", 0, ""), {}, cast(Any, outcome), None, "call")


def left(*tests: str) -> list[str]:
    """Tests of these that are still to run."""
    items: list[Any] = [
        SimpleNamespace(nodeid=test, path=Path(test.partition("::")[0])) for test in tests
    ]
    config: Any = SimpleNamespace(
        hook=SimpleNamespace(pytest_deselected=lambda items: None)
    )
    accuracy.pytest_collection_modifyitems(config, items)
    return [item.nodeid for item in items]


def ended(*outcomes: str) -> int:
    """Hear of a test's outcomes, and return the status that the run leaves with when none was left to run."""
    recorder = accuracy.Recorder()
    session = SimpleNamespace(exitstatus=5)
    for outcome in outcomes:
        recorder.pytest_runtest_logreport(report(outcome))
    recorder.pytest_sessionfinish(cast(Any, session), session.exitstatus)
    return int(session.exitstatus)


def test_what_passed_is_not_run_again_and_what_failed_is() -> None:
    assert ended() == 5  # nothing ran, nothing stands in the record: no success
    assert left(TEST) == [TEST]
    assert ended("passed") == 0
    assert left(TEST, "tests/system/other.py::test") == ["tests/system/other.py::test"]
    ended("failed")
    assert left(TEST) == [TEST]


def test_what_passed_with_other_code_is_run_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ended("passed")
    monkeypatch.setattr(accuracy, "digest", lambda file: "of other code")
    assert left(TEST) == [TEST]


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ('"""Other words."""\nx = 1  # and a comment\n', True),
        ("x = 2\n", False),
        ('def f():\n    """Return nothing."""\nx = 1\n', False),
    ],
)
def test_comments_and_docstrings_change_no_number(
    text: str, same: bool, tmp_path: Path
) -> None:
    ours, theirs = tmp_path / "a.py", tmp_path / "b.py"
    ours.write_text("x = 1\n")
    theirs.write_text(text)
    assert (accuracy._meaning(ours) == accuracy._meaning(theirs)) is same


def test_the_estimates_source_is_among_what_numbers_depend_on() -> None:
    found = {path.relative_to(accuracy.ROOT).parts[:2] for path in accuracy._sources()}
    rooms = {"/".join(parts) for parts in found}
    assert {"labkit/estimation", "labkit/field", "drivers/simulated"} <= rooms
    assert {"targets/sierpinski.py", "benchmarks/claims.py", "tests/dng.py"} <= rooms
    assert not rooms & {"labkit/cli", "labkit/report", "labkit/edges"}
