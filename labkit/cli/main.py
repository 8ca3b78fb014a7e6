"""Runs a command line: exit status and one line for what went wrong."""

from __future__ import annotations

import logging
import os
import sys
import traceback
from collections.abc import Sequence

import typer
from typer.exceptions import TyperException

from labkit.cli.app import app
from labkit.console import Console, error_line
from labkit.errors import LabkitError

GLOBAL_FLAGS = ("--debug", "--quiet", "--json")


def main() -> None:
    """Run the command line and leave with its exit status."""
    sys.exit(run(sys.argv[1:]))


def run(args: Sequence[str]) -> int:
    """Run a command line; returns the exit status. --debug, --quiet and --json may stand anywhere before a "--"."""
    end = args.index("--") if "--" in args else len(args)
    flags = [arg for arg in args[:end] if arg in GLOBAL_FLAGS]
    rest = [arg for arg in args[:end] if arg not in GLOBAL_FLAGS] + list(args[end:])
    console = Console()
    logging.getLogger("tifffile").addHandler(logging.NullHandler())  # it logs what it raises as well
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        status = typer.main.get_command(app).main(
            [*flags, *rest], prog_name="labkit", standalone_mode=False, obj=console
        )
        sys.stdout.flush()
    except BrokenPipeError:
        # whoever read our output has had enough; Python must not complain about it again on exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except BaseException as error:
        return _failed(error, console)
    if status == 130:
        return _interrupted(console)
    return status if isinstance(status, int) else 0


def _failed(error: BaseException, console: Console) -> int:
    """Say what went wrong, in one line; returns the exit status."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return _interrupted(console)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if console.debug:
        traceback.print_exception(error)
    if isinstance(error, TyperException):
        usage = error.format_message()
        if "\n" in usage:  # the help that a bare command prints
            print(usage, file=sys.stderr)
        else:
            error_line(f"{usage} See labkit --help.")
        return error.exit_code
    if isinstance(error, LabkitError):
        error_line(f"{error}{console.hint}")
        return error.exit_status
    if isinstance(error, OSError):
        error_line(f"{error.filename or 'the system'}: {error.strerror or error}")
        return 2
    if isinstance(error, MemoryError):
        error_line(
            f"there is not enough memory{f' ({error})' if str(error) else ''}: close other programs, or use another machine"
        )
        return 1
    error_line(f"this is a fault in labkit: {type(error).__name__}: {error}; --debug shows where")
    return 1


def _interrupted(console: Console) -> int:
    error_line(f"interrupted{console.hint}")
    return 130
