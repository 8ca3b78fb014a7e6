"""Check that files and folders exist before slow imports: a mistyped path is reported at once."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from labkit.errors import InputError, PlanError
from labkit.session.journal import journal_in

NO_SUCH_FILE = os.strerror(errno.ENOENT)


def a_session(path: Path) -> None:
    """Raise SessionError for a path that is no session folder."""
    journal_in(path)


def a_plan(*paths: Path | None) -> None:
    """Raise PlanError for a missing plan; ignore None."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise PlanError(f"plan {path}: {NO_SUCH_FILE}")


def perhaps_a_plan(given: str) -> None:
    """Raise PlanError for a missing plan; ignore arguments that do not end in .toml."""
    if given.endswith(".toml"):
        a_plan(Path(given))


def a_file(*paths: Path | None) -> None:
    """Raise InputError for a missing file; ignore None."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise InputError(f"{path}: {NO_SUCH_FILE}")


def a_file_or_plan(*paths: Path) -> None:
    """Raise InputError for a missing file, PlanError for a missing plan."""
    for path in paths:
        perhaps_a_plan(str(path))
        a_file(path)


def a_file_or_session(*paths: Path | None) -> None:
    """Raise SessionError for a missing session, InputError for a missing file, whose name has a suffix."""
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
