"""The devices of a capture with patience: passing trouble is noted and got over, lasting trouble is raised."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from labkit.acquisition.log import CaptureLog
from labkit.acquisition.sequence import Shot, bench_settings
from labkit.devices.context import Devices
from labkit.devices.protocols import (
    Coverable,
    ExposureSettings,
    Picture,
    PictureChecking,
    PositionChecking,
    RawFrame,
    SelfRecovering,
)
from labkit.errors import DeviceError, DisplayError, RailLimitError
from labkit.plan import Plan
from labkit.storage.files import writing

Result = TypeVar("Result")

DEVICE_TRIES = 3
"""How often a device may fail at one step before the capture stops."""


class PatientDevices:
    """Camera, rail and display, each tried again on trouble, with the carriage's place.

    Positions count from the last homing, so each is recorded with the number of its homing.
    folder: a camera writes its photograph there; the folder is emptied before each. Every
    method raises DeviceError if trouble lasts.
    """

    def __init__(self, plan: Plan, devices: Devices, log: CaptureLog, folder: Path) -> None:
        self.devices = devices
        self._camera, self._rail = bench_settings(plan)
        self._log = log
        self._folder = folder
        self._standing: tuple[float, dict[str, Any]] | None = None
        self._homing: int | None = None
        self._exposure_s = self._camera.exposure_s

    @property
    def can_cover(self) -> bool:
        """Return whether the camera covers its own lens."""
        return isinstance(self.devices.camera, Coverable)

    def cover(self, closed: bool) -> None:
        """Cover the lens, or uncover it, if the camera can."""
        if isinstance(self.devices.camera, Coverable):
            self.devices.camera.cover(closed)

    def home(self) -> None:
        """Home the rail."""
        self._log.step("homing the rail")
        self._try("rail", self._home, lambda: None)

    def ready(self) -> None:
        """Find the camera and set it."""
        self._log.step("setting the camera")
        self._try("camera", self._ready_camera, lambda: None)

    def expose_for(self, exposure_s: float) -> None:
        """Set the exposure time of the next photographs, if it is another."""
        if exposure_s != self._exposure_s:
            self._exposure_s = exposure_s
            self.ready()

    def show(self, picture: Picture) -> None:
        """Show a picture."""
        self._try("display", lambda: self.devices.display.show(picture), lambda: None)

    def go_to(self, range_mm: float) -> dict[str, Any]:
        """Move to a range, unless the carriage is there, and settle. Return the place for the frame's meta."""
        if self._standing is not None and self._standing[0] == range_mm:
            return self._standing[1]
        self._standing = None
        self._log.step(f"moving to {range_mm:g} mm")
        rail = self.devices.rail
        position_mm = self._rail.position_mm(range_mm)
        at_mm = self._try("rail", lambda: rail.move_to(position_mm), self._home)
        self.devices.wait(self._rail.settle_s)
        measured_mm = self._rail.range_mm(at_mm)
        meta = {
            "position_mm": round(at_mm, 6),
            "measured_range_mm": round(measured_mm, 6),
            "homing": self._homing,
        }
        self._log.note("moved", range_mm=range_mm, **meta)
        self._standing = range_mm, meta
        return meta

    def photograph_in_place(
        self, picture: Picture, shot: Shot
    ) -> tuple[RawFrame, dict[str, Any]]:
        """Photograph at the shot's range, again if the rail moved. Return the file and the place for its meta."""
        if shot.range_mm is None:
            return self.photograph(picture, shot.name), {}
        rail = self.devices.rail
        for attempt in range(1, DEVICE_TRIES + 1):
            meta = self.go_to(shot.range_mm)
            raw = self.photograph(picture, shot.name)
            try:
                if isinstance(rail, PositionChecking):
                    rail.check_still()
                return raw, meta
            except DeviceError as error:
                self._standing = None
                self._log.note(
                    "trouble",
                    device="rail",
                    attempt=attempt,
                    error=f"after {shot.name}: {error}",
                )
                if attempt == DEVICE_TRIES:
                    raise
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _note_recovered(self, device: str) -> None:
        """Report faults that a device recovered from by itself."""
        of = getattr(self.devices, device)
        for error in of.recovered() if isinstance(of, SelfRecovering) else ():
            self._log.note("overcome", device=device, error=error)

    def photograph(self, picture: Picture, name: str) -> RawFrame:
        """Expose, again if the display lost its picture meanwhile.

        name: of the file, without suffix
        """
        display = self.devices.display
        for attempt in range(1, DEVICE_TRIES + 1):
            raw = self._try("camera", lambda: self._expose(name), self._ready_camera)
            if not isinstance(display, PictureChecking) or self._try(
                "display", display.undisturbed, lambda: None
            ):
                return raw
            self._log.note(
                "trouble",
                device="display",
                attempt=attempt,
                error=f"lost its picture during {name}",
            )
            self.show(picture)
        raise DisplayError(
            f"the display lost its picture during {name}, {DEVICE_TRIES} times in a row; look at it"
        )

    def _home(self) -> None:
        self.devices.rail.home()
        self._homing = self._log.homed()

    def _ready_camera(self) -> None:
        """Find the camera, again if the connection was lost, and set it."""
        info = self.devices.camera.identify()
        self.devices.camera.configure(ExposureSettings(self._exposure_s, self._camera.iso))
        self._log.note("camera", model=info.model, serial=info.serial, driver=info.driver)

    def _expose(self, name: str) -> RawFrame:
        """Expose into a temporary folder: only a whole photograph enters the session."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with writing(self._folder):
            self._folder.mkdir()
        return self.devices.camera.expose(self._folder / name)

    def _try(
        self, device: str, action: Callable[[], Result], recover: Callable[[], object]
    ) -> Result:
        """Use a device; on trouble recover and try again, a bounded number of times."""
        for attempt in range(1, DEVICE_TRIES + 1):
            try:
                if attempt > 1:
                    recover()
                result = action()
                self._note_recovered(device)
                return result
            except RailLimitError:
                raise
            except DeviceError as error:
                self._note_recovered(device)
                self._log.note("trouble", device=device, attempt=attempt, error=str(error))
                if attempt == DEVICE_TRIES:
                    raise
        raise AssertionError("unreachable: the last attempt returns or raises")
