"""The commands `list`, `history`, `compare` and `catalogue rebuild`, for scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from labkit.catalogue.entry import read_entry
from labkit.catalogue.history import History, history_of
from labkit.catalogue.store import Catalogue, read_catalogue
from labkit.errors import DataError, LabkitError
from labkit.types import Progress, no_progress

if TYPE_CHECKING:
    from labkit.catalogue.compare import Comparison
    from labkit.results import Results


def list_sessions(folder: Path | str = ".", progress: Progress = no_progress) -> Catalogue:
    """List the sessions in a folder, each with its lens, camera and numbers.

    The catalogue, which is kept in the user's own state folder, is brought up to date first.

    Parameters
    ----------
    folder : folder of the sessions' folders
    progress : called with each session read

    Returns
    -------
    An entry for each results of each session; an entry that cannot be read says why in `problem`

    Raises
    ------
    InputError
        there is no such folder

    >>> for entry in labkit.list_sessions("sessions").entries:
    ...     print(entry.folder, entry.lens, entry.numbers.get(("best_focus_mm", "G")))
    """
    return read_catalogue(Path(folder), progress=progress)


def rebuild_catalogue(
    folder: Path | str = ".", progress: Progress = no_progress
) -> Catalogue:
    """Make the catalogue of a folder anew, from the sessions in it.

    Parameters
    ----------
    folder : folder of the sessions' folders
    progress : called with each session read

    Raises
    ------
    InputError
        there is no such folder, or the catalogue cannot be written

    >>> labkit.rebuild_catalogue("sessions")
    """
    return read_catalogue(Path(folder), rebuild=True, progress=progress)


def lens_history(
    lens: str,
    channel: str | None = None,
    *,
    folder: Path | str = ".",
    name: str = "latest",
    progress: Progress = no_progress,
) -> History:
    """Return a lens's best focus, RMS and modes over all its sessions in a folder.

    Parameters
    ----------
    lens : name, serial number, or a part of both together
    channel : name of the channel; None for green, or the first
    folder : folder of the sessions' folders
    name : of the results
    progress : called with each session read

    Raises
    ------
    DataError
        no lens, or more than one, is called so, or none of its sessions has this channel
    InputError
        there is no such folder

    >>> history = labkit.lens_history("0042117", "G", folder="sessions")
    >>> [history.number(entry, "waves.8") for entry in history.entries]
    """
    catalogue = read_catalogue(Path(folder), progress=progress)
    left_out = tuple(entry for entry in catalogue.entries if entry.problem)
    return replace(history_of(catalogue.entries, lens, channel, name), left_out=left_out)


def compare_sessions(
    *sessions: Path | str, name: str = "latest", same_focus: bool = False
) -> tuple[Comparison, ...]:
    """Compare sessions in pairs: differences with their errors, and the probability of one lens.

    Parameters
    ----------
    sessions : folders of two sessions or more
    name : of the results
    same_focus : whether lens, camera and rail stayed as they were between them: then best focus is tested too

    Raises
    ------
    DataError
        fewer than two sessions, a session without results, or two without a number in common

    >>> (comparison,) = labkit.compare_sessions("before", "after")
    >>> print(comparison.p_value, comparison.largest)
    """
    comparisons, left_out = compare_readable(*sessions, name=name, same_focus=same_focus)
    for error in left_out.values():
        raise error
    return comparisons


def compare_readable(
    *sessions: Path | str, name: str = "latest", same_focus: bool = False
) -> tuple[tuple[Comparison, ...], dict[str, LabkitError]]:
    """Compare sessions in pairs, as `compare_sessions` does, and leave out what cannot be compared.

    Parameters
    ----------
    sessions, name, same_focus : as of `compare_sessions`

    Returns
    -------
    The comparisons, and the reason for each session or pair left out

    Raises
    ------
    DataError
        no two sessions can be compared
    """
    from labkit.catalogue.compare import compare_results
    from labkit.results import Results

    if len(sessions) < 2:
        raise DataError("give two sessions or more to compare")
    results = list[tuple[str, Results]]()
    left_out = dict[str, LabkitError]()
    for session in map(str, sessions):
        try:
            results.append((session, Results.load(session, name, residuals=False)))
        except LabkitError as error:
            left_out[session] = error
    cameras = _cameras(results, name)
    comparisons = []
    for (a, first), (b, second) in combinations(results, 2):
        try:
            comparisons.append(
                compare_results(
                    first,
                    second,
                    names=(a, b),
                    same_focus=same_focus,
                    same_camera=cameras[a] == cameras[b],
                )
            )
        except LabkitError as error:
            left_out[f"{a} and {b}"] = error
    if not comparisons:
        raise next(iter(left_out.values()))
    return tuple(comparisons), left_out


def _cameras(results: Sequence[tuple[str, Results]], name: str) -> dict[str, str]:
    """Return the body of each session; empty texts where no results depend on it."""
    from labkit.catalogue.compare import shares_wavelengths

    if not any(shares_wavelengths(held) for _, held in results):
        return {session: "" for session, _ in results}
    return {session: read_entry(Path(session), name).camera for session, _ in results}
