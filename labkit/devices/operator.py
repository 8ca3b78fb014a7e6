"""Questions to the operator, answered at the terminal or on a page, whichever answer comes first."""

from __future__ import annotations

import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from typing import Literal, Protocol, TextIO, runtime_checkable

from labkit.errors import DeviceError, DeviceTimeoutError, printable

QUESTION_S = 3600.0
"""A question is given up after an hour; the capture then tries again."""

TERMINAL_POLL_S = 0.1
"""How often the terminal and the pages are looked at in turn."""

Wants = Literal["number", "done"]
"""Kinds of answers: a number in any spelling, which the caller checks, or a confirmation."""


@dataclass(frozen=True, slots=True)
class Question:
    """A question to the operator.

    number: counts up, so that a late answer does not count for the next question.
    """

    number: int
    text: str
    wants: Wants


@runtime_checkable
class AnswerPage(Protocol):
    """A page on which the operator may answer."""

    def wake(self) -> None:
        """Receive notice that a question was opened or closed."""
        ...

    def refuse_abort(self) -> None:
        """Raise KeyboardInterrupt if the operator wants to stop; called while a question waits."""
        ...


class Operator:
    """The person at the bench. The capture's thread asks one question at a time; any thread may answer.

    still: a context that keeps the terminal free for typing.
    """

    def __init__(
        self, still: Callable[[], AbstractContextManager[object]] = nullcontext
    ) -> None:
        self._still = still
        self._changed = threading.Condition()
        self._count = 0
        self._question: Question | None = None
        self._answer: str | None = None
        self._pages: list[AnswerPage] = []

    @property
    def present(self) -> bool:
        """Return whether there is a terminal or a page to ask on."""
        return bool(self._pages) or _terminal() is not None

    @property
    def question(self) -> Question | None:
        """The waiting question, if any."""
        return self._question

    def ask(self, text: str, wants: Wants = "number") -> str:
        """Ask a question, such as "Set the rail to 150 mm and type what its scale says"; return the answer, trimmed.

        Raises DeviceError if nobody can answer, DeviceTimeoutError after an hour,
        KeyboardInterrupt if a page aborts.
        """
        if not self.present:
            raise DeviceError(
                f"someone is needed here ({text}): run this at a terminal, or with --monitor"
            )
        with self._changed:
            self._count += 1
            self._question = Question(self._count, text, wants)
            self._answer = None
        self._notify()
        try:
            with self._still():
                return self._wait(
                    text if wants == "number" else f"{text}, then press Enter"
                ).strip()
        finally:
            with self._changed:
                self._question = None
            self._notify()

    def answer(self, number: int, text: str) -> bool:
        """Answer the question of a number; return whether the answer was accepted as the first."""
        with self._changed:
            accepted = (
                self._question is not None
                and self._question.number == number
                and self._answer is None
            )
            if accepted:
                self._answer = text
                self._changed.notify_all()
            return accepted

    @contextmanager
    def reached_by(self, page: AnswerPage) -> Iterator[None]:
        """Accept answers on a page too until the end of the block. Contexts of one page may be nested."""
        self._pages.append(page)
        try:
            yield
        finally:
            self._pages.remove(page)

    def _notify(self) -> None:
        for page in set(self._pages):
            page.wake()

    def _wait(self, prompt: str) -> str:
        deadline = time.monotonic() + QUESTION_S
        terminal = _terminal()
        if terminal is not None:
            forget_typed(terminal)
            print(f"{printable(prompt)}:", file=sys.stderr, flush=True)
        while time.monotonic() < deadline:
            typed = _line(terminal) if terminal is not None else None
            for page in set(self._pages):
                page.refuse_abort()
            with self._changed:
                if self._answer is None and terminal is None:
                    self._changed.wait(TERMINAL_POLL_S)
                if self._answer is not None:
                    if terminal is not None:
                        words = printable(self._answer or "done")
                        print(f"answered on the operator's page: {words}", file=sys.stderr)
                    return self._answer
            if typed:
                return typed
            if typed == "":
                terminal = None
                if not self._pages:
                    raise DeviceError(
                        f"the terminal was closed before anyone answered: {prompt}"
                    )
        raise DeviceTimeoutError(
            f"nobody answered within {QUESTION_S / 60:.0f} minutes: {prompt}"
        )


def _terminal() -> TextIO | None:
    try:
        return sys.stdin if sys.stdin.isatty() else None
    except (AttributeError, ValueError):  # none, or closed
        return None


def forget_typed(terminal: TextIO) -> None:
    """Drop characters typed before a question."""
    import termios

    with suppress(termios.error):
        termios.tcflush(terminal, termios.TCIFLUSH)


def _line(terminal: TextIO) -> str | None:
    """Return a typed line with its end; "" from a closed terminal, None if nothing comes for a moment."""
    try:
        return (
            terminal.readline()
            if select.select([terminal], [], [], TERMINAL_POLL_S)[0]
            else None
        )
    except (OSError, ValueError):
        return ""
