"""The commands `list`, `history`, `compare` and `catalogue rebuild`, for scripts."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from labkit.catalogue.entry import read_entry
from labkit.catalogue.history import History, history_of
from labkit.catalogue.store import Catalogue, read_catalogue
from labkit.errors import DataError
from labkit.types import Progress, no_progress

if TYPE_CHECKING:
    from labkit.catalogue.compare import Comparison


def list_sessions(folder: Path | str = ".", progress: Progress = no_progress) -> Catalogue:
    """List the sessions in a folder, each with its lens, camera and numbers.

    The catalogue, which is kept in the user's own state folder, is brought up to date first.

    Parameters
    ----------
    folder : folder that the sessions' folders are in
    progress : called with each session that is read

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
    folder : folder that the sessions' folders are in
    progress : called with each session that is read

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
    folder : folder that the sessions' folders are in
    name : of the results
    progress : called with each session that is read

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
    return history_of(catalogue.entries, lens, channel, name)


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
    from labkit.catalogue.compare import compare_results, shares_wavelengths
    from labkit.results import Results

    if len(sessions) < 2:
        raise DataError("give two sessions or more to compare")
    results = [Results.load(one, name, residuals=False) for one in sessions]
    cameras = [""] * len(sessions)
    if any(shares_wavelengths(one) for one in results):
        cameras = [read_entry(Path(one), name).camera for one in sessions]
    return tuple(
        compare_results(
            results[a],
            results[b],
            names=(str(sessions[a]), str(sessions[b])),
            same_focus=same_focus,
            same_camera=cameras[a] == cameras[b],
        )
        for a, b in combinations(range(len(sessions)), 2)
    )
