"""Print for the command line: text or JSON on stdout, errors and progress on stderr.

Nothing else in the command line prints. Names of folders and texts of files may hold characters that act on a terminal:
all are escaped here.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any, TextIO

from labkit.errors import printable
from labkit.jobs.pace import EARLIER, Work

if TYPE_CHECKING:
    from labkit.cli.progress_bar import Bar
    from labkit.types import Progress

# rich, segno and NumPy are imported where they are needed: a mistyped path must not wait for them.

EVERY_S = 10.0
"""How often a line says how far work is, where there is no terminal."""


@dataclass(slots=True)
class Console:
    """Output of one command, as the user chose: quiet, JSON or text.

    hint: printed when a command is interrupted; interrupted_by: name of the signal; bar:
    the progress bar at work; answered: whether JSON was printed (one object for each
    command).
    """

    quiet: bool = False
    json: bool = False
    debug: bool = False
    hint: str = ""
    interrupted_by: str = ""
    bar: Bar | None = None
    answered: bool = False

    def say(self, text: str) -> None:
        """Print a line for people; nothing with --quiet or --json."""
        if not (self.quiet or self.json):
            print_line(text)

    def say_lines(self, text: str) -> None:
        """Print a text of several lines for people; nothing with --quiet or --json."""
        for line in text.splitlines():
            self.say(line)

    def answer(self, data: dict[str, Any]) -> None:
        """Print the command's answer as JSON; nothing without --json."""
        if self.json:
            self.answered = True
            for line in json.dumps(data, indent=1, ensure_ascii=False).split("\n"):
                print(_json_escaped(line))

    def failed(self, kind: str, message: str) -> None:
        """Print an error as JSON, unless an answer, which states the error, was printed before."""
        if self.json and not self.answered:
            with suppress(OSError):
                self.answer({"error": {"kind": kind, "message": message}})

    def warn(self, *texts: str) -> None:
        """Print warnings on stderr; nothing with --quiet."""
        for text in () if self.quiet else texts:
            print_line(f"labkit: warning: {text}", file=sys.stderr)

    def link(self, what: str, url: str) -> None:
        """Print the address of a page on stderr, with its QR code on a terminal; nothing with --quiet."""
        if self.quiet:
            return
        print_line(f"{what}: {url}", file=sys.stderr)
        if sys.stderr.isatty():
            import segno

            code = StringIO()
            segno.make(url, micro=False).terminal(code, border=2, compact=True)
            print(code.getvalue(), file=sys.stderr)

    def table(self, rows: Sequence[Sequence[str]], indent: str = "") -> None:
        """Print rows in aligned columns; the first row is the heading."""
        rows = [[printable(cell) for cell in row] for row in rows]
        widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
        for row in rows:
            cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            self.say((indent + "  ".join(cells)).rstrip())

    @contextmanager
    def progress(
        self, doing: str, expected_s: float | None = None, expected_by: str = EARLIER
    ) -> Iterator[Progress]:
        """Show a bar with the time left on a terminal, elsewhere a line every ten seconds.

        With --quiet nothing is shown. expected_s, expected_by: see `Work`.
        """
        if self.quiet:
            yield lambda done, total, step: None
            return
        from labkit.cli.progress_bar import bar_of, terminal

        work = Work(doing, expected_s=expected_s, expected_by=expected_by)
        shown_on = terminal()
        if shown_on is None:
            with _lines(work):
                yield work.report
            return
        with bar_of(work, shown_on) as self.bar:
            try:
                yield self.bar.report
            finally:
                self.bar = None

    @contextmanager
    def still(self) -> Iterator[None]:
        """Stop the progress bar while the user types."""
        bar = self.bar
        if bar is not None:
            bar.stop()
        try:
            yield
        finally:
            if bar is not None:
                bar.start()


def _line(work: Work) -> str:
    """Say how far some work is."""
    done = f" {work.pace.done}/{work.pace.total}" if work.pace.total else ""
    step = f": {work.step}" if work.step else ""
    return f"labkit: {work.doing}{done}, {work.times()}{step}"


@contextmanager
def _lines(work: Work) -> Iterator[None]:
    """Print the progress of some work on stderr at regular intervals."""
    ended = threading.Event()

    def speak() -> None:
        while not ended.wait(EVERY_S):
            with suppress(OSError, ValueError):  # nobody reads any more
                print_line(_line(work), file=sys.stderr)

    speaker = threading.Thread(target=speak, name="labkit-progress", daemon=True)
    speaker.start()
    try:
        yield
    finally:
        ended.set()
        speaker.join()


def error_line(text: object) -> None:
    """Print one line on stderr; nothing if the terminal is gone."""
    with suppress(OSError):
        print_line(f"labkit: {' '.join(str(text).split())}", file=sys.stderr)


def print_line(text: str, *, file: TextIO | None = None, end: str = "\n") -> None:
    """Print a line at once, with unprintable characters escaped. file: stdout by default."""
    print(printable(text), file=file, end=end, flush=True)


def _json_escaped(line: str) -> str:
    """Return a line of JSON with unprintable characters escaped as JSON has it."""
    if line.isprintable():
        return line
    return "".join(
        letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in line
    )
