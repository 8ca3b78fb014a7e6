"""Run a plan on a bench: at each range flats of the white panel and photographs of the target, then darks.

Every photograph is committed to the session before the next is taken, so an interrupted
capture continues with the missing photographs. A frame's `range_mm` is the plan's number,
the same for all frames of a station. The frame's meta holds the measured place of the
carriage as `position_mm` and `measured_range_mm`, and the number of the session's homing as
`homing`: each homing has its own range zero.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from labkit.acquisition.log import CaptureLog
from labkit.acquisition.patient import PatientDevices
from labkit.acquisition.preflight import preflight
from labkit.acquisition.sequence import (
    Shot,
    bench_settings,
    missing,
    next_command,
    picture_for,
    shots,
)
from labkit.devices.context import Devices
from labkit.devices.protocols import Picture, RawFrame
from labkit.errors import (
    DataError,
    DeviceError,
    InputError,
    LabkitError,
    PlanError,
    RawError,
)
from labkit.finder.cut import cut_around
from labkit.panel.picture import PanelPicture
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import exposure_problem
from labkit.photographs.photograph import WHOLE, Photograph
from labkit.plan import Plan
from labkit.session.session import EXPOSING_FOLDER, Session, begin
from labkit.target.target import open_target
from labkit.types import Floats, Progress, no_progress

Ask = Callable[[str], object]
"""Asks a person to do something, and returns when it is done."""

REJECTED = "rejected"


def capture(
    plan: Plan | Path | str,
    bench: Devices,
    folder: Path | str,
    *,
    resume: bool = False,
    progress: Progress | None = None,
    ask: Ask | None = None,
    warn: Callable[[str], None] | None = None,
    check: bool = True,
) -> Session:
    """Run a plan into a new session folder and return the session, to read.

    Parameters
    ----------
    plan : or its path
    bench : open devices
    folder : of the session
    resume : whether to continue the session if the folder exists
    progress, ask, warn, check : as in `run_plan`

    Raises
    ------
    SessionError
        the folder is in use
    DeviceError, DataError, TargetError, RawError, PlanError
        as in `run_plan`

    >>> with labkit.open_devices(plan) as bench:
    ...     session = labkit.capture(plan, bench, "night-3")
    """
    with begin(plan, folder, resume) as session:
        run_plan(session, bench, progress=progress, ask=ask, warn=warn, check=check)
    return Session.open(folder)


def run_plan(
    session: Session,
    devices: Devices,
    *,
    progress: Progress | None = None,
    ask: Ask | None = None,
    warn: Callable[[str], None] | None = None,
    check: bool = True,
) -> None:
    """Take all photographs that the session still lacks.

    Device trouble is tried again up to three times. After any error, Ctrl-C included,
    another call continues the session.

    Parameters
    ----------
    session : open to append
    ask : asks a person to cover the lens, if the camera cannot
    warn : called with each remark that only a person can check
    check : whether to run the preflight first

    Raises
    ------
    DeviceError
        trouble that lasts
    DataError
        a photograph is useless (and kept in SESSION/rejected)
    TargetError, RawError, PlanError
        as their names say
    """
    total = len(shots(session.plan))
    done = total - len(missing(session))
    log = CaptureLog(session, devices.observers, progress or no_progress, done, total)
    try:
        _Capture(session, devices, log, ask).run(check, warn)
    except KeyboardInterrupt as interrupt:
        with suppress(
            DeviceError
        ):  # homing, at the next start, mends a rail that did not even stop
            devices.rail.stop()
        log.note("interrupted", by=str(interrupt) or "Ctrl-C")
        raise
    except LabkitError as error:
        log.show("stopped", error=str(error))
        raise
    finally:
        shutil.rmtree(session.folder / EXPOSING_FOLDER, ignore_errors=True)


def _drawn_otherwise(plan: Plan, picture: PanelPicture) -> str | None:
    """Return a warning if the panel's whole pixels change the target's size by more than the plan's error."""
    asked_mm = open_target(plan.target).size_mm[0]
    drawn_mm = picture.size_mm[0]
    stated = plan.target.stated_size
    if abs(drawn_mm / asked_mm - 1) <= stated.std / stated.value:
        return None
    return f"in whole pixels the target is {drawn_mm:.5g} mm high instead of {asked_mm:.5g}; a fit uses what was shown"


