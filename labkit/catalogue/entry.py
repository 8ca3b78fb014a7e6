"""A session's results in the catalogue, read from the session's folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labkit.errors import LabkitError, out_of_memory, printable
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.photographs.exif import Exif
    from labkit.results import Results
    from labkit.session.session import Session

# What reads a session is imported where it is needed: a list of known sessions must not wait for NumPy.

Quantity = tuple[str, str]
"""Name and channel of a number: ("best_focus_mm", "G"), ("waves.7", "G"), ("rms_nm", "G"), ("f_number", "")."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A session's results in the catalogue.

    Attributes
    ----------
    folder : the session's, relative to the catalogue's
    name : of the results; empty for a session that was not fitted
    state : which numbers hold, in a sentence
    problem : why the results cannot be read; empty if they can
    lens, serial, camera : as the plan states them, else as EXIF does; empty if neither does
    taken : when the first photograph was taken, or else added to the session, ISO 8601
    created : when the results were made, ISO 8601
    numbers : numbers with their standard errors
    """

    folder: str
    name: str = ""
    state: str = "not fitted"
    problem: str = ""
    lens: str = ""
    serial: str = ""
    camera: str = ""
    taken: str = ""
    created: str = ""
    numbers: dict[Quantity, Uncertain] = field(default_factory=dict)

    @property
    def lens_label(self) -> str:
        """The lens with its serial number; empty if unknown."""
        return " ".join(filter(None, (self.lens, self.serial)))

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels with numbers."""
        return tuple(dict.fromkeys(channel for _, channel in self.numbers if channel))

    def as_json(self) -> dict[str, Any]:
        """Return the entry for programs; numbers by quantity and channel, such as `best_focus_mm.G`."""
        words = ("folder", "name", "state", "problem", "lens", "serial", "camera")
        return {
            **{word: getattr(self, word) for word in (*words, "taken", "created")},
            "numbers": {
                ".".join(filter(None, quantity)): number.as_json()
                for quantity, number in self.numbers.items()
            },
        }


def read_entry(session: Path, name: str) -> Entry:
    """Read an entry from a session's folder; faults of the session are its `problem`.

    Parameters
    ----------
    session : the session's folder
    name : of its results; empty for a session without any
    """
    try:
        return _read(session, name)
    except (LabkitError, OSError) as error:
        return Entry(session.name, name, problem=str(error))
    except Exception as error:  # numbers that no lens has break arithmetic in many ways
        if out_of_memory(error):
            raise
        why = f"its numbers cannot be used: {type(error).__name__}: {error}"
        return Entry(session.name, name, problem=printable(why))


def _read(session: Path, name: str) -> Entry:
    """Return the entry of a session that can be read. Raises LabkitError, OSError, and whatever its numbers break."""
    from labkit.plan import Plan
    from labkit.results import Results
    from labkit.session.session import Session

    opened = Session.open(session)
    results = Results.load(session, name, residuals=False) if name else None
    plan: Plan = opened.plan if results is None else results.plan
    exif = _first_exif(opened)
    body = plan.camera.body if plan.camera else None
    known = Entry(
        session.name,
        name,
        lens=plan.lens.name or exif.lens,
        serial=plan.lens.serial or exif.lens_serial,
        camera=body or " ".join(filter(None, (exif.camera, exif.camera_serial))),
        taken=_taken(opened, exif),
    )
    return known if results is None else _with_results(known, results)


def _with_results(entry: Entry, results: Results) -> Entry:
    """Return the entry with the numbers of results."""
    from dataclasses import replace

    return replace(
        entry,
        state=results.unanswered or results.headline,
        created=results.created,
        numbers={
            quantity: number
            for quantity, number in _numbers(results)
            if isfinite(number.value)
        },
    )


def _numbers(results: Results) -> Iterator[tuple[Quantity, Uncertain]]:
    """Yield the numbers kept; modes whose sign is open are not."""
    if results.lens is not None:
        yield ("focal_length_mm", ""), results.lens.focal_length
        yield ("f_number", ""), results.lens.f_number
        yield ("pupil_magnification", ""), results.lens.pupil_magnification
    for channel in results.channels:
        if results.focus is not None and channel in results.focus.best_focus_mm:
            yield ("best_focus_mm", channel), results.focus[channel]
        w = results.best_known(channel)
        yield ("rms_nm", channel), w.best.rms_nm
        for j in w.at_focus().noll:
            if not w[j].sign_open:
                yield (f"waves.{j}", channel), w[j]


def _first_exif(session: Session) -> Exif:
    """Return the EXIF of a session's first photograph of the target; empty if it cannot be read."""
    from labkit.photographs.exif import Exif, read_exif

    for frame in session.frames:
        if frame.kind == "target":
            with suppress(OSError):
                return read_exif(frame.path)
    return Exif()


def _taken(session: Session, exif: Exif) -> str:
    """Return when the first photograph was taken, or else added, ISO 8601."""
    if exif.taken:
        day, _, time = exif.taken.partition(" ")
        return f"{day.replace(':', '-')}T{time}"
    return next((frame.time for frame in session.frames if frame.kind == "target"), "")
