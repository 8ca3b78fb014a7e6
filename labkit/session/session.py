"""The session folder: a plan as run, frames as they came, a journal of what happened, results.

A frame is in the session once its journal line is. An "adding" line goes before the file and a "frame" line after it,
so a crash at any moment leaves either no frame, or one that the next writer finds whole and commits.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import tomllib
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self, cast

from labkit.errors import PlanError, SessionError
from labkit.files import check_name, copy_durably, sha256_of, sync_folder, write_atomically, writing
from labkit.plan import Plan, load_plan, parse_plan
from labkit.session.journal import Event, JournalWriter, read_journal
from labkit.types import FRAME_KINDS, FrameKind
from labkit.version import __version__

JOURNAL, PLAN, FRAMES, RESULTS, INCOMING = "journal.jsonl", "plan.toml", "frames", "results", ".incoming"
OWN_EVENTS = ("created", "replanned", "adding", "frame", "discarded", "dropped")


@dataclass(frozen=True, slots=True)
class Frame:
    """A photograph of the session. range_mm is None where it is unknown or has no meaning."""

    file: str
    kind: FrameKind
    range_mm: float | None
    sha256: str
    exposure_s: float | None
    time: str
    path: Path
    meta: Mapping[str, Any] = field(default_factory=dict, hash=False)


class Session:
    """A session folder, open to read, or to append by one process at a time.

    Made by `create`, `open` and `append`; a context manager. `warnings` says what was mended or left out on opening.
    """

    def __init__(
        self, folder: Path, events: list[Event], writer: JournalWriter | None, warnings: tuple[str, ...]
    ) -> None:
        self.folder = folder
        self.warnings = warnings
        self._events = events
        self._writer = writer

    @classmethod
    def create(cls, folder: Path, plan_text: str, plan_folder: Path) -> Session:
        """A new session, open to append. A target picture of the plan is copied into it.

        Raises PlanError, or SessionError if `folder` exists and is not empty.
        """
        plan = parse_plan(plan_text, plan_folder)
        refuse_existing(folder)
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = folder.parent / f".{folder.name}.{os.getpid()}.new"
        with writing(folder):
            (beside / FRAMES).mkdir(parents=True)
        with ExitStack() as on_failure:
            on_failure.callback(shutil.rmtree, beside, ignore_errors=True)
            fields = _store_plan(plan, plan_text, beside)
            writer = JournalWriter(beside / JOURNAL)
            on_failure.callback(writer.close)
            created = writer.append("created", labkit_version=__version__, **fields)
            sync_folder(beside)
            with writing(folder):
                beside.rename(folder)
            sync_folder(folder.parent)
            on_failure.pop_all()
        return cls(folder, [created], writer, ())

    @classmethod
    def open(cls, folder: Path) -> Session:
        """An existing session, to read. Raises SessionError if it is none, or its journal is damaged."""
        _refuse_other_folders(folder)
        events, torn = read_journal(folder / JOURNAL)
        _refuse_headless(folder, events)
        warnings = (f"{folder / JOURNAL}: left out a torn last line",) if torn else ()
        return cls(folder, events, None, warnings)

    @classmethod
    def append(cls, folder: Path) -> Session:
        """An existing session, to add to. What a crash left is mended, and told in `warnings`.

        Raises SessionError if it is none, is damaged, or is being written by another process.
        """
        _refuse_other_folders(folder)
        writer = JournalWriter(folder / JOURNAL)
        try:
            events, torn = read_journal(folder / JOURNAL)
            _refuse_headless(folder, events)
            session = cls(folder, events, writer, ())
            session._mend(torn)
        except BaseException:
            writer.close()
            raise
        return session

    @cached_property
    def plan(self) -> Plan:
        """The plan as run."""
        return load_plan(self.folder / PLAN)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Every committed frame, in the order of the journal."""
        return tuple(self._frame(event) for event in self._events if event["event"] == "frame")

    @property
    def events(self) -> tuple[Event, ...]:
        """Everything in the journal."""
        return tuple(self._events)

    def add_frame(self, source: Path, name: str, kind: FrameKind, range_mm: float | None, **meta: Any) -> Frame:
        """Copy a photograph into frames/ and commit it; it is on the disk when this returns.

        name: its name there; meta: anything JSON can hold, such as exposure_s.
        Raises SessionError for a name that is taken or unsafe, or a kind that is none.
        """
        target = self.folder / FRAMES / check_name(name)
        if kind not in FRAME_KINDS:
            raise SessionError(f"frame {name}: kind {kind!r}: allowed is {', '.join(FRAME_KINDS)}")
        if target.exists():
            raise SessionError(f"{target} is there already; frames are never overwritten")
        incoming = self.folder / INCOMING
        sha256 = copy_durably(source, incoming)
        fields = {**meta, "file": name, "kind": kind, "range_mm": range_mm, "sha256": sha256}
        self._write("adding", **fields)
        with writing(target):
            incoming.rename(target)
        sync_folder(target.parent)
        return self._frame(self._write("frame", **fields))

    def log(self, event: str, **fields: Any) -> None:
        """Write an event of the caller's own to the journal."""
        if event in OWN_EVENTS:
            raise ValueError(f"event {event!r} belongs to the session itself")
        self._write(event, **fields)

    def replan(self, plan_text: str, plan_folder: Path) -> None:
        """Put another plan in place of the session's. Raises PlanError, or SessionError once there is a photograph."""
        if self.frames:
            raise SessionError(f"session {self.folder} has photographs: its plan stays")
        fields = _store_plan(parse_plan(plan_text, plan_folder), plan_text, self.folder)
        self._write("replanned", **fields)
        self.__dict__.pop("plan", None)

    def results_folder(self, name: str = "latest") -> Path:
        """The folder for results of that name; it need not exist yet. Raises InputError if it cannot be written to."""
        folder = self.folder / RESULTS / check_name(name)
        with writing(folder):
            there = next(path for path in (folder, *folder.parents) if path.exists())
            if not there.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _write(self, event: str, **fields: Any) -> Event:
        if self._writer is None:
            raise SessionError(f"session {self.folder} is open to read only")
        written = self._writer.append(event, **fields)
        self._events.append(written)
        return written

    def _frame(self, event: Event) -> Frame:
        own = ("event", "file", "kind", "range_mm", "sha256", "exposure_s", "time")
        return Frame(
            file=event["file"],
            kind=cast(FrameKind, event["kind"]),
            range_mm=event["range_mm"],
            sha256=event["sha256"],
            exposure_s=event.get("exposure_s"),
            time=event["time"],
            path=self.folder / FRAMES / event["file"],
            meta=MappingProxyType({key: value for key, value in event.items() if key not in own}),
        )

    def _mend(self, torn: bytes) -> None:
        """Cut a torn line off, and finish or give up the frame that was being added."""
        assert self._writer is not None
        warnings = []
        if torn:
            self._writer.drop_last(len(torn))
            self._write("dropped", line=torn.decode(errors="replace"))
            warnings.append(f"{self.folder / JOURNAL}: dropped a torn last line")
        if adding := pending(self._events):
            path = self.folder / FRAMES / adding["file"]
            if not path.exists():
                self._write("discarded", file=adding["file"])
            elif sha256_of(path) == adding["sha256"]:
                self._write("frame", **{key: adding[key] for key in adding.keys() - {"event", "time"}})
            else:
                raise SessionError(f"{path} was being added when labkit stopped, and is damaged; move it away")
            warnings.append(
                f"{adding['file']} was being added when labkit stopped; it is {self._events[-1]['event']} now"
            )
        (self.folder / INCOMING).unlink(missing_ok=True)
        self.warnings = tuple(warnings)


