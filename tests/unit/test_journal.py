"""The journal: every line that is damaged, missing, doubled or out of order is noticed."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from labkit.errors import InputError, SessionError
from labkit.session.session import Session
from labkit.session.verify import remarks, verify
from tests.plans import PORTRAIT, plan_text

Lines = list[str]

FRAME = {"event": "frame", "time": "now", "file": "a.dng", "kind": "dark", "range_mm": None, "sha256": "0"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A session of three photographs: seven lines, each photograph's "adding" before its "frame"."""
    photo = tmp_path / "photo.dng"
    with Session.create(tmp_path / "session", plan_text(PORTRAIT), tmp_path) as session:
        for number in range(3):
            photo.write_bytes(bytes([number]) * 100)
            session.add_frame(photo, f"dark_{number}.dng", "dark", None)
    return tmp_path / "session"


def change(folder: Path, alter: Callable[[Lines], Lines]) -> None:
    journal = folder / "journal.jsonl"
    journal.write_text("".join(alter(journal.read_text().splitlines(keepends=True))))


def by_itself(event: dict[str, Any]) -> str:
    """A line with a checksum of its own alone, as labkit wrote them before it chained them."""
    rest = json.dumps({key: event[key] for key in event if key not in ("check", "after")}, sort_keys=True)
    return (
        json.dumps({**json.loads(rest), "check": hashlib.sha256(rest.encode()).hexdigest()[:16]}, sort_keys=True) + "\n"
    )


def unchained(lines: Lines) -> Lines:
    return [by_itself(json.loads(line)) for line in lines]


@pytest.mark.parametrize(
    ("alter", "number"),
    [
        (lambda lines: lines[1:], 1),
        (lambda lines: lines[:2] + lines[3:], 3),
        (lambda lines: [*lines[:5], lines[4], *lines[5:]], 6),
        (lambda lines: [*lines, lines[-1]], 8),
        (lambda lines: [*lines[:3], lines[4], lines[3], *lines[5:]], 4),
        (lambda lines: [*lines[:5], lines[6], lines[5]], 6),
        (lambda lines: lines + lines, 8),
    ],
    ids=["first dropped", "dropped", "doubled", "last doubled", "swapped", "last swapped", "all doubled"],
)
def test_lines_that_are_missing_doubled_or_moved_are_noticed(
    folder: Path, alter: Callable[[Lines], Lines], number: int
) -> None:
    change(folder, alter)
    for way in (Session.open, Session.append):
        with pytest.raises(SessionError, match=f"line {number} does not follow the one before"):
            way(folder)


@pytest.mark.parametrize("old", ['"dark_1', '"event": ', '", "file"'])
def test_a_line_that_is_altered_in_the_middle_is_named(folder: Path, old: str) -> None:
    change(folder, lambda lines: [*lines[:3], lines[3].replace(old, f" {old}", 1), *lines[4:]])
    with pytest.raises(SessionError, match="line 4 does not fit its checksum"):
        Session.open(folder)


def test_a_tail_that_is_cut_off_shows_in_the_photographs_that_the_journal_lacks(folder: Path) -> None:
    change(folder, lambda lines: lines[:-1])
    assert "dark_2.dng was being added" in remarks(Session.open(folder))[0]
    change(folder, lambda lines: lines[:-1])
    assert verify(Session.open(folder)) == [f"{folder / 'frames' / 'dark_2.dng'}: not in the journal"]


def test_an_unchained_journal_reads_as_before_with_a_remark(folder: Path) -> None:
    frames = Session.open(folder).frames
    change(folder, unchained)
    session = Session.open(folder)
    assert session.frames == frames
    assert verify(session) == []
    assert "its first 7 lines were written by an earlier labkit" in remarks(session)[0]


def test_a_journal_that_began_unchained_goes_on_chained(folder: Path) -> None:
    change(folder, unchained)
    with Session.append(folder) as session:
        session.log("moved", range_mm=2000.0)
        session.log("moved", range_mm=2100.0)
    session = Session.open(folder)
    assert session.unchained == 7
    assert [event["event"] for event in session.events[-2:]] == ["moved", "moved"]
    whole = (folder / "journal.jsonl").read_text()
    for gone in (6, 7):  # the last of the old lines is tied to the first of the new ones
        change(folder, lambda lines: lines[:gone] + lines[gone + 1 :])  # noqa: B023
        with pytest.raises(SessionError, match=f"line {gone + 1} does not follow"):
            Session.open(folder)
        (folder / "journal.jsonl").write_text(whole)
    change(folder, lambda lines: [*lines, *unchained(lines[-1:])])
    with pytest.raises(SessionError, match="line 10 does not follow"):
        Session.open(folder)


