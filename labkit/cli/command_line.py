"""Run a command line with an exit status, and one line for each error."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import NoReturn

import typer
from typer.exceptions import TyperException

from labkit.cli.app import app
from labkit.cli.console import Console, error_line, print_line
from labkit.errors import LabkitError, out_of_memory
from labkit.storage.files import open_standard_streams

COMMANDS = {
    "bench": {"camera", "capture", "devices", "rail", "target"},
    "catalogue": {"catalogue", "compare", "history", "list"},
    "chart": {"chart"},
    "edges": {"edges"},
    "field": {"field"},
    "field_moves": {"field"},
    "focus": {"camera"},
    "noise": {"noise"},
    "reprocessing": {"reprocess"},
    "restoring": {"restore"},
    "sessions": {
        *("advise", "demo", "fit", "import", "plan", "report", "study", "verify"),
    },
}
"""First words of commands by the module that adds them to `app` as it is imported."""

GLOBAL_FLAGS = ("--debug", "--quiet", "--json")

END_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""Beside Ctrl-C."""


def main() -> None:
    """Run the command line and leave with its exit status."""
    open_standard_streams()
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - for good
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.exit(run(sys.argv[1:], leaving=True))


def load_commands(word: str = "") -> None:
    """Import the modules of the commands that begin with a word; all modules for another word."""
    named = [module for module, words in COMMANDS.items() if word in words]
    for module in named or COMMANDS:
        import_module(f"labkit.cli.{module}")


def run(args: Sequence[str], *, leaving: bool = False) -> int:
    """Run a command line and return the exit status.

    --debug, --quiet and --json may stand anywhere before a "--". leaving: whether the
    process ends afterwards, so that repeated interrupts change nothing.
    """
    end = args.index("--") if "--" in args else len(args)
    flags = [arg for arg in args[:end] if arg in GLOBAL_FLAGS]
    rest = [arg for arg in args[:end] if arg not in GLOBAL_FLAGS] + list(args[end:])
    load_commands(next(iter(rest), ""))
    console = Console(
        json="--json" in flags
    )  # what is wrong with the options themselves is JSON too
    logging.getLogger("tifffile").addHandler(
        logging.NullHandler()
    )  # it logs what it raises as well
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        with _interrupts(console, leaving):
            status = typer.main.get_command(app).main(
                [*flags, *rest], prog_name="labkit", standalone_mode=False, obj=console
            )
            if status == 130:
                raise KeyboardInterrupt
        sys.stdout.flush()
    except BrokenPipeError:
        # whoever read our output has had enough; Python must not complain about it again on exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except BaseException as error:
        return _failed(error, console)
    return status if isinstance(status, int) else 0


@contextmanager
def _interrupts(console: Console, leaving: bool) -> Iterator[None]:
    """End a command on SIGTERM and SIGHUP as on Ctrl-C: cleanly, with one line.

    leaving: whether further interrupts are ignored, so that the process ends with its own
    status.
    """

    def interrupt(number: int, frame: object) -> NoReturn:
        for each in END_SIGNALS:
            signal.signal(
                each, signal.SIG_IGN
            )  # a terminal that is closed sends several: one is enough
        console.interrupted_by = signal.Signals(number).name
        raise KeyboardInterrupt(console.interrupted_by)

    ours = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    before = {
        number: handler
        for number, handler in before.items()
        if ours and handler == signal.SIG_DFL
    }
    for number in before:  # but not under nohup, which has SIGHUP ignored
        signal.signal(number, interrupt)
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        if leaving and ours:
            before = dict.fromkeys((signal.SIGINT, *END_SIGNALS), signal.SIG_IGN)
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _failed(error: BaseException, console: Console) -> int:
    """Print an error in one line and return the exit status."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return _interrupted(console)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if console.debug:
        for line in "".join(traceback.format_exception(error)).splitlines():
            print_line(line, file=sys.stderr)
    if isinstance(error, TyperException):
        usage = error.format_message()
        if "\n" in usage:  # the help that a bare command prints
            for line in usage.splitlines():
                print_line(line, file=sys.stderr)
        else:
            context = getattr(error, "ctx", None)
            error_line(
                f"{usage.rstrip('.')}. See {context.command_path if context else 'labkit'} --help."
            )
        console.failed("UsageError", usage)
        return error.exit_code
    words, status = _words(error, console)
    error_line(words)
    console.failed(type(error).__name__, words)
    return status


def _words(error: BaseException, console: Console) -> tuple[str, int]:
    """Return the message of an error, and the exit status."""
    if isinstance(error, LabkitError):
        return f"{error}{console.hint}", error.exit_status
    if out_of_memory(error):
        what = f": {error}" if isinstance(error, MemoryError) and str(error) else ""
        return f"there is not enough memory{what}; {_more_memory()}{console.hint}", 1
    if isinstance(error, OSError):
        return (
            f"{error.filename or 'the system'}: {error.strerror or error}{console.hint}",
            2,
        )
    return (
        f"this is a fault in labkit: {type(error).__name__}: {error}; --debug shows where{console.hint}",
        1,
    )


def _more_memory() -> str:
    """Return how this process gets more memory."""
    with suppress(ImportError):
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            return f"this shell allows {most >> 20} MiB (ulimit -v): allow more"
    return "close other programs"


def _interrupted(console: Console) -> int:
    by = f" by {console.interrupted_by}" if console.interrupted_by else ""
    error_line(f"interrupted{by}{console.hint}")
    console.failed("Interrupted", f"interrupted{by}{console.hint}")
    return 130