def verify(session: Session) -> list[str]:
    """What is wrong with a session, a line each: frames against their checksums, the journal against the folder."""
    problems = _plan_damage(session) + altered(session)
    known = {frame.file for frame in session.frames}
    if adding := pending(list(session.events)):
        known.add(adding["file"])
    folder = session.folder / FRAMES
    present = sorted(folder.iterdir()) if folder.is_dir() else []
    return problems + [f"{path}: not in the journal" for path in present if path.name not in known]


def altered(session: Session) -> list[str]:
    """The photographs that are missing or not as they were taken, a line each."""
    return [problem for frame in session.frames for problem in _changed(frame.path, frame.sha256)]


def pending(events: list[Event]) -> Event | None:
    """The "adding" event that nothing finished, if any: only the last one can be."""
    last = None
    for event in events:
        if event["event"] == "adding":
            last = event
        elif event["event"] in ("frame", "discarded"):
            last = None
    return last


def refuse_existing(folder: Path) -> None:
    """Raise SessionError unless a session can be made at `folder`."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        hint = "; to go on with it, use --resume" if (folder / JOURNAL).exists() else ""
        raise SessionError(f"{folder} is there already: give a new folder{hint}")
    above = next(parent for parent in folder.absolute().parents if parent.exists())
    if not above.is_dir():
        raise SessionError(f"{folder} cannot be made: {above} is no folder")


def begin(plan_path: Path, folder: Path, resume: bool) -> Session:
    """A session to capture into: a new one, or with `resume` the one in `folder` if there is one.

    Until its first photograph a session takes up what has changed in the plan; a preflight may ask for that. Raises
    SessionError where a session is there unasked, PlanError where its photographs were taken by another plan.
    """
    plan, text = load_plan(plan_path), plan_path.read_text(encoding="utf-8-sig")
    if not resume or not (folder / JOURNAL).exists():
        return Session.create(folder, text, plan_path.parent)
    with ExitStack() as on_failure:
        session = on_failure.enter_context(Session.append(folder))
        changed = ", ".join(f"[{name}]" for name in _changes(session.plan, plan))
        if changed and session.frames:
            raise PlanError(
                f"plan {plan_path} differs in {changed} from the one that the photographs in {folder} were taken by, "
                f"{folder / PLAN}: go on with that one, or give a new folder"
            )
        if changed or (not session.frames and _plan_damage(session)):  # or a crash cut the change short
            session.replan(text, plan_path.parent)
        on_failure.pop_all()
    return session


def _changes(begun: Plan, now: Plan) -> list[str]:
    """The tables in which two plans differ, a target's picture compared by content."""
    plans = [begun, now]
    if begun.target.file and now.target.file and sha256_of(begun.target.file) == sha256_of(now.target.file):
        plans = [plan.model_copy(update={"target": plan.target.model_copy(update={"file": None})}) for plan in plans]
    return [name for name in Plan.model_fields if getattr(plans[0], name) != getattr(plans[1], name)]