@pytest.mark.parametrize(
    "line",
    [
        '{"check": "0", "event": "x", "time": NaN}',
        '{"check": "0", "event": "x", "time": -Infinity}',
        '{"check": "0", "event": "x", "time": 1e999}',
        '{"check": "0", "event": "x", "time": "\\ud800"}',
        '{"check": "0", "event": "x", "time": ' + "[" * 100_000 + "]" * 100_000 + "}",
        '{"check": "0", "event": "x", "time": ' + "9" * 5000 + "}",
        "[1, 2]",
        "",
        "\N{BYTE ORDER MARK}{}",
    ],
    ids=["nan", "infinity", "overflow", "surrogate", "nesting", "digits", "list", "empty", "mark"],
)
def test_what_is_no_line_of_a_journal_is_named_in_a_line(folder: Path, line: str) -> None:
    change(folder, lambda lines: [*lines[:3], line + "\n", *lines[3:]])
    with pytest.raises(SessionError, match="line 4 does not fit its checksum"):
        Session.open(folder)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"file": None}, '"frame" with file = None'),
        ({"file": "../../etc/passwd"}, '"frame" with file = '),
        ({"kind": "picture"}, "\"frame\" with kind = 'picture'"),
        ({"kind": ["dark"]}, '"frame" with kind = '),
        ({"range_mm": "near"}, '"frame" with range_mm = '),
        ({"exposure_s": "long"}, '"frame" with exposure_s = '),
        ({"measured_range_mm": []}, '"frame" with measured_range_mm = '),
        ({"sha256": 1}, '"frame" with sha256 = 1'),
    ],
)
def test_an_event_that_cannot_be_is_named_though_its_checksum_fits(
    folder: Path, wrong: dict[str, Any], words: str
) -> None:
    change(folder, lambda lines: [*unchained(lines), by_itself({**FRAME, **wrong})])
    with pytest.raises(SessionError) as caught:
        Session.open(folder)
    assert f"line 8 cannot be used: it is {words}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["time", "file", "kind", "range_mm", "sha256"])
def test_an_event_that_lacks_something_is_named(folder: Path, key: str) -> None:
    lacking = {name: value for name, value in FRAME.items() if name != key}
    change(folder, lambda lines: [*unchained(lines), by_itself(lacking)])
    with pytest.raises(SessionError, match=f'line 8 cannot be used: it is "frame" without {key}'):
        Session.open(folder)


@pytest.mark.parametrize("name", ["check", "after", "time"])
def test_an_event_may_not_use_the_journals_own_fields(folder: Path, name: str) -> None:
    with Session.append(folder) as session, pytest.raises(ValueError, match="the journal itself uses"):
        session.log("moved", **{name: "x"})


@pytest.mark.parametrize("stop", [KeyboardInterrupt, OSError(5, "Input/output error")], ids=["Ctrl-C", "disk"])
def test_the_chain_goes_on_after_a_line_that_was_written_but_not_synced(
    folder: Path, stop: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Session.append(folder) as session:
        with monkeypatch.context() as stopped:
            stopped.setattr(os, "fsync", Mock(side_effect=stop))
            with pytest.raises((KeyboardInterrupt, InputError)):
                session.log("moved", range_mm=2000.0)
        session.log("interrupted")
    assert [event["event"] for event in Session.open(folder).events[-2:]] == ["moved", "interrupted"]
    assert verify(Session.open(folder)) == []


def test_a_journal_that_cannot_be_written_is_named_where_the_session_is_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Session.create(tmp_path / "new", plan_text(PORTRAIT), tmp_path) as session:
        with monkeypatch.context() as stopped:
            stopped.setattr(os, "fsync", Mock(side_effect=OSError(28, "No space left on device")))
            with pytest.raises(InputError, match=r"cannot write .*/new/journal\.jsonl: No space left"):
                session.log("moved")
        session.log("moved")
    assert len(Session.open(tmp_path / "new").events) == 3