class _Capture:
    """One run: the photographs in their order, and what is kept."""

    def __init__(
        self, session: Session, devices: Devices, log: CaptureLog, ask: Ask | None
    ) -> None:
        self._session = session
        self._devices = devices
        self._log = log
        self._ask = ask
        self._patient = PatientDevices(
            session.plan, devices, log, session.folder / EXPOSING_FOLDER
        )
        self._first: Photograph | None = None
        self._corners_px: list[Floats] = []  # of the targets that the preflight found

    def run(self, check: bool, warn: Callable[[str], None] | None) -> None:
        todo = missing(self._session)
        if not todo:
            return
        target = picture_for(self._session.plan, self._devices)
        for frame in self._session.frames[:1]:
            self._first = read_photograph(frame.path, self._session.plan.sensor)
        darks = [shot for shot in todo if shot.kind == "dark"]
        stations = list(
            dict.fromkeys(shot.range_mm for shot in todo if shot.range_mm is not None)
        )
        if darks:
            self._refuse_uncapped()
        self._log.note(
            "began",
            missing=len(todo),
            total=self._log.total,
            shown_size_mm=target.size_mm,
            **({} if target.pitch_mm is None else {"shown_pitch_mm": target.pitch_mm}),
        )
        if warn and (words := _drawn_otherwise(self._session.plan, target)):
            warn(words)
        if check:
            self._look_round(target, stations, len(todo), warn)
        if not check or self._session.plan.noise is not None:
            self._patient.ready()
            if stations:
                self._patient.home()
        self._take_darks(darks)
        for range_mm in stations:
            here = [shot for shot in todo if shot.range_mm == range_mm]
            self._patient.go_to(range_mm)
            self._take("white", [shot for shot in here if shot.kind == "flat"])
            self._take(target.grey, [shot for shot in here if shot.kind == "target"])
        self._log.note("complete")
        self._log.show(
            "next", command=next_command(self._session.plan, self._session.folder)
        )

    def _look_round(
        self,
        target: PanelPicture,
        stations: list[float],
        frames: int,
        warn: Callable[[str], None] | None,
    ) -> None:
        """Run the preflight; finish at the capture's first range if this range is an end of the rail."""
        ends = (
            sorted(
                {min(stations), max(stations)}, key=lambda range_mm: range_mm == stations[0]
            )
            if stations and self._session.plan.noise is None
            else []
        )
        findings = preflight(
            self._session.plan,
            self._patient,
            self._log,
            picture=target,
            ends_mm=ends,
            frames=frames,
            folder=self._session.folder,
        )
        if warn and findings.by_hand:
            warn(f"check by hand: {'; '.join(findings.by_hand)}")
        self._log.note(
            "preflight",
            problems=[str(error) for error in findings.problems],
            by_hand=findings.by_hand,
            measured=findings.measured,
        )
        self._corners_px = findings.corners_px
        findings.raise_problems()

    def _take_darks(self, todo: list[Shot]) -> None:
        if not todo:
            return
        self._cover(True)
        try:
            self._take("black", todo)
        except BaseException:
            self._patient.cover(False)  # but no trouble waits for a person
            raise
        self._cover(False)

    def _cover(self, closed: bool) -> None:
        if self._patient.can_cover:
            self._patient.cover(closed)
        elif self._ask is not None:
            self._ask("Put the cap on the lens" if closed else "Take the cap off the lens")

    def _refuse_uncapped(self) -> None:
        if self._ask is None and not self._patient.can_cover:
            camera, _ = bench_settings(self._session.plan)
            raise PlanError(
                f"camera.darks = {camera.darks}: dark frames need someone to cap the lens; "
                f"run this at a terminal or with --monitor, or set camera.darks = 0"
            )

    def _take(self, picture: Picture, todo: list[Shot]) -> None:
        if not todo:
            return
        self._log.step("showing " + (picture if isinstance(picture, str) else "the target"))
        self._patient.show(picture)
        camera, _ = bench_settings(self._session.plan)
        for shot in todo:
            self._log.step(f"taking {shot.name}")
            self._patient.expose_for(shot.exposure_s or camera.exposure_s)
            self._keep(*self._patient.photograph_in_place(picture, shot), shot)

    def _keep(self, raw: RawFrame, meta: dict[str, Any], shot: Shot) -> None:
        """Commit a photograph, or put a useless one aside and raise its error."""
        try:
            mosaic = self._checked(raw.path, shot)
        except InputError as problem:
            aside = _set_aside(raw.path, self._session.folder / REJECTED)
            self._log.note(
                "rejected",
                file=str(aside.relative_to(self._session.folder)),
                reason=str(problem),
            )
            raise
        meta = {**raw.meta, **meta, "exposure_s": raw.exposure_s, "iso": raw.iso}
        self._session.add_frame(raw.path, raw.path.name, shot.kind, shot.range_mm, **meta)
        self._log.took(shot, mosaic)

    def _checked(self, path: Path, shot: Shot) -> Photograph:
        """Return a photograph, decoded. Raises RawError or DataError for a useless one."""
        plan = self._session.plan
        mosaic = read_photograph(path, plan.sensor)
        ladder = (
            shot.kind == "flat" and shot.exposure_s is not None
        )  # dim and full ones too
        names = [channel.name for channel in plan.channel]
        place = WHOLE
        if self._corners_px:
            place = cut_around(self._corners_px, mosaic.shape)
        problem = None if ladder else exposure_problem(mosaic, shot.kind, names, place)
        first = self._first = self._first or mosaic
        if _likeness(mosaic) != _likeness(first):
            raise RawError(
                f"{shot.name}, just taken, is {_likeness(mosaic)}; the session's frames are {_likeness(first)}"
            )
        if problem:
            camera, _ = bench_settings(plan)
            raise DataError(
                f"{shot.name}, just taken, {problem} ({camera.exposure_s:g} s was set)"
            )
        return mosaic


def _likeness(mosaic: Photograph) -> str:
    rows, cols = mosaic.counts.shape
    return f"{rows} × {cols} {mosaic.cfa} of {mosaic.camera or 'an unnamed camera'}"


def _set_aside(file: Path, folder: Path) -> Path:
    """Move a file into a folder under a free name."""
    folder.mkdir(exist_ok=True)
    numbered = (folder / f"{file.stem}-{number}{file.suffix}" for number in count(1))
    aside = next(
        path for path in chain([folder / file.name], numbered) if not path.exists()
    )
    file.rename(aside)
    return aside
