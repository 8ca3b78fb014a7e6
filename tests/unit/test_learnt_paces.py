"""How long work took on this machine: a small file that is never needed."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from labkit.analysis.fit_size import USUAL_S
from labkit.cli.sessions import _Timed
from labkit.jobs.learnt_paces import MOST_LEARNT, MOST_STORE_BYTES, Paces
from labkit.jobs.pace import EARLIER, RULE


@pytest.fixture
def paces(tmp_path: Path) -> Paces:
    return Paces(tmp_path / "state" / "paces.json")


def test_nothing_is_expected_before_anything_was_learnt(paces: Paces) -> None:
    assert paces.expected_s("fit", 100.0) is None
    assert Paces(None).expected_s("fit", 100.0) is None


def test_work_takes_as_long_as_earlier_work_of_its_kind_and_size(paces: Paces) -> None:
    for seconds in (9.0, 10.0, 500.0):
        paces.learn("fit", 100.0, seconds)
    paces.learn("fit", 1000.0, 50.0)
    paces.learn("chart", 100.0, 3.0)
    assert paces.expected_s("fit", 200.0) == 20.0
    assert paces.expected_s("fit", 2000.0) == 100.0
    # none was alike: the median of all, 0.05, 0.09, 0.1 and 5 s
    assert paces.expected_s("fit", 100_000.0) == pytest.approx(9500.0)


def test_few_are_kept(paces: Paces) -> None:
    for k in range(3 * MOST_LEARNT):
        paces.learn("fit", 1.0, 1.0 + k)
    assert paces.file is not None
    assert len(json.loads(paces.file.read_text())["fit"]) == MOST_LEARNT


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[1, 2]",
        b'{"fit": 3}',
        b'{"fit": [[1]]}',
        b'{"fit": [[1, "2"]]}',
        b'{"fit": [[1, NaN]]}',
        b'{"fit": [[1, 1e999]]}',
        b'{"fit": [[0, 1]]}',
        b'{"fit": [[true, 1]]}',
        b"\xff\xfe",
        b"[" * 50_000,
        b'{"fit": [[1, 1]], "x": "' + b"x" * MOST_STORE_BYTES + b'"}',
    ],
    ids=lambda content: repr(content)[:30],
)
def test_a_store_that_is_odd_tells_nothing_and_is_replaced(
    paces: Paces, content: bytes
) -> None:
    assert paces.file is not None
    paces.file.parent.mkdir()
    paces.file.write_bytes(content)
    assert paces.expected_s("fit", 1.0) is None
    paces.learn("fit", 1.0, 5.0)
    assert paces.expected_s("fit", 1.0) == 5.0


def test_a_pipe_or_a_folder_in_place_of_the_store_is_never_waited_for(paces: Paces) -> None:
    assert paces.file is not None
    paces.file.parent.mkdir()
    os.mkfifo(paces.file)
    assert paces.expected_s("fit", 1.0) is None
    paces.file.unlink()
    paces.file.mkdir()
    paces.learn("fit", 1.0, 5.0)
    assert paces.expected_s("fit", 1.0) is None


def test_a_folder_that_cannot_be_made_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file")
    paces = Paces(tmp_path / "state" / "paces.json")
    paces.learn("fit", 1.0, 5.0)
    assert paces.expected_s("fit", 1.0) is None
    assert (tmp_path / "state").read_text() == "a file"


def test_a_fit_is_expected_to_take_what_most_take_until_one_was_timed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    clock = [100.0]
    monkeypatch.setattr("labkit.cli.sessions.time.monotonic", lambda: clock[0])
    assert _Timed(0.0, True, 0.0).expected == (None, EARLIER)
    assert _Timed(10.0, True, 0.0).expected == (10 * USUAL_S, RULE)
    _Timed(10.0, False, 0.0).learn()  # went on where another one was interrupted
    assert _Timed(10.0, True, 0.0).expected == (10 * USUAL_S, RULE)
    _Timed(10.0, True, 0.0).learn()
    assert _Timed(20.0, True, 0.0).expected == (200.0, EARLIER)
