"""Runs a plan on a bench: darks once, then at every range flats of the white panel and photographs of the target.

Every photograph is committed to the session before the next is taken, so whatever interrupts a capture, it goes on with
just what is missing. A frame's `range_mm` is the plan's number, the same for all frames of a stop; where the
carriage was measured to stand is in the frame's meta, as `position_mm` and `measured_range_mm`.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any, TypeVar

from labkit.capture.preflight import Hands, preflight
from labkit.capture.sequence import Shot, bench_settings, missing, picture_for, shots
from labkit.devices.context import Devices
from labkit.devices.panel_image import PanelPicture
from labkit.devices.protocols import Attentive, Coverable, ExposureSettings, Picture, RawFrame, Steadfast
from labkit.errors import (
    DataError,
    DeviceError,
    DisplayError,
    InputError,
    LabkitError,
    PlanError,
    RailLimitError,
    RawError,
)
from labkit.files import writing
from labkit.raw.decode import read_raw
from labkit.raw.frame_quality import exposure_problem
from labkit.raw.mosaic import Mosaic
from labkit.session.session import EXPOSING, Session
from labkit.types import Progress

Result = TypeVar("Result")

Ask = Callable[[str], object]
"""Asks a person to do something, and returns when it is done."""

REJECTED = "rejected"

TRIES = 3
"""How often a device may fail at one step before the capture stops."""


def capture(
    session: Session,
    devices: Devices,
    *,
    progress: Progress | None = None,
    ask: Ask | None = None,
    warn: Callable[[str], None] | None = None,
    check: bool = True,
) -> None:
    """Take every photograph that the session still lacks. The session is open to append.

    ask: how to ask a person for the lens cap, where the camera has none of its own; warn: is told what only a person can
    check; check: look first whether all is right (`preflight`). Device trouble is tried again
    up to three times. Raises DeviceError, DataError for a photograph that is useless (kept in SESSION/rejected),
    TargetError, RawError, PlanError; whatever is raised, Ctrl-C too, calling it again goes on from there.
    """
    try:
        _Capture(session, devices, progress, ask).run(check, warn)
    except KeyboardInterrupt:
        with suppress(DeviceError):  # homing, at the next start, mends a rail that did not even stop
            devices.rail.stop()
        session.log("interrupted")
        _tell(devices, "interrupted")
        raise
    except LabkitError as error:
        _tell(devices, "stopped", error=str(error))
        raise
    finally:
        shutil.rmtree(session.folder / EXPOSING, ignore_errors=True)


class _Capture:
    """One run: the devices, and what is known of where they stand."""

    def __init__(self, session: Session, devices: Devices, progress: Progress | None, ask: Ask | None) -> None:
        self._session = session
        self._devices = devices
        self._progress = progress
        self._ask = ask
        self._camera, self._rail = bench_settings(session.plan)
        self._total = len(shots(session.plan))
        self._done = 0
        self._first: Mosaic | None = None
        self._latest: Mosaic | None = None
        self._standing: tuple[float, dict[str, Any]] | None = None

    def run(self, check: bool, warn: Callable[[str], None] | None) -> None:
        todo = missing(self._session)
        if not todo:
            return
        self._done = self._total - len(todo)
        target = picture_for(self._session.plan, self._devices)
        for frame in self._session.frames[:1]:
            self._first = read_raw(frame.path, self._session.plan.sensor)
        darks = [shot for shot in todo if shot.kind == "dark"]
        stops = list(dict.fromkeys(shot.range_mm for shot in todo if shot.range_mm is not None))
        if darks:
            self._refuse_uncapped()
        self._note("began", missing=len(todo), total=self._total, shown_size_mm=target.size_mm)
        if check:
            self._look_round(target, stops, len(todo), warn)
        else:
            self._ready_camera_patiently()
            if stops:
                self._home()
        self._take_darks(darks)
        for range_mm in stops:
            here = [shot for shot in todo if shot.range_mm == range_mm]
            self._go_to(range_mm)
            self._take("white", [shot for shot in here if shot.kind == "flat"])
            self._take(target.grey, [shot for shot in here if shot.kind == "target"])
        self._note("complete")

    def _look_round(
        self, target: PanelPicture, stops: list[float], frames: int, warn: Callable[[str], None] | None
    ) -> None:
        """The preflight; ends where the capture begins, if that is at an end of the rail."""
        ends = sorted({min(stops), max(stops)}, key=lambda range_mm: range_mm == stops[0]) if stops else []
        found = preflight(
            self._session.plan,
            self._devices,
            Hands(self._ready_camera_patiently, self._home, self._go_to, self._show, self._photograph_to_look_at),
            picture=target,
            ends_mm=ends,
            frames=frames,
            folder=self._session.folder,
        )
        if warn and found.by_hand:
            warn(f"check by hand: {'; '.join(found.by_hand)}")
        self._note(
            "preflight",
            problems=[str(error) for error in found.problems],
            by_hand=found.by_hand,
            measured=found.measured,
        )
        found.raise_problems()

    def _photograph_to_look_at(self, name: str, picture: Picture) -> tuple[Path, Mosaic]:
        self._step(f"taking {name}")
        path = self._photograph(picture, Shot(name, "target", None)).path
        return path, read_raw(path, self._session.plan.sensor)

    def _home(self) -> None:
        self._step("homing the rail")
        self._try("rail", self._devices.rail.home, lambda: None)

    def _ready_camera_patiently(self) -> None:
        self._step("setting the camera")
        self._try("camera", self._ready_camera, lambda: None)

    def _ready_camera(self) -> None:
        """Find the camera, again if it had dropped off, and set it."""
        info = self._devices.camera.identify()
        self._devices.camera.configure(ExposureSettings(self._camera.exposure_s, self._camera.iso))
        self._note("camera", model=info.model, serial=info.serial, driver=info.driver)

    def _go_to(self, range_mm: float) -> dict[str, Any]:
        """Move and settle, unless it stands there; what is to be noted of the place."""
        if self._standing is not None and self._standing[0] == range_mm:
            return self._standing[1]
        self._standing = None
        self._step(f"moving to {range_mm:g} mm")
        rail, asked_mm = self._devices.rail, self._rail.position_mm(range_mm)
        at_mm = self._try("rail", lambda: rail.move_to(asked_mm), rail.home)
        self._devices.wait(self._rail.settle_s)
        measured_mm = self._rail.range_mm(at_mm)
        meta = {"position_mm": round(at_mm, 6), "measured_range_mm": round(measured_mm, 6)}
        self._note("moved", range_mm=range_mm, **meta)
        self._standing = range_mm, meta
        return meta

    def _take_darks(self, todo: list[Shot]) -> None:
        if not todo:
            return
        self._cover(True)
        try:
            self._take("black", todo)
        except BaseException:
            if isinstance(self._devices.camera, Coverable):  # but no trouble waits for a person
                self._devices.camera.cover(False)
            raise
        self._cover(False)

    def _cover(self, closed: bool) -> None:
        camera = self._devices.camera
        if isinstance(camera, Coverable):
            camera.cover(closed)
        elif self._ask is not None:
            self._ask("Put the cap on the lens" if closed else "Take the cap off the lens")

    def _refuse_uncapped(self) -> None:
        if self._ask is None and not isinstance(self._devices.camera, Coverable):
            raise PlanError(
                f"camera.darks = {self._camera.darks}: dark frames need someone to cap the lens; "
                f"run this at a terminal or with --monitor, or set camera.darks = 0"
            )

    def _take(self, picture: Picture, todo: list[Shot]) -> None:
        if not todo:
            return
        self._step("showing " + (picture if isinstance(picture, str) else "the target"))
        self._show(picture)
        for shot in todo:
            self._step(f"taking {shot.name}")
            self._keep(*self._photograph_in_place(picture, shot), shot)

    def _show(self, picture: Picture) -> None:
        self._try("display", lambda: self._devices.display.show(picture), lambda: None)

    def _photograph_in_place(self, picture: Picture, shot: Shot) -> tuple[RawFrame, dict[str, Any]]:
        """Photograph at the shot's range, again if the rail did not stay there; what is to be noted of the place as well."""
        if shot.range_mm is None:
            return self._photograph(picture, shot), {}
        rail = self._devices.rail
        for attempt in range(1, TRIES + 1):
            meta = self._go_to(shot.range_mm)
            raw = self._photograph(picture, shot)
            try:
                if isinstance(rail, Steadfast):
                    rail.check_still()
                return raw, meta
            except DeviceError as error:
                self._standing = None
                self._note("trouble", device="rail", attempt=attempt, error=f"after {shot.name}: {error}")
                if attempt == TRIES:
                    raise
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _photograph(self, picture: Picture, shot: Shot) -> RawFrame:
        """Expose, again if the display lost its picture meanwhile."""
        display = self._devices.display
        for attempt in range(1, TRIES + 1):
            raw = self._try("camera", lambda: self._expose(shot), self._ready_camera)
            if not isinstance(display, Attentive) or self._try("display", display.undisturbed, lambda: None):
                return raw
            self._note("trouble", device="display", attempt=attempt, error=f"lost its picture during {shot.name}")
            self._show(picture)
        raise DisplayError(f"the display lost its picture during {shot.name}, {TRIES} times in a row; look at it")

    def _note(self, event: str, **fields: Any) -> None:
        """Into the journal, and to who looks on."""
        self._session.log(event, **fields)
        _tell(self._devices, event, **fields)

    def _step(self, doing: str) -> None:
        """A step begins, unless someone holds it back."""
        if self._progress:
            self._progress(self._done, self._total, doing)
        _tell(self._devices, "doing", what=doing)
        for observer in self._devices.observers:
            observer.may_go_on()

    def _expose(self, shot: Shot) -> RawFrame:
        """Into a folder that is thrown away: only a whole photograph gets into the session."""
        folder = self._session.folder / EXPOSING
        shutil.rmtree(folder, ignore_errors=True)
        with writing(folder):
            folder.mkdir()
        return self._devices.camera.expose(folder / shot.name)

    def _keep(self, raw: RawFrame, meta: dict[str, Any], shot: Shot) -> None:
        """Commit a photograph, or put it aside and raise if it is useless."""
        if problem := self._problem(raw.path, shot):
            aside = _set_aside(raw.path, self._session.folder / REJECTED)
            self._note("rejected", file=str(aside.relative_to(self._session.folder)), reason=str(problem))
            raise problem
        meta = {**raw.meta, **meta, "exposure_s": raw.exposure_s, "iso": raw.iso}
        self._session.add_frame(raw.path, raw.path.name, shot.kind, shot.range_mm, **meta)
        self._done += 1
        if self._progress:
            self._progress(self._done, self._total, shot.name)
        for observer in self._devices.observers:
            assert self._latest is not None
            observer.took(shot.name, shot.kind, shot.range_mm, self._latest, self._done, self._total)

    def _problem(self, path: Path, shot: Shot) -> InputError | None:
        """Why a photograph is useless, as the error to raise; None if it is good."""
        plan = self._session.plan
        what = f"{shot.name}, just taken,"
        try:
            mosaic = self._latest = read_raw(path, plan.sensor)
            problem = exposure_problem(mosaic, shot.kind, (channel.name for channel in plan.channel))
        except RawError as error:
            return error
        first = self._first = self._first or mosaic
        if _likeness(mosaic) != _likeness(first):
            return RawError(f"{what} is {_likeness(mosaic)}; the session's frames are {_likeness(first)}")
        if problem:
            return DataError(f"{what} {problem} ({self._camera.exposure_s:g} s was set)")
        return None

    def _try(self, device: str, action: Callable[[], Result], recover: Callable[[], object]) -> Result:
        """Do something with a device; on trouble recover and do it again, a bounded number of times."""
        for attempt in range(1, TRIES + 1):
            try:
                if attempt > 1:
                    recover()
                return action()
            except RailLimitError:
                raise
            except DeviceError as error:
                self._note("trouble", device=device, attempt=attempt, error=str(error))
                if attempt == TRIES:
                    raise
        raise AssertionError("unreachable: the last attempt returns or raises")


def _tell(devices: Devices, event: str, **fields: Any) -> None:
    for observer in devices.observers:
        observer.noted(event, **fields)


def _likeness(mosaic: Mosaic) -> str:
    rows, cols = mosaic.counts.shape
    return f"{rows} × {cols} {mosaic.cfa} of {mosaic.camera or 'an unnamed camera'}"


def _set_aside(file: Path, folder: Path) -> Path:
    """Move a file into a folder under a name that is free there."""
    folder.mkdir(exist_ok=True)
    numbered = (folder / f"{file.stem}-{number}{file.suffix}" for number in count(1))
    aside = next(path for path in chain([folder / file.name], numbered) if not path.exists())
    file.rename(aside)
    return aside
