"""The catalogue's file: a copy, in the user's own state folder, of what the sessions' folders hold.

Reading updates the catalogue: results whose file differs in size or time from the catalogue's entry are read again. Fits do
not write to the catalogue. The file lies with the user and not with the sessions, which travel: a catalogue that somebody
else made is nothing to believe. A file that is odd in any way counts as none.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any

from labkit.catalogue.entry import Entry, Quantity, read_entry
from labkit.errors import InputError
from labkit.session.journal import JOURNAL
from labkit.storage.files import state_folder, write_private
from labkit.storage.reading import read_private
from labkit.types import Progress, no_progress
from labkit.uncertain import Uncertain
from labkit.version import __version__

MOST_CATALOGUE_BYTES = 2**26
"""Of the file: 15,000 sessions of three channels with 22 modes."""

RESULTS_FILES = ("results", "results.json")

ENTRY_TEXTS = tuple(field.name for field in fields(Entry) if field.name != "numbers")

QUANTITY = re.compile(r"[a-z_]+|waves\.\d{1,4}")

Place = tuple[str, str]
"""Folder of a session and name of its results."""

Kept = dict[Place, tuple[str, Entry]]
"""Entries of results, each with size and time of the results' file."""


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Entries in the order of their folders; warnings: why the catalogue is not kept, in words."""

    entries: tuple[Entry, ...]
    warnings: tuple[str, ...] = ()


def read_catalogue(
    folder: Path, *, rebuild: bool = False, progress: Progress = no_progress
) -> Catalogue:
    """Bring the catalogue of a folder of sessions up to date, and return its entries.

    Parameters
    ----------
    folder : folder of the sessions' folders
    rebuild : whether to read all sessions again
    progress : called with each session read

    Raises
    ------
    InputError
        there is no such folder; with `rebuild`, the catalogue cannot be written
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder: give the folder that the sessions are in")
    before = {} if rebuild else _read(folder)
    now = _updated(before, folder, progress)
    entries = tuple(entry for _, (_, entry) in sorted(now.items()))
    # what could not be read is tried again each time: a later labkit may read it
    kept = {place: known for place, known in now.items() if not known[1].problem}
    try:
        if rebuild or kept != before:
            _write(folder, kept)
    except InputError as error:
        if rebuild:
            raise
        instead = f"{error}; all sessions were read anew, and nothing is kept"
        return Catalogue(entries, (instead,))
    return Catalogue(entries)


def catalogue_file(folder: Path) -> Path:
    """Return where this user's catalogue of a folder of sessions is kept. Raises InputError for a user without a home."""
    key = hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:32]
    try:
        return state_folder() / "catalogue" / f"{key}.json"
    except RuntimeError as error:
        raise InputError(f"no place to keep the catalogue in: {error}") from error


def _read(folder: Path) -> Kept:
    """Return the entries of a catalogue; none of a file that is missing or odd."""
    try:
        held = json.loads(read_private(catalogue_file(folder), MOST_CATALOGUE_BYTES))
        if held["labkit"] != __version__:
            return {}
        return {
            (entry.folder, entry.name): (str(stamp), entry)
            for stamp, entry in ((stamp, _entry(one)) for stamp, one in held["entries"])
        }
    except (InputError, OSError, ValueError, TypeError, LookupError, RecursionError):
        return {}


def _write(folder: Path, kept: Kept) -> None:
    """Keep the entries of a catalogue. Raises InputError."""
    entries = [[stamp, _as_json(entry)] for stamp, entry in kept.values()]
    held = {"labkit": __version__, "folder": str(folder.resolve()), "entries": entries}
    write_private(catalogue_file(folder), json.dumps(held).encode())


def _as_json(entry: Entry) -> dict[str, Any]:
    numbers = [
        [*quantity, float(number.value), float(number.std)]
        for quantity, number in entry.numbers.items()
    ]
    return {**{word: getattr(entry, word) for word in ENTRY_TEXTS}, "numbers": numbers}


def _entry(held: Mapping[str, Any]) -> Entry:
    """Return the entry that JSON stands for. Raises LookupError, TypeError, ValueError."""
    words = {word: held[word] for word in ENTRY_TEXTS}
    numbers = dict[Quantity, Uncertain]()
    for name, channel, value, std in held["numbers"]:
        if not QUANTITY.fullmatch(name) or not isfinite(value):
            raise ValueError(f"{name!r} is no quantity, or {value!r} no number")
        numbers[name, channel] = Uncertain(float(value), float(std), _unit(name))
    texts = [*words.values(), *(channel for _, channel in numbers)]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("a text is missing")
    return Entry(**words, numbers=numbers)


def _unit(quantity: str) -> str:
    if quantity.startswith("waves."):
        return "waves"
    unit = quantity.rpartition("_")[2]
    return unit if unit in ("mm", "nm") else ""


def _updated(before: Kept, folder: Path, progress: Progress) -> Kept:
    """Return the entries of all results in a folder: those known, if their files did not change since."""
    there = dict(_stamps(folder))
    now = {
        place: before[place]
        for place, stamp in there.items()
        if place in before and before[place][0] == stamp
    }
    new = [place for place in there if place not in now]
    for done, place in enumerate(new):
        progress(done, len(new), place[0])
        now[place] = there[place], read_entry(folder / place[0], place[1])
    return now


def _stamps(folder: Path) -> Iterator[tuple[Place, str]]:
    """Yield the results in each session's folder, with size and time of their file; of a session without any, its journal's."""
    with os.scandir(folder) as places:
        sessions = sorted(place.path for place in places if place.is_dir())
    for session in sessions:
        journal = _stamp(os.path.join(session, JOURNAL))
        if journal is None:
            continue
        name = os.path.basename(session)
        found = list(_results_in(session))
        yield from (((name, results), stamp) for results, stamp in found)
        if not found:
            yield (name, ""), journal


def _results_in(session: str) -> Iterator[tuple[str, str]]:
    """Yield names and stamps of a session's results."""
    within, file = RESULTS_FILES
    with suppress(FileNotFoundError, NotADirectoryError):
        for name in sorted(os.listdir(os.path.join(session, within))):
            stamp = _stamp(os.path.join(session, within, name, file))
            if stamp is not None:
                yield name, stamp


def _stamp(path: str) -> str | None:
    """Return size and time of a file; None where there is none."""
    with suppress(OSError):
        found = os.stat(path)
        return f"{found.st_size} {found.st_mtime_ns}"
    return None
