"""Whether files and folders are there: a mistyped path is named before anything that takes time is imported."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import typer

from labkit.errors import InputError, PlanError
from labkit.session.journal import journal_in

Given = TypeVar("Given")


def checked(check: Callable[[Path], None]) -> Callable[[typer.Context, Given], Given]:
    """Return a callback of an argument or option that checks each path in its value."""

    def callback(ctx: typer.Context, given: Given) -> Given:
        if given is not None and not ctx.resilient_parsing:  # as completion is
            for one in given if isinstance(given, list) else [given]:
                check(Path(str(one)))
        return given

    return callback


def a_session(path: Path) -> None:
    """Raise SessionError for what is no session's folder."""
    journal_in(path)


def a_plan(path: Path) -> None:
    """Raise PlanError for a plan that is not there."""
    if not _is_there(path):
        raise PlanError(f"plan {path}: {os.strerror(errno.ENOENT)}")


def perhaps_a_plan(path: Path) -> None:
    """Raise PlanError for a plan that is not there; what does not end in .toml is something else."""
    if path.suffix == ".toml":
        a_plan(path)


def a_file(path: Path) -> None:
    """Raise InputError for a file that is not there."""
    if not _is_there(path):
        raise InputError(f"{path}: {os.strerror(errno.ENOENT)}")


def a_file_or_plan(path: Path) -> None:
    """Raise InputError for a file that is not there, PlanError for a plan."""
    perhaps_a_plan(path)
    a_file(path)


def a_file_or_session(path: Path) -> None:
    """Raise SessionError for a folder of a session that is not there, InputError for a file, which has a suffix."""
    if _is_there(path):
        return
    if path.suffix:
        a_file(path)
    a_session(path)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that no file can have: its reader says why
        return True
