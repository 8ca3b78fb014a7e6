"""Fit a session: calibrate, find the target, estimate wavefronts and best focus, and write the results."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path

import numpy as np

from labkit.analysis.common_numbers import common_numbers
from labkit.analysis.field_results import as_field
from labkit.analysis.inputs import made_from, of_frames
from labkit.analysis.kept_fits import FOLDER, KeptFits
from labkit.analysis.observe import observe, selected
from labkit.analysis.session_findings import findings_of
from labkit.analysis.session_parts import model_parts, widest_light_nm
from labkit.analysis.session_results import (
    as_focus,
    as_lens,
    as_wavefronts,
    budget,
    wavelengths_nm,
)
from labkit.analysis.steps import Steps
from labkit.analysis.target_tiles import may_be_large
from labkit.errors import DataError, FitError, InputError, SessionError
from labkit.estimation.doubts import turned_lenses, with_model_error
from labkit.estimation.estimate import Estimate
from labkit.estimation.joint import refined, refit_jointly
from labkit.estimation.mistakes import with_doubts
from labkit.estimation.observation import Observation
from labkit.estimation.searches import fit_task
from labkit.estimation.session import estimate
from labkit.estimation.split import Change, find_change
from labkit.field.session_geometry import session_geometry
from labkit.findings.findings import (
    Finding,
    each_once,
    found,
    unanswered,
)
from labkit.jobs.execute import Executed, Run, Workers, default_workers, map_in_order
from labkit.jobs.threads import one_thread
from labkit.key import Key
from labkit.panel.seen_pixels import (
    PLAIN_CONTRAST,
    TargetView,
    refuse_other_pixels,
    seen_pixels,
)
from labkit.panel.target_pixels import as_shown, pixels_per_cell
from labkit.plan import Plan
from labkit.results import Results
from labkit.results.arrays import Mapped
from labkit.results.entries import MadeFrom
from labkit.results.storage import kept_keys, set_aside_corrupt
from labkit.session.completed_plan import with_body_filters, with_shown_size
from labkit.session.fit_lock import fitted_alone
from labkit.session.session import Session
from labkit.session.stated import contradictions
from labkit.session.stored_plan import PLAN_FILE
from labkit.session.verify import altered as altered_files
from labkit.session.verify import as_error, unused
from labkit.storage.files import is_full, sha256_of
from labkit.target.target import Target, open_target
from labkit.types import Progress, no_progress

FIT_AGAIN = "fit again: that goes on where this one ended"
"""Advice after an interrupted fit: completed fits are kept."""

NOT_ALL_KEPT = "fit again: only fits for which there was no room are made again"
"""Advice after a fit on a full disk."""

Ranges = float | Sequence[float] | None
Channels = str | Sequence[str] | None


@one_thread
def fit(
    session: Session | Path | str,
    *,
    plan: Plan | Path | str | None = None,
    ranges_mm: Ranges = None,
    channels: Channels = None,
    noll: tuple[int, int] | None = None,
    workers: int | None = None,
    run: Run | Executor | None = None,
    name: str | None = None,
    patience_s: float = inf,
    joint: bool = False,
    split: bool = False,
    plain: bool = False,
    accept_failed: bool = False,
    progress: Progress = no_progress,
) -> Results:
    """Estimate every wavefront of a session and the best focus over them, and write SESSION/results/NAME.

    Parameters
    ----------
    session : the session, or its folder
    plan : a plan, or its path, instead of the session's own
    ranges_mm, channels : ranges and channels to fit; None for all
    noll : first and last mode, instead of the plan's
    workers : number of processes, by default one for each core; results do not depend on the number
    run : an executor of `concurrent.futures`, or any `labkit.jobs.execute.Run`, in place of `workers` processes of this machine
    name : name of the results; by default "latest", or for some ranges or channels their names
    patience_s : processor time after which the search for one wavefront makes no further start
    joint : whether to climb over all frames at once in the end
    split : whether to write NAME-before and NAME-after in addition if the lens changed during the session
    plain : whether to keep to the plan's camera although the photographs show more parts
    accept_failed : whether results without fits that failed are accepted: else `Results.unanswered` names those fits
    progress : called with the step under way

    Returns
    -------
    The results, as written. Too few ranges for a best focus are no error: see `Results.unanswered`.

    Raises
    ------
    SessionError
        Photographs or the plan were altered, or another process fits under this name.
    TargetError
        A photograph does not show the target.
    DataError
        The frames cannot be fitted, or more results would be lost than made.

    >>> results = labkit.fit("night-3", channels="G", noll=(4, 22), name="22-modes")
    """
    settings = made_from(
        ranges_mm, channels, noll, patience_s, joint, split, plain, plan is None
    )
    session, plan, checksum = _opened(session, plan, noll)
    frames, names = selected(session.frames, plan, ranges_mm, channels)
    keys = {Key(frame.range_mm, name) for frame in frames for name in names}
    whole = (frames, names) == selected(session.frames, plan, None, None)
    folder = session.results_folder(
        name or ("latest" if whole else _partial_name(ranges_mm, channels))
    )
    _refuse_loss(folder, keys)
    workers = _processes(workers or default_workers(), plan, keys)
    target, steps = open_target(plan.target), Steps(progress)
    together = None
    with fitted_alone(folder), _running(run, workers, steps) as mapped:
        kept = KeptFits(mapped, folder / FOLDER)
        observations, assumed = observe(
            session,
            plan,
            target,
            range_mm=ranges_mm,
            channel=channels,
            # processes of this machine read the session's files; another's may not
            run=mapped if run is None and workers > 1 else None,
            progress=steps.before,
        )
        assumed += _panel_findings(plan, target, observations)
        shown = {o.channel: as_shown(plan, target, o.channel) for o in observations}
        fits = estimate(observations, plan, shown, kept, steps, patience_s, plain)
        fits = refined(fits, shown, steps.counted(kept))
        if joint and fits.lens is not None:
            together = refit_jointly(fits, shown, kept, steps.before)
        change = find_change(fits)
        noted = _noted(
            session, plan, [*assumed, *kept.findings, *_set_aside(folder)], change
        )

        def results_of(fits: Estimate, wanted: bool = True) -> Results:
            made = of_frames(settings, session, fits.lost, accept_failed)
            return _results(fits, plan, checksum, noted, made, wanted)

        every = {"": results_of(fits, ranges_mm is None)}
        if together is not None:
            jointly = results_of(replace(fits, lens=together.lens))
            every[""] = replace(jointly, joint=together.differences)
        if change is not None and split:
            every["-before"] = results_of(change.before)
            every["-after"] = results_of(change.after)
        return _written(folder, every, kept, fits.lost, partial(map_in_order, mapped))


def _processes(most: int, plan: Plan, keys: Collection[Key]) -> int:
    """Return a number of processes: no more than there are wavefronts, unless each may be of many tiles."""
    ranges = [key.range_mm for key in keys if key.range_mm is not None]
    if may_be_large(plan, min(ranges, default=None)):
        return most
    return min(most, len(keys))


@contextmanager
def _running(run: Run | Executor | None, workers: int, steps: Steps) -> Iterator[Run]:
    """Yield a map for the fits' tasks: a caller's run, or processes of this machine; this process if one is enough."""
    if isinstance(run, Executor):
        yield Executed(run)
    elif run is not None:
        yield run
    else:
        with Workers(workers, steps.heard) as processes:
            processes.warm_up(fit_task.__module__)
            yield processes


def _written(
    folder: Path,
    every: Mapping[str, Results],
    kept: KeptFits,
    lost: Sequence[str],
    mapped: Mapped,
) -> Results:
    """Write results, and return the results of the whole session with their folder.

    Completed fits are kept until all fits are made and written.

    Parameters
    ----------
    folder : folder of the whole session's results
    every : results by the suffix of their folder's name; "" for the whole session
    kept : completed fits
    lost : reasons why fits are missing
    mapped : draws PSFs
    """
    made = {wavefront.key for wavefront in every[""].wavefronts}
    if lost and kept_keys(folder) - made:
        raise FitError(
            f"{'; '.join(lost)}; {folder} holds earlier results of it, which stay; with fewer workers, {FIT_AGAIN}"
        )
    try:
        for end, results in every.items():
            results.write(folder.with_name(folder.name + end), mapped)
    except InputError as error:
        again = NOT_ALL_KEPT if kept.problem else FIT_AGAIN
        room = "make room and " if is_full(error) else ""
        raise InputError(f"{error}; {room}{again}") from error
    if not lost:
        kept.clear()
    return replace(every[""], folder=folder)


def first_view(observation: Observation, target: Target) -> TargetView:
    """Return the first photograph of an observation, for the search for a panel's pixels."""
    frame, pose = observation.frames[0], observation.poses[0].of_target(target.size_mm)
    return TargetView(
        observation.range_mm,
        observation.channel,
        frame.counts / frame.illumination,
        frame.used,
        pose.matrix,
    )


