"""The catalogue's file: SQLite next to the sessions, which can always be rebuilt from their folders.

Reading updates the catalogue: results whose file differs in size or time from the catalogue's entry are read again. Fits do
not write to the catalogue, so no fit waits for a lock.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from math import nan
from pathlib import Path

from labkit.catalogue.entry import Entry, read_entry
from labkit.errors import InputError
from labkit.session.journal import JOURNAL
from labkit.types import Progress, no_progress
from labkit.uncertain import Uncertain

CATALOGUE_FILE = "catalogue.sqlite"
BUSY_S = 5.0
"""Longest wait for another process that writes to the catalogue."""

RESULTS_FILES = ("results", "results.json")

MIGRATIONS = (
    """
    CREATE TABLE results (
        folder TEXT, name TEXT, stamp TEXT, state TEXT, problem TEXT, lens TEXT,
        serial TEXT, camera TEXT, taken TEXT, created TEXT, PRIMARY KEY (folder, name)
    );
    CREATE TABLE numbers (
        folder TEXT, name TEXT, quantity TEXT, channel TEXT, value REAL, std REAL,
        PRIMARY KEY (folder, name, quantity, channel),
        FOREIGN KEY (folder, name) REFERENCES results ON DELETE CASCADE
    );
    """,
)
"""Scripts that lead from each version of the file, its `user_version`, to the next; all results are read again after one."""

WORD_COLUMNS = ("folder", "name", "state", "problem", "lens", "serial", "camera")
TIMES = ("taken", "created")

Place = tuple[str, str]
"""Folder of a session and name of its results."""


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Entries in the order of their folders; warnings: faults of the catalogue's file, in words."""

    entries: tuple[Entry, ...]
    warnings: tuple[str, ...] = ()


def read_catalogue(
    folder: Path, *, rebuild: bool = False, progress: Progress = no_progress
) -> Catalogue:
    """Bring the catalogue of a folder of sessions up to date, and return its entries.

    Parameters
    ----------
    folder : folder that the sessions' folders are in
    rebuild : whether to read all sessions again
    progress : called with each session that is read

    Raises
    ------
    InputError
        there is no such folder; with `rebuild`, the file cannot be written
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder: give the folder that the sessions are in")
    file = folder / CATALOGUE_FILE
    try:
        return Catalogue(_entries_of(file, folder, rebuild, progress))
    except sqlite3.OperationalError as error:
        why = f"{file} cannot be written ({error})"
        if rebuild:
            raise InputError(f"{why}; end what uses it, or allow writing") from None
        instead = f"{why}: all sessions were read anew, and nothing is kept"
    except sqlite3.DatabaseError as error:
        instead = f"{file} was damaged ({error}): it is built anew"
        for torn in (file, *(file.with_name(file.name + end) for end in ("-wal", "-shm"))):
            with suppress(OSError):
                torn.unlink()
        with suppress(sqlite3.Error):
            return Catalogue(_entries_of(file, folder, True, progress), (instead,))
    return Catalogue(_entries_of(":memory:", folder, True, progress), (instead,))


def _entries_of(
    file: Path | str, folder: Path, rebuild: bool, progress: Progress
) -> tuple[Entry, ...]:
    """Bring a catalogue up to date, and return its entries. Raises sqlite3.Error."""
    with closing(sqlite3.connect(file, timeout=BUSY_S, isolation_level=None)) as database:
        _migrate(database)
        _refresh(database, folder, rebuild, progress)
        return tuple(_entries(database))


def _migrate(database: sqlite3.Connection) -> None:
    """Bring the file to this version. Raises sqlite3.Error; OperationalError for a file of a later version."""
    database.execute("PRAGMA foreign_keys = ON")
    (version,) = database.execute("PRAGMA user_version").fetchone()
    if version > len(MIGRATIONS):
        raise sqlite3.OperationalError(
            f"it is of version {version}, of a later labkit; this one knows {len(MIGRATIONS)}"
        )
    if version == len(MIGRATIONS):
        return
    database.execute("PRAGMA journal_mode = WAL")
    with database:
        database.execute("BEGIN IMMEDIATE")
        # another process may have done it meanwhile
        (version,) = database.execute("PRAGMA user_version").fetchone()
        for script in MIGRATIONS[version:]:
            for statement in script.split(";"):
                database.execute(statement)
            database.execute("DELETE FROM results")
        database.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")


def _refresh(
    database: sqlite3.Connection, folder: Path, rebuild: bool, progress: Progress
) -> None:
    """Read what changed in the folders since, in one transaction."""
    there = dict(_stamps(folder))
    known = {
        (place, name): stamp
        for place, name, stamp in database.execute(
            "SELECT folder, name, stamp FROM results"
        )
    }
    gone = [place for place in known if rebuild or known[place] != there.get(place)]
    new = [place for place in there if rebuild or known.get(place) != there[place]]
    if not (gone or new):
        return
    rows = []
    for done, place in enumerate(new):
        progress(done, len(new), place[0])
        rows.append((read_entry(folder / place[0], place[1]), there[place]))
    with database:
        database.execute("BEGIN IMMEDIATE")
        database.executemany("DELETE FROM results WHERE folder = ? AND name = ?", gone)
        for entry, stamp in rows:
            _insert(database, entry, stamp)


def _insert(database: sqlite3.Connection, entry: Entry, stamp: str) -> None:
    """Write an entry, in place of an earlier one: another process may have read the same session meanwhile."""
    columns = (*WORD_COLUMNS, *TIMES)
    database.execute(
        f"INSERT OR REPLACE INTO results (stamp, {', '.join(columns)}) "
        f"VALUES (?{', ?' * len(columns)})",
        (stamp, *(getattr(entry, column) for column in columns)),
    )
    database.executemany(
        "INSERT OR REPLACE INTO numbers VALUES (?, ?, ?, ?, ?, ?)",
        (
            (entry.folder, entry.name, *quantity, number.value, number.std)
            for quantity, number in entry.numbers.items()
        ),
    )


def _entries(database: sqlite3.Connection) -> Iterator[Entry]:
    """Yield all entries in the order of their folders."""
    numbers = dict[Place, dict[tuple[str, str], Uncertain]]()
    for place, name, quantity, channel, value, std in database.execute(
        "SELECT folder, name, quantity, channel, value, std FROM numbers ORDER BY rowid"
    ):
        unit = (
            "mm" if quantity.endswith("_mm") else "nm" if quantity.endswith("_nm") else ""
        )
        unit = "waves" if quantity.startswith("waves.") else unit
        number = Uncertain(value, nan if std is None else std, unit)
        numbers.setdefault((place, name), {})[quantity, channel] = number
    columns = (*WORD_COLUMNS, *TIMES)
    for row in database.execute(
        f"SELECT {', '.join(columns)} FROM results ORDER BY folder, name"
    ):
        held = dict(zip(columns, row, strict=True))
        yield Entry(**held, numbers=numbers.get((held["folder"], held["name"]), {}))


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
