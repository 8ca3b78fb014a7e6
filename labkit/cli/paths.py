"""Whether files and folders are there: a mistyped path is named before anything that takes time is imported."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from labkit.errors import InputError, PlanError
from labkit.session.journal import journal_in

GONE = os.strerror(errno.ENOENT)


def a_session(path: Path) -> None:
    """Raise SessionError for what is no session's folder."""
    journal_in(path)


def a_plan(*paths: Path | None) -> None:
    """Raise PlanError for a plan that is not there; None was not given."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise PlanError(f"plan {path}: {GONE}")


def perhaps_a_plan(given: str) -> None:
    """Raise PlanError for a plan that is not there; what does not end in .toml is something else."""
    if given.endswith(".toml"):
        a_plan(Path(given))


def a_file(*paths: Path | None) -> None:
    """Raise InputError for a file that is not there; None was not given."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise InputError(f"{path}: {GONE}")


def a_file_or_plan(*paths: Path) -> None:
    """Raise InputError for a file that is not there, PlanError for a plan."""
    for path in paths:
        perhaps_a_plan(str(path))
        a_file(path)


def a_file_or_session(*paths: Path | None) -> None:
    """Raise SessionError for a session that is not there, InputError for a file, whose name has a suffix."""
    for path in filter(None, paths):
        if path.suffix:
            a_file(path)
        elif not _is_there(path):
            a_session(path)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that no file can have: its reader says why
        return True