def _plan_damage(session: Session) -> list[str]:
    """What is wrong with the plan and its target's picture, a line each."""
    planned = [event for event in session.events if event["event"] in ("created", "replanned")][-1]
    files = ((PLAN, "plan_sha256"), (planned.get("target_file"), "target_sha256"))
    return [damage for name, key in files if name for damage in _changed(session.folder / name, planned[key])]


def _changed(path: Path, sha256: str) -> list[str]:
    if not path.is_file():
        return [f"{path}: missing"]
    return [] if sha256_of(path) == sha256 else [f"{path}: does not fit its checksum"]


def _refuse_other_folders(folder: Path) -> None:
    if not (folder / JOURNAL).is_file():
        raise SessionError(f"{folder} is no session: it has no {JOURNAL}")


def _refuse_headless(folder: Path, events: list[Event]) -> None:
    if not events or events[0]["event"] != "created":
        raise SessionError(f"{folder / JOURNAL} does not begin as a journal: nothing in it can be told")


def _store_plan(plan: Plan, text: str, folder: Path) -> dict[str, str]:
    """Write plan.toml, and the target's picture beside it; what the "created" event says of them."""
    fields = {}
    if plan.target.file is not None:
        name = re.sub(r"[^A-Za-z0-9._-]", "_", plan.target.file.name).lstrip(".")
        name = name if name not in (JOURNAL, PLAN, FRAMES, RESULTS, "") else f"target-{name}"
        fields["target_sha256"] = copy_durably(plan.target.file, folder / check_name(name))
        fields["target_file"] = name
        fields["target_source"] = str(plan.target.file)
        text = _with_target_file(text, name)
    write_atomically(folder / PLAN, text.encode())
    return {**fields, "plan_sha256": hashlib.sha256(text.encode()).hexdigest()}


def _with_target_file(text: str, name: str) -> str:
    """The plan with [target] file = name, all else as it was, comments too.

    Raises SessionError where the file's name is not written as a plain one-line string.
    """
    wanted = tomllib.loads(text)
    if wanted["target"]["file"] == name:
        return text
    wanted["target"]["file"] = name
    for literal in re.finditer(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'", text):
        changed = f'{text[: literal.start()]}"{name}"{text[literal.end() :]}'
        try:
            if tomllib.loads(changed) == wanted:
                return changed
        except tomllib.TOMLDecodeError:
            continue
    raise SessionError("plan: target.file must be written as one plain string on its own line")
