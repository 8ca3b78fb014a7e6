"""What the command line prints: text or JSON on stdout, errors and progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import StringIO
from typing import Any

import segno
from rich.console import Console as Terminal
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from labkit.errors import printable
from labkit.types import Progress as Report


@dataclass(slots=True)
class Console:
    """How to speak to whoever ran the command. hint: what to say where a command is cut short; interrupted_by: a signal's name;
    bar: the one that moves."""

    quiet: bool = False
    json: bool = False
    debug: bool = False
    hint: str = ""
    interrupted_by: str = ""
    bar: Progress | None = None

    def say(self, text: str) -> None:
        """A line for people: not with --quiet or --json."""
        if not (self.quiet or self.json):
            print(text)

    def answer(self, data: dict[str, Any]) -> None:
        """What was asked for, as JSON: only with --json."""
        if self.json:
            print(json.dumps(data, indent=1, ensure_ascii=False))

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
        """A bar with the time left, on a terminal; nothing elsewhere."""
        terminal = Terminal(stderr=True)
        if self.quiet or not terminal.is_terminal:
            yield lambda done, total, step: None
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[step]}", markup=False),  # it repeats the names of files
        )
        with Progress(*columns, console=terminal, transient=True) as bar:
            task = bar.add_task(doing, total=None, step="")
            self.bar = bar
            try:
                yield lambda done, total, step: bar.update(task, completed=done, total=total, step=printable(step))
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


def error_line(text: object) -> None:
    """One line on stderr that a terminal can print, whatever the message holds; none where the terminal is gone."""
    with suppress(OSError):
        print(f"labkit: {printable(' '.join(str(text).split()))}", file=sys.stderr)