def _panel_findings(
    plan: Plan, target: Target, observations: Sequence[Observation]
) -> list[Finding]:
    """Report pixels of a panel that photographs show and the plan does not state.

    Raises
    ------
    DataError : the pixels are so clear that every fit would be wrong
    PlanError : the pixels contradict the panel of the plan
    """
    first = {o.key.whole: o for o in reversed(observations)}  # of many tiles, one
    views = [first_view(o, target) for o in first.values()]
    per_cell, seen = pixels_per_cell(plan, target), seen_pixels(views, target)
    if seen is None:
        return []
    if plan.target.pixels is None or per_cell is None:
        if seen.contrast > PLAIN_CONTRAST:
            raise DataError(seen.finding.text)
        return [seen.finding]
    refuse_other_pixels(plan.target.pixels, per_cell, seen)
    return []


def _noted(
    session: Session, plan: Plan, others: Sequence[Finding], change: Change | None
) -> list[Finding]:
    """Report contradictions between files and plan, altered pictures, damage to the session and a change of its lens."""
    changes = [] if change is None else [change]
    stated = contradictions(
        ((frame.file, frame.kind, frame.path) for frame in session.frames), plan
    )
    notes = [note for frame in session.frames for note in frame.meta.get("altered", ())]
    altered = [found("picture-altered", note=note) for note in notes]
    repairs = [
        found("session-mended", note=note) for note in session.warnings
    ]  # an import repeats the others here
    changed = [
        found("lens-changed", last_mm=one.last_mm, next_mm=one.next_mm) for one in changes
    ]
    return each_once([*stated, *altered, *others, *changed, *repairs, *unused(session)])


