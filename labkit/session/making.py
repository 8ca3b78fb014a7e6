"""Make a session's folder beside its final place, then move the whole folder there."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labkit.errors import SessionError
from labkit.session.journal import JOURNAL, is_being_written
from labkit.storage.files import sync_folder, writing

HALF_MADE = re.compile(r"\..+\.(\d+)\.(?:new|import)")
"""What is being made is called so: by whom, a process id, and how."""


def refuse_existing(folder: Path, go_on: str = "") -> None:
    """Raise SessionError unless a session can be made at `folder`.

    go_on: how to continue an existing session
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        hint = (
            f"; to go on with it, use {go_on}"
            if go_on and (folder / JOURNAL).exists()
            else ""
        )
        raise SessionError(f"{folder} is there already: give a new folder{hint}")
    if folder.is_symlink() and not folder.exists():
        raise SessionError(
            f"{folder} is a link to {os.readlink(folder)}, which is not there: give a new folder"
        )
    if Path.cwd().is_relative_to(folder.resolve()):
        raise SessionError(
            f"{folder} is the folder you are in, and cannot be made anew: give the name of a new one in it"
        )
    above = folder.absolute().parent
    for place in (above, *above.parents):
        if place.exists() and not place.is_dir():
            raise SessionError(f"{folder} cannot be made: {place} is no folder")
    if not above.exists():
        raise SessionError(
            f"{folder} cannot be made: {above} is not there; correct the path, or make that folder first"
        )


@contextmanager
def made_beside(folder: Path, how: str) -> Iterator[Path]:
    """Yield a new folder that replaces `folder` after the block, and is removed if the block fails.

    Half-made folders of killed processes are removed. how: "new" or "import". Raises
    SessionError if `folder` exists before or after the block, InputError if nothing can be
    written.
    """
    refuse_existing(folder)
    real = folder.resolve()
    with writing(folder):
        remove_abandoned(real.parent)
        beside = real.parent / f".{real.name}.{os.getpid()}.{how}"
        beside.mkdir()
    try:
        yield beside
        with writing(folder):
            try:
                beside.rename(real)
            except OSError:
                refuse_existing(folder)  # somebody else was faster
                raise
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    sync_folder(real.parent)


def remove_abandoned(folder: Path) -> None:
    """Remove half-made sessions in a folder that no process on any machine works on."""
    for path in folder.glob(".*"):
        found = HALF_MADE.fullmatch(path.name)
        # of a process of this machine the lock is not even asked for: it may be about to take it
        if (
            found
            and path.is_dir()
            and not path.is_symlink()
            and not _is_alive(int(found[1]))
        ):
            journal = path / JOURNAL
            if not (journal.exists() and is_being_written(journal)):
                shutil.rmtree(path, ignore_errors=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # somebody else's
        return True
    return True
