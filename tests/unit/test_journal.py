"""The journal: every line that is damaged, missing, doubled or out of order is noticed."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from labkit.errors import InputError, SessionError
from labkit.session.session import Session, begin
from labkit.session.verify import remarks, unused, verify
from tests.plans import PORTRAIT, plan_text

Lines = list[str]

FRAME = {
    "event": "frame",
    "time": "now",
    "file": "a.dng",
    "kind": "dark",
    "range_mm": None,
    "sha256": "0",
}


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
    rest = json.dumps(
        {key: event[key] for key in event if key not in ("check", "after")}, sort_keys=True
    )
    return (
        json.dumps(
            {**json.loads(rest), "check": hashlib.sha256(rest.encode()).hexdigest()[:16]},
            sort_keys=True,
        )
        + "\n"
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
    ids=[
        "first dropped",
        "dropped",
        "doubled",
        "last doubled",
        "swapped",
        "last swapped",
        "all doubled",
    ],
)
def test_lines_that_are_missing_doubled_or_moved_are_noticed(
    folder: Path, alter: Callable[[Lines], Lines], number: int
) -> None:
    change(folder, alter)
    for way in (Session.open, Session.append):
        with pytest.raises(
            SessionError, match=f"line {number} does not follow the one before"
        ):
            way(folder)


@pytest.mark.parametrize("old", ['"dark_1', '"event": ', '", "file"'])
def test_a_line_that_is_altered_in_the_middle_is_named(folder: Path, old: str) -> None:
    change(
        folder, lambda lines: [*lines[:3], lines[3].replace(old, f" {old}", 1), *lines[4:]]
    )
    with pytest.raises(SessionError, match="line 4 does not fit its checksum"):
        Session.open(folder)


def test_a_tail_that_is_cut_off_shows_in_the_photographs_that_the_journal_lacks(
    folder: Path,
) -> None:
    change(folder, lambda lines: lines[:-1])
    assert "dark_2.dng was being added" in remarks(Session.open(folder))[0]
    change(folder, lambda lines: lines[:-1])
    assert verify(Session.open(folder)) == [
        f"{folder / 'frames' / 'dark_2.dng'}: not in the journal"
    ]


@pytest.mark.parametrize("lines_lost", [1, 2])
def test_a_fit_says_which_photographs_it_does_not_use(
    folder: Path, lines_lost: int
) -> None:
    assert unused(Session.open(folder)) == []
    change(folder, lambda lines: lines[:-lines_lost])
    (finding,) = unused(Session.open(folder))
    assert finding.code == "photographs-unlisted"
    assert finding.warns
    assert "are not used, such as dark_2.dng" in finding.text


def test_a_photograph_that_another_process_adds_is_not_taken_for_a_stray(
    folder: Path,
) -> None:
    read_before = Session.open(folder)
    with Session.append(folder) as writer:
        (folder.parent / "late.dng").write_bytes(b"late")
        writer.add_frame(folder.parent / "late.dng", "late.dng", "dark", None)
        assert unused(read_before) == []


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
    ids=[
        "nan",
        "infinity",
        "overflow",
        "surrogate",
        "nesting",
        "digits",
        "list",
        "empty",
        "mark",
    ],
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
        ({"range_mm": 10**400}, '"frame" with range_mm = 1000'),
        ({"exposure_s": -(10**309)}, '"frame" with exposure_s = -1000'),
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
    with pytest.raises(
        SessionError, match=f'line 8 cannot be used: it is "frame" without {key}'
    ):
        Session.open(folder)


@pytest.mark.parametrize("name", ["check", "after", "time"])
def test_an_event_may_not_use_the_journals_own_fields(folder: Path, name: str) -> None:
    with (
        Session.append(folder) as session,
        pytest.raises(ValueError, match="the journal itself uses"),
    ):
        session.log("moved", **{name: "x"})


@pytest.mark.parametrize(
    "stop", [KeyboardInterrupt, OSError(5, "Input/output error")], ids=["Ctrl-C", "disk"]
)
def test_the_chain_goes_on_after_a_line_that_was_written_but_not_synced(
    folder: Path, stop: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Session.append(folder) as session:
        with monkeypatch.context() as stopped:
            stopped.setattr(os, "fsync", Mock(side_effect=stop))
            with pytest.raises((KeyboardInterrupt, InputError)):
                session.log("moved", range_mm=2000.0)
        session.log("interrupted")
    assert [event["event"] for event in Session.open(folder).events[-2:]] == [
        "moved",
        "interrupted",
    ]
    assert verify(Session.open(folder)) == []


def test_a_journal_that_cannot_be_written_is_named_where_the_session_is_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Session.create(tmp_path / "new", plan_text(PORTRAIT), tmp_path) as session:
        with monkeypatch.context() as stopped:
            stopped.setattr(
                os, "fsync", Mock(side_effect=OSError(28, "No space left on device"))
            )
            with pytest.raises(
                InputError, match=r"cannot write .*/new/journal\.jsonl: No space left"
            ):
                session.log("moved")
        session.log("moved")
    assert len(Session.open(tmp_path / "new").events) == 3


@pytest.mark.parametrize(
    ("strike", "words"),
    [
        (lambda journal: journal.unlink(), "was removed"),
        (lambda journal: journal.rename(journal.with_name("other")), "was removed"),
        (
            lambda journal: (
                journal.with_name("copy").write_bytes(b""),
                journal.with_name("copy").rename(journal),
            ),
            "was replaced",
        ),
    ],
    ids=["removed", "renamed", "replaced"],
)
def test_a_journal_that_is_taken_away_while_it_is_written_is_noticed_and_saved(
    folder: Path, strike: Callable[[Path], object], words: str, tmp_path: Path
) -> None:
    with Session.append(folder) as session:
        strike(folder / "journal.jsonl")
        with pytest.raises(
            SessionError,
            match=f"{words}.*rename .*journal.jsonl.saved to that, then go on with --resume",
        ):
            session.add_frame(tmp_path / "photo.dng", "dark_3.dng", "dark", None)
    (folder / "journal.jsonl.saved").rename(folder / "journal.jsonl")
    with Session.append(folder) as session:
        assert len(session.frames) == 3
    assert verify(Session.open(folder)) == []


def test_a_journal_whose_end_is_cut_off_while_it_is_written_is_noticed(
    folder: Path,
) -> None:
    with Session.append(folder) as session:
        change(folder, lambda lines: lines[:5])
        with pytest.raises(
            SessionError,
            match=r"was cut from .* bytes while it was being written: put back a whole copy",
        ):
            session.log("moved")


def test_a_journal_that_has_lost_its_end_says_how_to_go_on(
    folder: Path, tmp_path: Path
) -> None:
    change(folder, lambda lines: lines[:3])
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text(PORTRAIT))
    with pytest.raises(
        SessionError, match=r"2 photographs .*dark_1\.dng for one: it has lost lines"
    ) as caught:
        begin(plan, folder, resume=True)
    subprocess.run(str(caught.value).rpartition(": ")[2], shell=True, check=True)
    with begin(plan, folder, resume=True) as session:
        session.add_frame(tmp_path / "photo.dng", "dark_1.dng", "dark", None)
    assert len(Session.open(folder).frames) == 2


def test_a_photograph_whose_line_is_doubled_counts_once(folder: Path) -> None:
    change(folder, lambda lines: [*unchained(lines), *unchained(lines[-1:]) * 16])
    session = Session.open(folder)
    assert [frame.file for frame in session.frames] == [
        "dark_0.dng",
        "dark_1.dng",
        "dark_2.dng",
    ]
    assert len(session.warnings) == 16
    assert "line 8 is of dark_2.dng again, as line 7: it counts once" in session.warnings[0]
    assert verify(session) == list(session.warnings)


def test_lines_that_contradict_each_other_about_a_photograph_are_named(
    folder: Path,
) -> None:
    change(
        folder,
        lambda lines: [
            *unchained(lines),
            by_itself({**json.loads(lines[-1]), "kind": "bias"}),
        ],
    )
    with pytest.raises(
        SessionError, match=r"lines 7 and 8 contradict each other about dark_2\.dng"
    ):
        Session.open(folder)


CRASH = """
import os, sys
os.close(2)
from labkit.session.session import Session, begin
with Session.append(sys.argv[1]) as session:
    os.write(2, b"Segmentation fault\\n")
    session.log("moved")
"""


def test_what_is_printed_where_standard_error_is_closed_is_not_in_the_journal(
    folder: Path,
) -> None:
    subprocess.run([sys.executable, "-c", CRASH, str(folder)], check=True, timeout=60)
    assert Session.open(folder).events[-1]["event"] == "moved"


def test_a_file_system_without_locks_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fcntl.flock", Mock(side_effect=OSError(37, "No locks available")))
    with pytest.raises(
        InputError,
        match=r"cannot lock .*journal\.jsonl: No locks available; put the session on a disk",
    ):
        Session.append(folder)
    assert remarks(Session.open(folder)) == []