def _results(
    fits: Estimate,
    plan: Plan,
    checksum: str,
    noted: Sequence[Finding],
    made: MadeFrom,
    wanted: bool,
) -> Results:
    """Make results of all or some of a session's fits. wanted: whether the fits should determine best focus."""
    if fits.lens is not None:
        fits = replace(fits, lens=with_doubts(fits.lens, explained=not fits.incomplete))
    fits = with_model_error(fits)
    wavefronts, lens, numbers = as_wavefronts(fits), fits.lens, model_parts(fits, plan)
    findings = [*noted, *findings_of(fits, wavefronts, numbers, plan, made.patience_s)]
    focus = None if lens is None else as_focus(lens, turned_lenses(fits))
    wanted = wanted and any(w.range_mm is not None and w.defocus for w in wavefronts)
    results = Results(
        plan=plan,
        plan_sha256=checksum,
        wavefronts=wavefronts,
        focus=focus,
        lens=None
        if lens is None
        else replace(as_lens(lens), wavelengths_nm=wavelengths_nm(lens, plan)),
        budget={} if lens is None else budget(lens),
        model_parts=numbers,
        parts_tried=fits.tried,
        widest_light_nm=widest_light_nm(fits, plan),
        common=common_numbers(fits),
        field=as_field(fits, plan),
        findings=tuple(findings),
        unanswered=unanswered(findings)
        if (fits.lost and not made.failed_accepted) or (wanted and focus is None)
        else None,
        made_from=made,
    )
    geometry = session_geometry(results)
    return replace(results, geometry=None if geometry is None else geometry.image)


def _opened(
    session: Session | Path | str,
    plan: Plan | Path | str | None,
    noll: tuple[int, int] | None,
) -> tuple[Session, Plan, str]:
    """Open the session; return session, plan and the plan's checksum. Raise SessionError for altered photographs or plans."""
    session = session if isinstance(session, Session) else Session.open(session)
    chosen = (
        session.plan
        if plan is None
        else plan
        if isinstance(plan, Plan)
        else Plan.load(Path(plan))
    )
    if damage := altered_files(session):
        raise SessionError(as_error(damage))
    chosen = chosen if noll is None else chosen.replace(fit={"zernike_noll": noll})
    used = with_body_filters(session, with_shown_size(session, chosen))
    return session, used, _checksum(session, chosen)


def _checksum(session: Session, plan: Plan) -> str:
    """Return the SHA-256 of the session's plan.toml, or of the TOML of a plan given instead."""
    if plan == session.plan:
        return sha256_of(session.folder / PLAN_FILE)
    return hashlib.sha256(plan.to_toml().encode()).hexdigest()


def _refuse_loss(folder: Path, keys: Collection[Key]) -> None:
    """Raise DataError if a folder holds results other than those of some keys, which would be lost."""
    if lost := sorted(key for key in kept_keys(folder) if key.whole not in keys):
        names = ", ".join(key.label for key in lost)
        raise DataError(
            f"{folder} holds {names} too, which this fit would not replace: give it another name (--name)"
        )


def _partial_name(ranges_mm: Ranges, channels: Channels) -> str:
    """Return a name for results of some ranges and channels, such as 3300mm-R."""
    ranges = [] if ranges_mm is None else np.atleast_1d(ranges_mm).tolist()
    names = [channels] if isinstance(channels, str) else channels or ()
    return "-".join([*(f"{range_mm:.10g}mm" for range_mm in ranges), *names])


def _set_aside(folder: Path) -> list[Finding]:
    """Set a corrupt results.json aside, and report that."""
    aside = set_aside_corrupt(folder)
    return [] if aside is None else [found("results-corrupt", aside=str(aside))]
