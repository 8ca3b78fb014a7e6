"""A camera on the simulated bench: photographs its display from its rail's position. Writes DNG."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import (
    CameraInfo,
    ExposureSettings,
    PanelInfo,
    Picture,
    RawFrame,
)
from labkit.devices.test_patterns import pattern
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.device import SimulatedDevice
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.drivers.simulated.setup import shared_bench
from labkit.errors import CameraError, DeviceTimeoutError
from labkit.plan import Plan


def open_camera(address: str, plan: Plan, context: DeviceContext) -> SimulatedCamera:
    """Open the camera of the context's bench. Raises PlanError."""
    bench = shared_bench(context, address, plan)
    return SimulatedCamera(bench.part, release=bench.close)


class SimulatedCamera(SimulatedDevice):
    """A Camera that can also cover its own lens."""

    def __init__(
        self,
        bench: Bench,
        timeout_s: float = 10.0,
        release: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(bench, release)
        self._timeout_s = timeout_s
        self._settings: ExposureSettings | None = None

    def identify(self) -> CameraInfo:
        """Return the model and the bench's seed, after plugging the camera in again if necessary."""
        self._bench.camera_present = True
        return CameraInfo(
            model="labkit simulated bench",
            serial=str(self._bench.settings.seed),
            driver="simulated",
        )

    def configure(self, settings: ExposureSettings) -> None:
        """Set shutter time and ISO. Raises CameraError if the connection is lost."""
        self._refuse_absent()
        self._settings = settings

    def expose(self, path: Path) -> RawFrame:
        """Expose once into `path` plus ".dng" (or ".tif" without a mosaic)."""
        self._refuse_absent()
        if self._settings is None:
            raise CameraError(
                "the simulated camera was not configured: set exposure time and ISO first"
            )
        match self._bench.trouble("camera"):
            case "timeout":
                self._bench.wait(self._timeout_s)
                raise DeviceTimeoutError(
                    f"no picture came from the simulated camera within {self._timeout_s:g} s"
                )
            case "unplug":
                self._bench.camera_present = False
                self._settings = None
                raise CameraError(
                    "the simulated camera dropped off USB while exposing; look at its cable"
                )
            case "card_full":
                raise CameraError("the simulated camera's card is full; empty it")
        return self._write(path, self._settings)

    def see(self, picture: Picture) -> None:
        """Put the picture of another driver's display on the bench's glass."""
        self._bench.light(
            pattern(picture, self._panel) if isinstance(picture, str) else picture
        )

    @property
    def _panel(self) -> PanelInfo:
        panel = self._bench.settings.panel
        return PanelInfo(panel.pixels, panel.pitch_mm)

    def cover(self, closed: bool) -> None:
        """Put the cap on the lens, or take it off."""
        self._bench.covered = closed

    def close(self) -> None:
        """Release the camera; again does nothing."""
        self._settings = None
        super().close()

    def _refuse_absent(self) -> None:
        if not self._bench.camera_present:
            raise CameraError("the simulated camera is not on USB; plug it in")

    def _write(self, path: Path, settings: ExposureSettings) -> RawFrame:
        sensor = self._bench.settings.sensor
        file = path.with_name(path.name + (".tif" if sensor.pattern == "mono" else ".dng"))
        if file.exists():
            raise CameraError(f"{file} is there already; photographs are never overwritten")
        counts = self._bench.expose(settings.exposure_s, settings.iso, file.name)
        tags = RawTags(
            pattern=sensor.pattern,
            black_level=sensor.black_level,
            white_level=sensor.white_level,
            exposure_s=settings.exposure_s,
            iso=settings.iso,
            taken=datetime.now(),
        )
        write_raw(file, counts, tags)
        return RawFrame(file, settings.exposure_s, settings.iso)
