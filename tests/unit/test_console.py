"""What the terminal shows while work goes on, and what is said where there is none."""

from __future__ import annotations

import ast
import json
import re
import threading
from pathlib import Path

import pytest

from labkit.acquisition.log import CaptureLog
from labkit.cli import console as console_module
from labkit.cli.console import Console
from labkit.jobs.pace import PAUSED, Work


def test_without_a_terminal_a_line_says_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console_module, "EVERY_S", 0.05)
    with Console().progress("fitting") as report:
        report(0, 15, "searching from nothing: G at 3000 mm\x1b")
        threading.Event().wait(0.5)
    first, *_ = capsys.readouterr().err.splitlines()
    assert (
        first
        == "labkit: fitting 0/15, 1 s so far, time left not known yet: searching from nothing: G at 3000 mm\\x1b"
    )


def test_on_a_terminal_of_80_columns_progress_keeps_to_two_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with Console().progress("capturing") as report:
        report(2, 22, "taking preflight_3300_target, " + "and more, " * 20)
        threading.Event().wait(0.3)
    frames = re.sub(r"\x1b\[[0-9;]*[mK]", "", capsys.readouterr().err).split("\x1b")
    lines = [frame for frame in frames if "preflight" in frame][-1].strip().split("\n")
    assert [len(line.rstrip("\r")) <= 80 for line in lines] == [True, True]
    assert lines[0].endswith("so far, time left not known yet")
    assert lines[1].rstrip().endswith("…")


def test_a_quiet_console_and_a_short_work_say_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Console().progress("fitting") as report:
        report(0, 15, "a")
    monkeypatch.setattr(console_module, "EVERY_S", 0.01)
    with Console(quiet=True).progress("fitting") as report:
        report(0, 15, "a")
        threading.Event().wait(0.2)
    assert capsys.readouterr().err == ""


def test_time_left_cannot_be_taken_for_the_time_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [0.0]
    monkeypatch.setattr("labkit.jobs.pace.time.monotonic", lambda: clock[0])
    work = Work("capturing")
    work.report(0, 13, "homing the rail")
    clock[0] = 15.0
    assert work.times() == "15 s so far, time left not known yet"
    work.report(1, 13, "a")
    assert work.times() == "15 s so far, about 3 min left"
    clock[0] = 600.0
    assert (
        work.times() == "10 min so far, about 2 min 45 s left"
    )  # eleven steps more after this one
    work.report(13, 13, "z")
    assert work.times() == "10 min so far"


def test_an_expected_time_is_counted_down_until_steps_show_a_pace(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [0.0]
    monkeypatch.setattr("labkit.jobs.pace.time.monotonic", lambda: clock[0])
    work = Work("fitting", expected_s=180.0)
    work.report(0, 0, "searching from nothing")
    clock[0] = 10.0
    usual = "the 3 min that earlier ones took here"
    assert work.times() == f"10 s so far, about 2 min 50 s left of {usual}"
    clock[0] = 240.0
    assert work.times() == f"4 min so far, more than {usual}"
    work.report(0, 12, "fitting")
    clock[0] = 250.0
    work.report(1, 12, "fitting")
    assert work.times() == "4 min 10 s so far, about 1 min 50 s left"


class Page:
    """An observer that holds, as the operator's page does after a press of its button."""

    holds = True

    def noted(self, event: str, **fields: object) -> None:
        """Nothing to do."""

    def may_go_on(self) -> None:
        self.holds = False


def test_a_pause_on_the_page_is_seen_in_the_terminal() -> None:
    said: list[str] = []
    log = CaptureLog(None, [Page()], lambda done, of, what: said.append(what), 3, 13)  # type: ignore[arg-type,list-item]
    log.step("taking flat_0")
    log.step("taking flat_1")
    assert said == ["taking flat_0", PAUSED, "taking flat_0", "taking flat_1"]


def test_a_pause_does_not_count_as_work(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("labkit.jobs.pace.time.monotonic", lambda: clock[0])
    work = Work("capturing")
    work.report(0, 3, "a")
    clock[0] = 10.0
    work.report(1, 3, "b")
    work.report(1, 3, PAUSED)
    clock[0] = 1000.0
    assert work.times() == "17 min so far"
    work.report(1, 3, "b")
    assert work.times() == "17 min so far, about 20 s left"


ODD = "a\x1b[31m\x9b2J\r\n\u202egnp.\u2066\udcff\x7f"
ESCAPED = r"a\x1b[31m\x9b2J\r\n\u202egnp.\u2066\udcff\x7f"


def test_whatever_is_printed_is_printable(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    console.say(ODD)
    console.table([["session"], [ODD]])
    console.warn(ODD)
    console.link("page", ODD)
    console_module.error_line(OSError(ODD.replace("\r\n", "")))
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [ESCAPED, "session", ESCAPED]
    assert printed.err.splitlines() == [
        f"labkit: warning: {ESCAPED}",
        f"page: {ESCAPED}",
        f"labkit: {ESCAPED}".replace(r"\r\n", ""),
    ]


def test_columns_are_as_wide_as_what_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    Console().table([["session", "lens"], ["\x1b", "+"], ["a long name", "-"]])
    first, second, third = capsys.readouterr().out.splitlines()
    assert first.index("lens") == second.index("+") == third.index("-")


def test_json_is_printable_and_reads_back_the_same(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Console(json=True).answer({ODD: [ODD, "ß", "\U0001f600", "\U000e0001"]})
    printed = capsys.readouterr().out
    assert all(line.isprintable() for line in printed.splitlines())
    assert json.loads(printed) == {ODD: [ODD, "ß", "\U0001f600", "\U000e0001"]}


def test_only_the_console_prints() -> None:
    """Names of folders and texts of files are made printable in one place."""
    labkit = Path(console_module.__file__).parents[1]
    printing = {
        str(path.relative_to(labkit))
        for path in labkit.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
    }
    assert printing == {
        "cli/__init__.py",  # one constant line
        "cli/console.py",
        "devices/operator.py",  # drivers know no command line
    }
