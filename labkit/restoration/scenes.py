"""Restore the scenes behind photographs: which lens took them, and where the results go."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from labkit.errors import DataError, SessionError
from labkit.jobs.execute import default_workers
from labkit.jobs.threads import one_thread
from labkit.restoration.restored_photographs import (
    Restoration,
    Say,
    Wanted,
    restore_images,
    restore_session,
)
from labkit.restoration.strength import DISCREPANCY, Choice
from labkit.results import Results
from labkit.session.session import Session
from labkit.storage.files import links_in, refuse_links
from labkit.types import Progress, no_progress


class Scene(Protocol):
    """A scene to be restored, which is restored as it is called."""

    def __call__(self, *, say: Say, progress: Progress) -> Restoration:
        """Restore the scene. say: called with what it will take before it begins."""
        ...


@one_thread
def restore(
    photographs: Path | str | Sequence[Path | str],
    psf: Path | str | None = None,
    out: Path | str | None = None,
    *,
    name: str = "latest",
    range_mm: float | None = None,
    channels: Sequence[str] = (),
    strength: float | Choice = DISCREPANCY,
    samples: int | None = None,
    crop: tuple[int, int, int, int] | None = None,
    fit_defocus: bool = False,
    force: bool = False,
    sixteen_bit: bool = False,
    memory_gb: float | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> tuple[Restoration, ...]:
    """Restore the scene behind photographs by a session's lens, with standard errors.

    Parameters
    ----------
    photographs : a photograph, several of the same scene, or a session's folder
    psf : folder of the session whose lens took them; None for the session given
    out : folder to make; by default beside the photograph, or in the session's results
    name : name of the session's results
    range_mm : range of the photographs; by default the session's only one
    channels : channels to restore; none for all
    strength : the regularisation's lambda, or a method to choose it, such as
        `labkit.experiments.methods.l_curve.L_CURVE`
    samples : samples of the restored scene to a pixel; by default as diffraction requires
    crop : first row, first column, row and column after the last, in raw pixels
    fit_defocus : whether to estimate the photographs' own defocus
    force : whether to take the PSF though camera, aperture or colour is another
    sixteen_bit : whether to write a linear 16-bit TIFF too
    memory_gb : largest memory to use; by default the free memory
    workers : number of processes, by default as many as cores
    progress : called as the work goes on

    Returns
    -------
    a restoration for each range: its folder, what restore.json states, notes

    Raises
    ------
    RawError, DataError, SessionError, InputError
        of photographs, results, session and the folder to make

    >>> labkit.restore("scene.dng", psf="night-3", range_mm=3200)[0].folder
    """
    given = [photographs] if isinstance(photographs, Path | str) else photographs
    area = None if crop is None else (slice(crop[0], crop[2]), slice(crop[1], crop[3]))
    wanted = Wanted(
        strength=strength,
        channels=tuple(channels),
        range_mm=range_mm,
        samples=samples,
        crop=area,
        memory_gb=memory_gb,
        fit_defocus=fit_defocus,
        force=force,
        sixteen_bit=sixteen_bit,
        workers=workers or default_workers(),
    )
    scenes = scenes_of(
        [Path(path) for path in given],
        None if psf is None else Path(psf),
        None if out is None else Path(out),
        name,
        wanted,
    )
    return tuple(scene(say=lambda text: None, progress=progress) for scene in scenes)


def scenes_of(
    photographs: Sequence[Path],
    psf: Path | None,
    out: Path | None,
    name: str,
    wanted: Wanted,
) -> Iterator[Scene]:
    """Yield the scene of the photographs; of a session the scene of each range. Raises DataError, SessionError."""
    if psf is not None:
        results = Results.load(psf, name)
        session = _session(psf)
        folder = out or photographs[0].parent / f"{photographs[0].stem}-restored"
        yield partial(restore_images, photographs, results, session, folder, wanted)
        return
    if not (len(photographs) == 1 and photographs[0].is_dir()):
        raise DataError(
            "whose lens took them? Give --psf SESSION, or a session's folder alone"
        )
    own = photographs[0]
    results = Results.load(photographs[0], name)
    opened = Session.open(own)
    refuse_links(*links_in(own))
    ranges = results.ranges_mm if wanted.range_mm is None else (wanted.range_mm,)
    base = out or own / "results" / name / "restored"
    for range_mm in ranges:
        alone = range_mm is None or len(ranges) == 1
        folder = base if alone else base / f"{range_mm:g}"
        yield partial(restore_session, opened, results, range_mm, folder, wanted)


def _session(folder: Path) -> Session | None:
    """Return the session in a folder; None for a folder of results alone."""
    try:
        return Session.open(folder)
    except SessionError:
        return None
