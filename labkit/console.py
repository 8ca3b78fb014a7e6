"""What the command line prints: text or JSON on stdout, errors and progress on stderr."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import StringIO
from typing import Any

import segno
from rich.console import Console as Terminal
from rich.console import RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
)
from rich.table import Column
from rich.text import Text

from labkit.errors import printable
from labkit.pace import PAUSED, Pace, in_words
from labkit.types import Progress as Report

EVERY_S = 10.0
"""How often a line says how far work is, where there is no terminal."""


@dataclass(slots=True)
class Console:
    """How to speak to whoever ran the command. hint: what to say where a command is cut short; interrupted_by: a signal's name;
    bar: the one that moves; answered: whether JSON was printed, which is one object a command."""

    quiet: bool = False
    json: bool = False
    debug: bool = False
    hint: str = ""
    interrupted_by: str = ""
    bar: Progress | None = None
    answered: bool = False

    def say(self, text: str) -> None:
        """A line for people: not with --quiet or --json."""
        if not (self.quiet or self.json):
            print(text, flush=True)  # some is said while work goes on

    def answer(self, data: dict[str, Any]) -> None:
        """What was asked for, as JSON: only with --json."""
        if self.json:
            self.answered = True
            print(json.dumps(data, indent=1, ensure_ascii=False))

    def failed(self, kind: str, message: str) -> None:
        """What went wrong, as JSON in place of the answer, unless that was printed: it holds what is wrong."""
        if self.json and not self.answered:
            with suppress(OSError):
                self.answer({"error": {"kind": kind, "message": printable(message)}})

    def warn(self, *texts: str) -> None:
        """Lines on stderr that do not stop anything: not with --quiet."""
        for text in () if self.quiet else texts:
            print(f"labkit: warning: {printable(text)}", file=sys.stderr)

    def link(self, what: str, url: str) -> None:
        """A page to open, on stderr; with its QR code on a terminal. Not with --quiet."""
        if self.quiet:
            return
        print(f"{what}: {url}", file=sys.stderr)
        if sys.stderr.isatty():
            code = StringIO()
            segno.make(url, micro=False).terminal(code, border=2, compact=True)
            print(code.getvalue(), file=sys.stderr)

    def table(self, rows: Sequence[Sequence[str]], indent: str = "") -> None:
        """Rows in aligned columns; the first row is the heading."""
        widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
        for row in rows:
            cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            self.say((indent + "  ".join(cells)).rstrip())

    @contextmanager
    def progress(self, doing: str) -> Iterator[Report]:
        """A bar with the time left, on a terminal; elsewhere a line every ten seconds. Neither with --quiet."""
        terminal, work = Terminal(stderr=True), _Work(doing)
        if self.quiet:
            yield lambda done, total, step: None
            return
        if not terminal.is_terminal:
            with _lines(work):
                yield work.report
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            _Times(work),
        )
        with _Bar(work, *columns, console=terminal, transient=True) as bar:
            task = bar.add_task(doing, total=None)
            self.bar = bar

            def report(done: int, total: int, step: str) -> None:
                work.report(done, total, step)
                bar.update(task, completed=done, total=total)

            try:
                yield report
            finally:
                self.bar = None

    @contextmanager
    def still(self) -> Iterator[None]:
        """Nothing moves while someone types."""
        bar = self.bar
        if bar is not None:
            bar.stop()
        try:
            yield
        finally:
            if bar is not None:
                bar.start()


@dataclass(slots=True)
class _Work:
    """How far some work is."""

    doing: str
    step: str = ""
    pace: Pace = field(default_factory=Pace)
    began_s: float = field(default_factory=lambda: time.monotonic())

    def report(self, done: int, total: int, step: str) -> None:
        now_s = time.monotonic()
        if step == PAUSED:
            self.pace.hold(now_s)
        else:
            self.pace.go_on(now_s)
        self.pace.at(done, total, now_s)
        self.step = step

    def times(self) -> str:
        """How long it has taken, and how much longer it takes, in words that cannot be taken for each other."""
        now_s = time.monotonic()
        so_far, left_s = f"{in_words(now_s - self.began_s)} so far", self.pace.left_s(now_s)
        if left_s is not None:
            return f"{so_far}, about {in_words(left_s)} left"
        if self.pace.on_hold or self.pace.done >= self.pace.total > 0:
            return so_far
        return f"{so_far}, time left not known yet"

    def line(self) -> str:
        done = f" {self.pace.done}/{self.pace.total}" if self.pace.total else ""
        return f"labkit: {self.doing}{done}, {self.times()}" + (
            f": {printable(self.step)}" if self.step else ""
        )


class _Bar(Progress):
    """A bar, and below it what is being done, cut where the line ends."""

    def __init__(
        self, work: _Work, *columns: ProgressColumn, console: Terminal, transient: bool
    ) -> None:
        self._work = work
        super().__init__(*columns, console=console, transient=transient)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield Text(f"  {printable(self._work.step)}", no_wrap=True, overflow="ellipsis")


class _Times(ProgressColumn):
    """Time so far, and time left."""

    max_refresh = 0.5

    def __init__(self, work: _Work) -> None:
        super().__init__(Column(no_wrap=True))
        self._work = work

    def render(self, task: Task) -> Text:
        return Text(self._work.times())


@contextmanager
def _lines(work: _Work) -> Iterator[None]:
    """Every so often a line on stderr that says how far work is."""
    ended = threading.Event()

    def speak() -> None:
        while not ended.wait(EVERY_S):
            with suppress(OSError, ValueError):  # nobody reads any more
                print(work.line(), file=sys.stderr, flush=True)

    speaker = threading.Thread(target=speak, name="labkit-progress", daemon=True)
    speaker.start()
    try:
        yield
    finally:
        ended.set()
        speaker.join()


def error_line(text: object) -> None:
    """One line on stderr that a terminal can print, whatever the message holds; none where the terminal is gone."""
    with suppress(OSError):
        print(f"labkit: {printable(' '.join(str(text).split()))}", file=sys.stderr)
