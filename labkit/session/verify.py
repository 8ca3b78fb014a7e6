"""Whether a session is as it was made: frames against their checksums, the journal against the folder."""

from __future__ import annotations

from labkit.files import checksum_problem
from labkit.session.frame import FRAMES, pending
from labkit.session.journal import is_being_written
from labkit.session.session import JOURNAL, Session, leftovers


def verify(session: Session) -> list[str]:
    """What is wrong with a session, a line each: frames against their checksums, the journal against the folder."""
    problems = session.plan_damage() + altered(session)
    known = {frame.file for frame in session.frames}
    if adding := pending(session.events):
        known.add(adding["file"])
    folder = session.folder / FRAMES
    present = sorted(folder.iterdir()) if folder.is_dir() else []
    return problems + [f"{path}: not in the journal" for path in present if path.name not in known]


def remarks(session: Session) -> list[str]:
    """What is no damage but worth knowing, a line each: what a crash left, and what `verify` cannot notice."""
    lines = []
    if session.unchained:
        lines.append(
            f"{session.folder / JOURNAL}: its first {session.unchained} lines were written by an earlier labkit, each with a "
            "checksum of its own alone: lines missing, doubled or moved among them go unnoticed"
        )
    if is_being_written(session.folder / JOURNAL):
        return lines  # and what is half done is no leftover
    if adding := pending(session.events):
        lines.append(f"{adding['file']} was being added when labkit stopped; the next capture finishes that")
    return lines + [
        f"{path}: left by a capture that was stopped; the next one removes it" for path in leftovers(session.folder)
    ]


def altered(session: Session) -> list[str]:
    """The photographs that are missing or not as they were taken, a line each."""
    problems = (checksum_problem(frame.path, frame.sha256) for frame in session.frames)
    return [problem for problem in problems if problem]
