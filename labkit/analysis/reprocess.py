"""Fit many sessions again as one stream of fits: results that are up to date are skipped, failures are named."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from labkit.analysis.fit import fit
from labkit.analysis.inputs import why_outdated
from labkit.errors import DataError, LabkitError, NewerError, WorkersError
from labkit.estimation.searches import fit_task
from labkit.jobs.execute import Executed, Run, Workers, default_workers
from labkit.jobs.threads import one_thread
from labkit.results.storage import accept_failed_fits, kept_content, plan_of
from labkit.session.session import Session
from labkit.storage.files import check_name, is_full
from labkit.types import Progress, no_progress

State = Literal["up to date", "to do", "fitted", "failed", "skipped"]

AT_ONCE = 4
"""Sessions under way at once, at most: their photographs are in memory."""


@dataclass(frozen=True)
class Reprocessed:
    """The end of one session in a job.

    Attributes
    ----------
    session : its folder
    state : "up to date", "to do" (a fit is due), "fitted", "failed" (a fit is still due), or "skipped" (results are of a
        newer labkit)
    why : reason for the state
    fits : number of wavefronts in the results; 0 without results
    seconds : time of the fits
    """

    session: Path
    state: State
    why: str
    fits: int = 0
    seconds: float = 0.0
    settings: dict[str, Any] = field(default_factory=dict, repr=False)

    def as_json(self) -> dict[str, Any]:
        """Return the row as JSON."""
        return {
            "session": str(self.session),
            "state": self.state,
            "why": self.why,
            "fits": self.fits,
            "seconds": round(self.seconds, 1),
        }


@one_thread
def reprocess(
    sessions: Iterable[Path | str],
    *,
    name: str = "latest",
    force: bool = False,
    dry_run: bool = False,
    accept_failed: bool = False,
    workers: int | None = None,
    run: Run | Executor | None = None,
    progress: Progress = no_progress,
) -> tuple[Reprocessed, ...]:
    """Fit sessions again whose results of a name are missing or out of date, with the settings of those results.

    The fits of all sessions are one stream: idle workers start on the next session. Every
    fit is kept as it ends, so the same call continues after an interruption.

    Parameters
    ----------
    sessions : their folders
    name : name of the results in each session
    force : whether to fit again if results are up to date
    dry_run : whether only to report, without fits or files
    accept_failed : whether to accept results without failed fits; else the session stays "failed"
    workers : number of processes, by default one for each core
    run : an executor of `concurrent.futures`, or any `labkit.jobs.execute.Run`, in place of processes of this machine
    progress : called with the step under way; steps are sessions

    Returns
    -------
    A row for each session, in the order given. A session that cannot be fitted is a row too.

    Raises
    ------
    DataError
        There are no sessions, or one is given twice.
    WorkersError
        The workers, or their scheduler, are gone.
    InputError
        The disk is full.

    >>> for row in labkit.reprocess(["night-1", "night-2"]):
    ...     print(row.session, row.state, row.why)
    """
    folders = [Path(session) for session in sessions]
    _refuse_doubled(folders)
    rows = [_examined(folder, name, force, accept_failed, dry_run) for folder in folders]
    if dry_run:
        return tuple(rows)
    left = [k for k, row in enumerate(rows) if row.state == "to do"]
    with _running(run, workers, bool(left)) as (mapped, at_once):
        stream = _Stream(mapped, name, accept_failed, progress, len(left))
        tasks = [rows[k] for k in left]
        for k, row in zip(left, _each(stream, tasks, at_once), strict=True):
            rows[k] = row
    return tuple(rows)


def _refuse_doubled(folders: Sequence[Path]) -> None:
    """Raise DataError for no sessions, and for a session given twice."""
    if not folders:
        raise DataError("no session: give one folder or more")
    known = set[Path]()
    for folder in folders:
        if (real := folder.resolve()) in known:
            raise DataError(f"{folder} is given twice: give each session once")
        known.add(real)


def _examined(
    folder: Path, name: str, force: bool, accept_failed: bool, dry_run: bool
) -> Reprocessed:
    """Return the work due for a session; record the acceptance of failed fits."""
    try:
        session = Session.open(folder)
        results = session.folder / "results" / check_name(name)
        try:
            content = kept_content(results)
        except ValueError:
            return Reprocessed(folder, "to do", "its results.json cannot be read")
        if content is None:
            return Reprocessed(folder, "to do", "no results yet")
        made = content.made_from
        settings = {} if made is None else made.settings
        if made is not None and not made.own_plan:
            settings["plan"] = plan_of(content, results)
        why = why_outdated(content, session, accept_failed)
    except NewerError as error:
        return Reprocessed(folder, "skipped", str(error))
    except (LabkitError, OSError) as error:
        return Reprocessed(folder, "failed", str(error))
    fits = len(content.wavefronts)
    if why or force:
        return Reprocessed(folder, "to do", why or "--force", fits, 0.0, settings)
    if made is not None and made.failed:
        if not (dry_run or made.failed_accepted):
            accept_failed_fits(results)
        why = f"accepted without failed fits: {'; '.join(made.failed)}"
        return Reprocessed(folder, "up to date", why, fits)
    return Reprocessed(folder, "up to date", "nothing has changed", fits)


@contextmanager
def _running(
    run: Run | Executor | None, workers: int | None, needed: bool
) -> Iterator[tuple[Run, int]]:
    """Yield a map for all fits, and the number of sessions under way at once."""
    if isinstance(run, Executor):
        yield Executed(run), AT_ONCE
    elif run is not None:
        yield run, AT_ONCE
    else:
        count = (workers or default_workers()) if needed else 1
        with Workers(count) as processes:
            processes.warm_up(fit_task.__module__)
            # with one worker fits run in this process, one session after the other
            yield processes, min(count, AT_ONCE)


def _each(
    stream: _Stream, rows: Sequence[Reprocessed], at_once: int
) -> Iterator[Reprocessed]:
    """Yield the row that each session ends with, in order."""
    if at_once == 1:
        yield from map(stream.fitted, rows)
        return
    threads = ThreadPoolExecutor(at_once, thread_name_prefix="labkit-session")
    try:
        yield from threads.map(stream.fitted, rows)
    finally:
        stream.stopped = True
        # the workers end after this: threads of sessions under way end with them
        threads.shutdown(wait=False, cancel_futures=True)


@dataclass
class _Stream:
    """Sessions under way, which share one run. stopped: whether no further session is begun."""

    run: Run
    name: str
    accept_failed: bool
    progress: Progress
    total: int
    done: int = 0
    stopped: bool = False

    def __post_init__(self) -> None:
        self._lock = threading.Lock()

    def fitted(self, row: Reprocessed) -> Reprocessed:
        """Fit a session and return its row. Raises errors that concern all sessions."""
        if self.stopped:
            return row
        try:
            results = fit(
                row.session,
                run=self.run,
                name=self.name,
                accept_failed=self.accept_failed,
                progress=self._step_of(row.session),
                **row.settings,
            )
        except LabkitError as error:
            if isinstance(error, WorkersError) or is_full(error):
                self.stopped = True
                raise
            return replace(row, state="failed", why=str(error))
        finally:
            self.done += 1
        made = results.made_from
        assert made is not None
        seconds = sum(wavefront.seconds for wavefront in results)
        ended = replace(row, state="fitted", fits=len(results), seconds=seconds)
        if made.failed and not made.failed_accepted:
            return replace(ended, state="failed", why="; ".join(made.failed))
        return ended

    def _step_of(self, session: Path) -> Callable[[int, int, str], None]:
        """Return the progress of one session among all."""

        def report(done: int, total: int, step: str) -> None:
            with self._lock:
                self.progress(self.done, self.total, f"{session.name}: {step}")

        return report
