"""The session folder: the plan as run, the frames unchanged, a journal of events, results.

A frame belongs to the session once its journal line is written. An "adding" line precedes
the file and a "frame" line follows, so a crash at any moment leaves either no frame, or a
whole one that the next writer commits.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labkit.errors import PlanError, SessionError
from labkit.plan import Plan
from labkit.session.frame import (
    FRAMES_FOLDER,
    NEEDED_IN_EVENT,
    Frame,
    as_html,
    doubled,
    event_problem,
    frame_of,
    in_words,
    pending,
)
from labkit.session.journal import (
    JOURNAL,
    Event,
    JournalWriter,
    journal_in,
    read_journal,
)
from labkit.session.making import made_beside, refuse_existing
from labkit.session.stored_plan import (
    PLAN_FILE,
    changed_tables,
    plan_as_run,
    plan_damage,
    plan_source,
    store_plan,
)
from labkit.storage.files import (
    check_name,
    copy_durably,
    links_in,
    refuse_links,
    sha256_of,
    sync_folder,
    writing,
)
from labkit.types import FRAME_KINDS, FrameKind
from labkit.version import __version__

PREFLIGHT_FOLDER = "preflight"
"""Of test photographs, and of pictures of searches in vain for the target."""

RESULTS_FOLDER, INCOMING_FOLDER, EXPOSING_FOLDER = "results", ".incoming", ".exposing"
"""INCOMING is a photograph on its way into frames/, EXPOSING the folder that a camera writes the next one to."""

MOST_NAMED_FILES = 20  # files in a message


class Session:
    """A session folder, open to read, or to append by one process at a time.

    Made by `create`, `open` and `append`; a context manager. `warnings` lists repairs and
    omissions on opening.

    >>> labkit.Session.open("night-3").frames
    """

    def __init__(
        self,
        folder: Path,
        events: list[Event],
        writer: JournalWriter | None,
        warnings: tuple[str, ...] = (),
        unchained: int = 0,
    ) -> None:
        self.folder = folder
        self.unchained = unchained
        self._events = events
        self._writer = writer
        self._plan: Plan | None = None
        for number, event in enumerate(events, start=1):
            if problem := event_problem(event):
                raise SessionError(
                    f"{folder / JOURNAL}: line {number} cannot be used: it is {problem}"
                )
        self.doubled = doubled(events, folder / JOURNAL)
        self.warnings = (*warnings, *self.doubled)
        if not events or events[0]["event"] != "created":
            raise SessionError(
                f"{folder / JOURNAL} does not begin as a journal: nothing in it can be used"
            )

    @classmethod
    def create(cls, folder: str | Path, plan_text: str, plan_folder: str | Path) -> Session:
        """Create a session, open to append, with a copy of the plan's target picture.

        Parameters
        ----------
        folder : absent or empty
        plan_text : TOML
        plan_folder : folder of the files named in the plan

        Raises
        ------
        PlanError
            the text holds no plan
        SessionError
            `folder` exists and is not empty
        """
        folder = Path(folder)
        plan = Plan.parse(plan_text, Path(plan_folder))
        with ExitStack() as on_failure:
            with made_beside(folder, "new") as beside:
                with writing(folder):
                    (beside / FRAMES_FOLDER).mkdir()
                fields = store_plan(
                    plan, plan_text, beside, (JOURNAL, FRAMES_FOLDER, RESULTS_FOLDER)
                )
                writer = JournalWriter(beside / JOURNAL)
                on_failure.callback(writer.close)
                created = writer.append("created", labkit_version=__version__, **fields)
                sync_folder(beside)
            writer.path = folder / JOURNAL
            on_failure.pop_all()
        return cls(folder, [created], writer)

    @classmethod
    def open(cls, folder: str | Path) -> Session:
        """Open a session to read.

        Raises
        ------
        SessionError
            the folder is no session, or its journal is damaged
        """
        path = journal_in(Path(folder))
        journal = read_journal(path)
        warnings = (f"{path}: left out a torn last line",) if journal.torn else ()
        return cls(path.parent, list(journal.events), None, warnings, journal.unchained)

    @classmethod
    def append(cls, folder: str | Path) -> Session:
        """Open a session to append. Damage by a crash is repaired; `warnings` lists the repairs.

        Raises
        ------
        SessionError
            the folder is no session, is damaged, holds links, or is being written by
            another process
        """
        path = journal_in(Path(folder))
        refuse_links(*links_in(path.parent))
        writer = JournalWriter(path)
        try:
            journal = writer.journal
            session = cls(path.parent, list(journal.events), writer, (), journal.unchained)
            session._mend(journal.torn)
        except BaseException:
            writer.close()
            raise
        return session

    def __repr__(self) -> str:
        return f"<Session {self.folder}: {in_words(self.frames)}>"

    def _repr_html_(self) -> str:
        return as_html(self.folder, self.frames)

    @property
    def plan(self) -> Plan:
        """The plan as run. Raises SessionError if the plan, or its target's picture, was altered since."""
        if self._plan is None:
            self._plan = plan_as_run(self.folder, self._planned)
        return self._plan

    def plan_damage(self) -> list[str]:
        """Return the faults of the plan and its target's picture, one line each."""
        return plan_damage(self.folder, self._planned)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Every committed frame, in the order of the journal; each once."""
        frames = (
            frame_of(event, self.folder)
            for event in self._events
            if event["event"] == "frame"
        )
        return tuple({frame.file: frame for frame in frames}.values())

    @property
    def events(self) -> tuple[Event, ...]:
        """Everything in the journal."""
        return tuple(self._events)

    def add_frame(
        self, source: Path, name: str, kind: FrameKind, range_mm: float | None, **meta: Any
    ) -> Frame:
        """Copy a photograph into frames/ and commit it; the frame is on the disk at return.

        Parameters
        ----------
        source : file of the photograph
        name : in frames/
        kind : kind of frame
        range_mm : mm; None if unknown or without meaning
        meta : any values that JSON can hold, such as exposure_s

        Raises
        ------
        SessionError
            the name exists or is unsafe, or the kind is unknown
        """
        target = self.folder / FRAMES_FOLDER / check_name(name)
        if kind not in FRAME_KINDS:
            raise SessionError(
                f"frame {name}: kind {kind!r}: allowed is {', '.join(FRAME_KINDS)}"
            )
        if target.exists():
            raise SessionError(f"{target} is there already; frames are never overwritten")
        incoming = self.folder / INCOMING_FOLDER
        sha256 = copy_durably(source, incoming)
        fields = {
            **meta,
            "file": name,
            "kind": kind,
            "range_mm": range_mm,
            "sha256": sha256,
        }
        self._write("adding", **fields)
        with writing(target):
            incoming.rename(target)
        sync_folder(target.parent)
        return frame_of(self._write("frame", **fields), self.folder)

    def log(self, event: str, **fields: Any) -> None:
        """Write an event to the journal.

        Raises
        ------
        ValueError
            the event is reserved for the session itself
        """
        if event in NEEDED_IN_EVENT:
            raise ValueError(f"event {event!r} belongs to the session itself")
        self._write(event, **fields)

    def replan(self, plan_text: str, plan_folder: Path) -> None:
        """Put another plan in place of the session's. Raises PlanError, or SessionError once there is a photograph."""
        if self.frames:
            raise SessionError(f"session {self.folder} has photographs: its plan stays")
        plan = Plan.parse(plan_text, plan_folder)
        self._write(
            "replanned",
            **store_plan(
                plan, plan_text, self.folder, (JOURNAL, FRAMES_FOLDER, RESULTS_FOLDER)
            ),
        )
        self._plan = None

    def results_folder(self, name: str = "latest") -> Path:
        """Return the folder of the results of a name; the folder need not exist yet.

        Raises
        ------
        InputError
            the folder cannot be written to
        SessionError
            the session holds links to other places
        """
        folder = self.folder / RESULTS_FOLDER / check_name(name)
        refuse_links(*links_in(self.folder))
        with writing(folder):
            there = next(path for path in (folder, *folder.parents) if path.exists())
            if not there.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
            if os.statvfs(there).f_flag & os.ST_RDONLY:
                raise OSError(errno.EROFS, os.strerror(errno.EROFS))
            if not os.access(there, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return folder

    def close(self) -> None:
        """Let others append."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, event: str, **fields: Any) -> Event:
        if self._writer is None:
            raise SessionError(f"session {self.folder} is open to read only")
        written = self._writer.append(event, **fields)
        self._events.append(written)
        return written

    @property
    def _planned(self) -> Event:
        """Event to which the plan in the folder belongs."""
        return [
            event for event in self._events if event["event"] in ("created", "replanned")
        ][-1]

    def _mend(self, torn: bytes) -> None:
        """Remove a torn line, and finish or abandon the frame being added."""
        assert self._writer is not None
        warnings = []
        if torn:
            self._writer.drop_last(len(torn))
            self._write("dropped", line=torn.decode(errors="replace"))
            warnings.append(f"{self.folder / JOURNAL}: dropped a torn last line")
        if adding := pending(self._events):
            path = self.folder / FRAMES_FOLDER / adding["file"]
            if not path.exists():
                self._write("discarded", file=adding["file"])
            elif sha256_of(path) == adding["sha256"]:
                self._write(
                    "frame",
                    **{key: adding[key] for key in adding.keys() - {"event", "time"}},
                )
            else:
                raise SessionError(
                    f"{path} was being added when labkit stopped, and is damaged; move it away"
                )
            warnings.append(
                f"{adding['file']} was being added when labkit stopped; it is {self._events[-1]['event']} now"
            )
        for path in leftovers(self.folder):
            with writing(path):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        self.warnings = (*warnings, *self.doubled)


def begin(plan: Plan | Path | str, folder: Path | str, resume: bool) -> Session:
    """Open a session for a capture: a new one, or with `resume` an existing one.

    Until its first photograph a session adopts changes of the plan, which a preflight may
    require. plan: or its path. Raises SessionError if a session exists and resume is not
    set or its plan was altered, PlanError if its photographs were taken by another plan.
    """
    folder = Path(folder)
    source = plan_source(plan)
    if not resume:
        refuse_existing(folder, "--resume")
    if not resume or not (folder / JOURNAL).exists():
        return Session.create(folder, source.text, source.folder)
    with ExitStack() as on_failure:
        session = on_failure.enter_context(Session.append(folder))
        refuse_unlisted(session)
        if not session.frames:  # a crash may have cut a change of plan short
            if session.plan_damage() or changed_tables(session.plan, source.plan):
                session.replan(source.text, source.folder)
        elif changed := ", ".join(
            f"[{name}]" for name in changed_tables(session.plan, source.plan)
        ):
            raise PlanError(
                f"plan {source.name} differs in {changed} from the one that the photographs in {folder} were taken by, "
                f"{folder / PLAN_FILE}: go on with that one, or give a new folder"
            )
        on_failure.pop_all()
    return session


def unlisted(session: Session) -> list[Path]:
    """Return the files in frames/ that the journal lacks now: another process may add to both."""
    folder = session.folder / FRAMES_FOLDER
    there = sorted(folder.iterdir()) if folder.is_dir() else []
    # the journal is read last: a line goes before each photograph
    events = Session.open(session.folder).events
    known = {event["file"] for event in events if event["event"] == "frame"}
    if adding := pending(events):
        known.add(adding["file"])
    return [path for path in there if path.name not in known]


def refuse_unlisted(session: Session) -> None:
    """Raise SessionError for photographs that the journal lacks: its end is lost."""
    if strange := unlisted(session):
        aside = str(session.folder / "aside")
        first = shlex.join(["mv", *map(str, strange[:MOST_NAMED_FILES]), aside])
        raise SessionError(
            f"{len(strange)} photographs in {session.folder / FRAMES_FOLDER} stand in no line of {session.folder / JOURNAL}, "
            f"{strange[0].name} for one: it has lost lines. Put back a whole copy of it; or have them taken again, once they "
            f"are moved away{' (labkit verify names all)' if len(strange) > MOST_NAMED_FILES else ''}: "
            f"{shlex.join(['mkdir', '-p', aside])} && {first}"
        )


def leftovers(folder: Path) -> list[Path]:
    """Return the temporary files left by killed processes."""
    names = (INCOMING_FOLDER, EXPOSING_FOLDER)
    return [
        path
        for path in sorted(folder.iterdir())
        if path.name in names or path.match(".*.part")
    ]
