"""Verify a session: frames against their checksums, the journal against the folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from labkit.errors import SessionError
from labkit.findings.findings import Finding, found
from labkit.session.frame import FRAMES_FOLDER, pending
from labkit.session.journal import JOURNAL, is_being_written
from labkit.session.session import Session, leftovers, unlisted
from labkit.storage.files import checksum_problem, link_problem, links_in

PUT_BACK = (
    "put back a copy of each, from a backup or the camera's card; without one, import those that are whole as a new "
    "session"
)


def verify(session: Session | Path | str) -> list[str]:
    """Check a session: frames and plan against their checksums, the journal against the folder.

    Parameters
    ----------
    session : the session, or its folder

    Returns
    -------
    the faults, one line each; empty for a whole session

    Raises
    ------
    SessionError
        the folder is no session

    >>> labkit.verify("night-3")
    []
    """
    session = session if isinstance(session, Session) else Session.open(Path(session))
    problems = [*session.plan_damage(), *altered(session), *session.doubled]
    problems += [f"{path}: not in the journal" for path in unlisted(session)]
    links = [link_problem(path) for path in links_in(session.folder)]
    return list(dict.fromkeys([*problems, *links]))


def remarks(session: Session) -> list[str]:
    """Return harmless remarks, one line each: remains of a crash, and changes that `verify` cannot detect."""
    lines = []
    if session.unchained:
        lines.append(
            f"{session.folder / JOURNAL}: its first {session.unchained} lines were written by an earlier labkit, each with a "
            "checksum of its own alone: lines missing, doubled or moved among them go unnoticed"
        )
    if is_being_written(session.folder / JOURNAL):
        return lines  # and what is half done is no leftover
    if adding := pending(session.events):
        lines.append(
            f"{adding['file']} was being added when labkit stopped; the next capture finishes that"
        )
    return lines + [
        f"{path}: left by a capture that was stopped; the next one removes it"
        for path in leftovers(session.folder)
    ]


def unused(session: Session) -> list[Finding]:
    """Report photographs without a complete journal entry, which are not used."""
    strays = unlisted(session)
    adding = pending(session.events)
    if adding and not is_being_written(session.folder / JOURNAL):
        path = session.folder / FRAMES_FOLDER / adding["file"]
        strays += [path] if path.exists() else []
    if not strays:
        return []
    folder = str(strays[0].parent)
    first = strays[0].name
    return [found("photographs-unlisted", count=len(strays), folder=folder, first=first)]


def is_safe(session: Session) -> bool:
    """Return whether journal and folder contain everything that a session holds in memory, by a quick look."""
    try:
        kept = {frame.file for frame in Session.open(session.folder).frames}
        return all(
            frame.file in kept and frame.path.stat().st_size for frame in session.frames
        )
    except (SessionError, OSError):
        return False


def as_error(problems: Sequence[str]) -> str:
    """Describe the faults of a session, and the remedy for changed files."""
    words = "; ".join(problems)
    signs = ("checksum", "missing", "file is needed")
    damaged = any(sign in problem for problem in problems for sign in signs)
    return f"{words}; {PUT_BACK}" if damaged else words


def altered(session: Session) -> list[str]:
    """Return the photographs that are missing or changed, one line each."""
    problems = (checksum_problem(frame.path, frame.sha256) for frame in session.frames)
    return [problem for problem in problems if problem]
