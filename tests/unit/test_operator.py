"""Questions to a person at a real pseudo-terminal, on a page, or at both."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import pytest

from labkit.devices import operator
from labkit.devices.operator import Operator
from labkit.errors import DeviceError, DeviceTimeoutError

Type = Callable[[bytes], object]


@pytest.fixture
def nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard input is no terminal."""
    monkeypatch.setattr("sys.stdin", io.StringIO("100\n"))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Type]:
    """A pseudo-terminal as standard input; types into it, or hangs up for b""."""
    near, far = os.openpty()
    opened = [near]
    with os.fdopen(far, "r") as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        yield lambda data: os.write(near, data) if data else os.close(opened.pop())
    for one in opened:
        os.close(one)


def soon(act: Callable[[], object]) -> threading.Timer:
    """Do it a moment later, on another thread."""
    timer = threading.Timer(0.3, act)
    timer.daemon = True
    timer.start()
    return timer


class Reader:
    """A page that does something as soon as a question is open."""

    def __init__(
        self, operator: Operator, act: Callable[[int], object] = lambda number: None
    ) -> None:
        self._operator, self._act = operator, act
        self.aborts = False

    def wake(self) -> None:
        if self._operator.question is not None:
            self._act(self._operator.question.number)

    def refuse_abort(self) -> None:
        if self.aborts:
            raise KeyboardInterrupt


def test_who_asks_nobody_needs_no_terminal_driver() -> None:
    code = "import sys; sys.modules['termios'] = None; import labkit.cli.command_line, labkit.devices.registry; print('ready')"
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100
    )
    assert (ran.stdout, ran.stderr) == ("ready\n", "")


def test_without_terminal_or_page_there_is_nobody_to_ask(nobody: None) -> None:
    operator = Operator()
    assert not operator.present
    with pytest.raises(
        DeviceError,
        match=r"someone is needed here \(Set it\): run this at a terminal, or with --monitor",
    ):
        operator.ask("Set it")


def test_a_program_without_standard_input_has_no_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sys.stdin", None)
    assert not Operator().present


def test_a_person_at_the_terminal_is_asked_and_heard(
    terminal: Type, capfd: pytest.CaptureFixture[str]
) -> None:
    operator = Operator()
    soon(lambda: terminal(b" 150.2 \n"))
    assert operator.ask("Set the rail") == "150.2"
    assert capfd.readouterr().err == "Set the rail:\n"
    assert operator.question is None


def test_enter_is_enough_where_nothing_is_to_be_typed(
    terminal: Type, capfd: pytest.CaptureFixture[str]
) -> None:
    soon(lambda: terminal(b"\n"))
    assert Operator().ask("Put the cap on", "done") == ""
    assert "Put the cap on, then press Enter:" in capfd.readouterr().err


def test_what_was_typed_before_is_no_answer(terminal: Type) -> None:
    terminal(b"1\n2\n")
    soon(lambda: terminal(b"3\n"))
    assert Operator().ask("Set the rail") == "3"


def test_a_person_who_went_home_does_not_hold_the_program_forever(
    terminal: Type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(operator, "QUESTION_S", 0.05)
    with pytest.raises(
        DeviceTimeoutError, match="nobody answered within 0 minutes: Set it"
    ):
        Operator().ask("Set it")


def test_a_terminal_that_is_closed_ends_the_question(terminal: Type) -> None:
    soon(lambda: terminal(b""))
    with pytest.raises(
        DeviceError, match="the terminal was closed before anyone answered: Set it"
    ):
        Operator().ask("Set it")


def test_a_page_goes_on_when_the_terminal_is_closed(terminal: Type) -> None:
    operator = Operator()
    soon(lambda: (terminal(b""), soon(lambda: operator.answer(1, "5"))))
    with operator.reached_by(Reader(operator)):
        assert operator.ask("Set it") == "5"


def test_a_page_answers_without_a_terminal(nobody: None) -> None:
    operator = Operator()
    heard = []
    with operator.reached_by(
        Reader(operator, lambda number: heard.append(operator.answer(number, "12")))
    ):
        assert operator.present
        assert operator.ask("Set it") == "12"
    assert heard == [True]


def test_a_page_answers_before_the_terminal_and_the_terminal_is_told(
    terminal: Type, capfd: pytest.CaptureFixture[str]
) -> None:
    operator = Operator()
    with operator.reached_by(
        Reader(operator, lambda number: operator.answer(number, "12"))
    ):
        assert operator.ask("Set it") == "12"
    assert "answered on the operator's page: 12" in capfd.readouterr().err


def test_the_first_of_two_answers_is_heard(nobody: None) -> None:
    operator = Operator()
    heard: list[bool] = []
    page = Reader(
        operator,
        lambda number: heard.extend(operator.answer(number, text) for text in ("1", "2")),
    )
    with operator.reached_by(page):
        assert operator.ask("Set it") == "1"
    assert heard == [True, False]


def test_a_late_answer_is_not_one_to_the_next_question(nobody: None) -> None:
    operator = Operator()
    heard: list[bool] = []
    page = Reader(
        operator,
        lambda n: heard.extend(
            operator.answer(number, str(number)) for number in (n - 1, n)
        ),
    )
    with operator.reached_by(page):
        assert [
            operator.ask("Put the cap on", "done"),
            operator.ask("Take it off", "done"),
        ] == ["1", "2"]
    assert heard == [False, True, False, True]
    assert not operator.answer(2, "again")


def test_a_page_that_aborts_ends_the_question_as_ctrl_c_does(nobody: None) -> None:
    operator = Operator()
    page = Reader(operator)
    page.aborts = True
    with (
        operator.reached_by(page),
        operator.reached_by(page),
    ):  # by its monitor and by its display
        with pytest.raises(KeyboardInterrupt):
            operator.ask("Set it")
        assert operator.question is None
    assert not operator.present
