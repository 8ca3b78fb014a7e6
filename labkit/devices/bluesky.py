"""Rail and camera as bluesky's RunEngine takes them: its protocols are kept without importing bluesky.

`RunEngine()(scan([camera], rail, 10.0, 200.0, 5))`, with `rail = ScanRail(...)` and `camera = ScanCamera(...)`. A scan's
positions are the rail's, in mm. The devices stay ours: open and close them around the scan.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from labkit.devices.protocols import Camera, Rail, RawFrame
from labkit.errors import DeviceTimeoutError

Reading = dict[str, Any]


class Step:
    """Something under way in a thread of its own: bluesky's Status."""

    def __init__(self, action: Callable[[], None], name: str) -> None:
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._callbacks: list[Callable[[Step], None]] = []
        self._error: BaseException | None = None
        self._action = action
        threading.Thread(target=self._run, name=name, daemon=True).start()

    @property
    def done(self) -> bool:
        """Return whether the step has ended, successfully or not."""
        return self._over.is_set()

    @property
    def success(self) -> bool:
        """Return whether the step ended successfully."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return the step's error or None, after waiting for its end.

        Raises DeviceTimeoutError if the step does not end in time.
        """
        if not self._over.wait(timeout):
            raise DeviceTimeoutError(f"still under way after {timeout:g} s")
        return self._error

    def add_callback(self, callback: Callable[[Step], None]) -> None:
        """Call a function with this step at its end; immediately if the step has ended."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def _run(self) -> None:
        try:
            self._action()
        except Exception as error:  # whatever it is, it is for the thread that waits
            self._error = error
        with self._lock:
            self._over.set()
        for callback in self._callbacks:
            callback(self)


class ScanRail:
    """A homed rail that a plan moves: bluesky's Movable, Stoppable, Locatable, Readable and Configurable.

    settle_s: wait after each move. `position` is the last measured position in mm.
    """

    parent = None

    def __init__(self, rail: Rail, name: str = "rail", settle_s: float = 1.0) -> None:
        self.name = name
        self._rail = rail
        self._settle_s = settle_s
        self._sent_to_mm = float("nan")
        self.position = float("nan")
        self._measured_at = time.time()

    def set(self, value: float) -> Step:
        """Move there, and settle."""
        self._sent_to_mm = float(value)
        return Step(self._move, f"{self.name} to {value:g} mm")

    def stop(self, *, success: bool = False) -> None:
        """Stop at once."""
        self._rail.stop()

    def locate(self) -> dict[str, float]:
        """Return the requested and the measured position."""
        return {"setpoint": self._sent_to_mm, "readback": self.position}

    def read(self) -> Reading:
        """Return the measured position."""
        return {self.name: {"value": self.position, "timestamp": self._measured_at}}

    def describe(self) -> Reading:
        """Describe the values of `read`."""
        return {
            self.name: {
                "source": "labkit rail",
                "dtype": "number",
                "shape": [],
                "units": "mm",
            }
        }

    def read_configuration(self) -> Reading:
        """Return the travel."""
        travel = self._rail.travel_mm
        value = [travel.low_mm, travel.high_mm]
        return {f"{self.name}_travel": {"value": value, "timestamp": self._measured_at}}

    def describe_configuration(self) -> Reading:
        """Describe the values of `read_configuration`."""
        return {
            f"{self.name}_travel": {
                "source": "labkit rail",
                "dtype": "array",
                "shape": [2],
                "units": "mm",
            }
        }

    def _move(self) -> None:
        self.position = self._rail.move_to(self._sent_to_mm)
        time.sleep(self._settle_s)
        self._measured_at = time.time()


class ScanCamera:
    """A configured camera that a plan triggers: bluesky's Triggerable, Readable and Configurable.

    Photographs go into `folder` as NAME_0000 and so on; numbers in use are skipped.
    """

    parent = None

    def __init__(self, camera: Camera, folder: Path, name: str = "camera") -> None:
        self.name = name
        self._camera = camera
        self._folder = folder
        self._number = 0
        self._info = camera.identify()
        self._frame: RawFrame | None = None
        self._taken_at = time.time()

    def trigger(self) -> Step:
        """Take a photograph."""
        return Step(self._expose, f"{self.name} exposing")

    def read(self) -> Reading:
        """Return the file of the last photograph, and its exposure time."""
        values = {
            "file": str(self._frame.path) if self._frame else "",
            "exposure_s": _exposure_s(self._frame),
        }
        return {
            f"{self.name}_{key}": {"value": value, "timestamp": self._taken_at}
            for key, value in values.items()
        }

    def describe(self) -> Reading:
        """Describe the values of `read`."""
        source = f"labkit {self._info.driver}"
        return {
            f"{self.name}_file": {"source": source, "dtype": "string", "shape": []},
            f"{self.name}_exposure_s": {
                "source": source,
                "dtype": "number",
                "shape": [],
                "units": "s",
            },
        }

    def read_configuration(self) -> Reading:
        """Return the model and the serial number."""
        value = f"{self._info.model} {self._info.serial}"
        return {f"{self.name}_model": {"value": value, "timestamp": self._taken_at}}

    def describe_configuration(self) -> Reading:
        """Describe the values of `read_configuration`."""
        return {
            f"{self.name}_model": {
                "source": f"labkit {self._info.driver}",
                "dtype": "string",
                "shape": [],
            }
        }

    def _expose(self) -> None:
        while any(self._folder.glob(f"{self.name}_{self._number:04d}.*")):
            self._number += 1
        self._frame = self._camera.expose(self._folder / f"{self.name}_{self._number:04d}")
        self._taken_at = time.time()


def _exposure_s(frame: RawFrame | None) -> float:
    return frame.exposure_s if frame else float("nan")
