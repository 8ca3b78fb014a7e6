"""What the operator's page shows, and the buttons on it: a Watcher of captures."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.lab.raw import Mosaic
from labkit.lab.session import Kind

BINS = 64
PREVIEW_PX = 900
LOG_LINES, SHARPNESS_POINTS = 200, 60
RED = (40, 40, 230)
"""Blue, green, red of a clipped pixel in the preview."""


@dataclass(frozen=True, slots=True)
class Look:
    """A photograph at a glance. histogram: share of pixels in 64 equal steps from black to white, and what is beyond."""

    number: int
    name: str
    kind: Kind
    range_mm: float | None
    clipped_percent: float
    median_percent: float
    sharpness: float
    histogram: list[float]


class Monitor:
    """The state of the operator's page. The capture's thread writes it, the server's reads it."""

    def __init__(self, wishes: SimpleQueue[str], now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._wishes = now, wishes
        self._lock = threading.Condition()
        self._listeners: dict[object, Callable[[], None]] = {}
        self._phase, self._doing = "idle", ""
        self._done = self._total = 0
        self._began: tuple[float, int] | None = None
        self._paused = self._stopping = False
        self._paused_s = 0.0
        self._choices: list[str] = []
        self._picked: str | None = None
        self._devices: dict[str, dict[str, str]] = {}
        self._log: deque[dict[str, str]] = deque(maxlen=LOG_LINES)
        self._look: Look | None = None
        self._sharpness: deque[dict[str, Any]] = deque(maxlen=SHARPNESS_POINTS)
        self.preview = b""

    # the capture's side

    def noted(self, event: str, **fields: Any) -> None:
        """Something happened."""
        with self._lock:
            self._take_note(event, fields)
            if event != "doing":
                self._write(in_words(event, fields))
        self._ring()

    def took(self, name: str, kind: Kind, range_mm: float | None, mosaic: Mosaic, done: int, total: int) -> None:
        """A photograph is in the session."""
        level = levels(mosaic)
        number = self._look.number + 1 if self._look else 1
        look = Look(number, name, kind, range_mm, *exposure(mosaic), sharpness(level), histogram(mosaic))
        preview = picture(level, mosaic.counts >= mosaic.white)
        with self._lock:
            self._look, self.preview = look, preview
            if kind == "target":
                self._sharpness.append({"name": name, "value": look.sharpness})
            if self._began is None:
                self._began = self._now(), done - 1
                self._paused_s = 0.0
            self._done, self._total = done, total
            # a photograph in the session means that whatever was in trouble has got over it
            self._devices = {device: {**state, "state": "good"} for device, state in self._devices.items()}
            self._devices["camera"] = {"state": "good", "text": f"took {name}"}
        self._ring()

    def may_go_on(self) -> None:
        """Hold while paused. Raises KeyboardInterrupt once asked to abort."""
        since = self._now()
        with self._lock:
            while self._paused and not self._stopping:
                self._lock.wait(0.5)
            self._paused_s += self._now() - since
        self.refuse_abort()

    def refuse_abort(self) -> None:
        """Raise KeyboardInterrupt, once, if the operator pressed abort."""
        if self._stopping:
            self._stopping = self._paused = False
            raise KeyboardInterrupt

    # the page's side

    def act(self, what: str) -> None:
        """A button: pause, resume, abort, or one of the choices. Anything else is ignored."""
        with self._lock:
            if what in self._choices:
                self._wishes.put(what)
            elif self._phase == "capturing" and what in ("pause", "resume", "abort"):
                self._paused = what == "pause"
                self._stopping = self._stopping or what == "abort"
                self._write(f"operator: {what}")
                self._lock.notify_all()
        self._ring()

    def snapshot(self) -> dict[str, Any]:
        """All that the page shows, for JSON; without the displays, which the server knows."""
        with self._lock:
            return {
                "phase": self._shown_phase(),
                "doing": self._doing,
                "done": self._done,
                "total": self._total,
                "left_s": self._left_s(),
                "frame": asdict(self._look) if self._look else None,
                "sharpness": list(self._sharpness),
                "devices": [{"device": device, **state} for device, state in self._devices.items()],
                "choices": list(self._choices),
                "picked": self._picked,
                "log": list(self._log),
            }

    def listen(self, who: object, wake: Callable[[], None]) -> None:
        """Call `wake`, from any thread, when the snapshot changes."""
        with self._lock:
            self._listeners[who] = wake

    def unlisten(self, who: object) -> None:
        """No more."""
        with self._lock:
            self._listeners.pop(who, None)

    def _write(self, text: str) -> None:
        self._log.append({"time": datetime.now().strftime("%H:%M:%S"), "text": text})

    def _ring(self) -> None:
        with self._lock:
            listeners = tuple(self._listeners.values())
        for wake in listeners:
            wake()

    def _shown_phase(self) -> str:
        if self._phase != "capturing":
            return self._phase
        return "stopping" if self._stopping else "paused" if self._paused else "capturing"

    def _left_s(self) -> float | None:
        """Seconds left at the pace so far, pauses not counted."""
        if self._phase != "capturing" or self._began is None or self._paused:
            return None
        since, already = self._began
        return (self._now() - since - self._paused_s) / max(1, self._done - already) * (self._total - self._done)

    def _take_note(self, event: str, fields: dict[str, Any]) -> None:
        match event:
            case "doing":
                self._phase, self._doing = "capturing", str(fields["what"])
            case "began":
                self._phase, self._began = "capturing", None
            case "complete" | "stopped" | "interrupted":
                self._phase = event
                self._doing = str(fields.get("error", ""))
                self._paused = self._stopping = False
            case "serving":
                self._phase, self._choices, self._picked = "serving", list(fields["choices"]), fields["picked"]
            case "camera":
                self._devices["camera"] = {"state": "good", "text": str(fields["model"])}
            case "moved":
                self._devices["rail"] = {"state": "good", "text": f"at {fields['measured_range_mm']:g} mm"}
            case "trouble":
                self._devices[str(fields["device"])] = {"state": "bad", "text": str(fields["error"])}


def levels(mosaic: Mosaic) -> NDArray[np.float32]:
    """(rows/2, cols/2) light, 0 black to 1 white, each 2×2 cell in one."""
    rows, cols = (size // 2 * 2 for size in mosaic.counts.shape)
    counts = mosaic.counts[:rows, :cols].astype(np.float32)
    cells: NDArray[np.float32] = counts.reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))
    black = float(mosaic.black.mean())
    return (cells - np.float32(black)) / np.float32(mosaic.white - black)


def exposure(mosaic: Mosaic) -> tuple[float, float]:
    """Percentage of pixels at or above white, and the middle pixel in percent of the way from black to white."""
    clipped = 100 * np.count_nonzero(mosaic.counts >= mosaic.white) / mosaic.counts.size
    black = float(mosaic.black.mean())
    return float(clipped), float(100 * (np.median(mosaic.counts[::3, ::3]) - black) / (mosaic.white - black))


def histogram(mosaic: Mosaic) -> list[float]:
    """Share of pixels in 64 equal steps from black to white; what is below or above counts in the first and last."""
    of_count = np.bincount(mosaic.counts.ravel(), minlength=1)
    black = float(mosaic.black.mean())
    step = np.floor((np.arange(of_count.size) - black) / (mosaic.white - black) * BINS)
    share = np.bincount(np.clip(step, 0, BINS - 1).astype(int), weights=of_count, minlength=BINS)
    return [float(value) for value in share / mosaic.counts.size]


def sharpness(level: NDArray[np.float32]) -> float:
    """RMS slope from cell to cell over the mean light, in the middle half of the frame.

    No unit: larger is sharper, for the same target at the same range; exposure cancels. Noise adds to it.
    """
    rows, cols = level.shape
    middle = level[rows // 4 : rows - rows // 4, cols // 4 : cols - cols // 4].astype(np.float64)
    if min(middle.shape) < 2:
        return 0.0
    square = np.mean(np.diff(middle, axis=0) ** 2) + np.mean(np.diff(middle, axis=1) ** 2)
    return float(np.sqrt(square) / max(float(middle.mean()), 1e-6))


def picture(level: NDArray[np.float32], clipped: NDArray[np.bool_]) -> bytes:
    """A JPEG at most 900 pixels wide, brightened as a screen needs; every patch with a clipped pixel is red."""
    scale = min(1.0, PREVIEW_PX / level.shape[1])
    size = max(1, round(level.shape[1] * scale)), max(1, round(level.shape[0] * scale))
    small = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
    grey = np.rint(255 * np.clip(small, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    colour = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    colour[cv2.resize(clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0] = RED
    done, jpeg = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return jpeg.tobytes() if done else b""


def in_words(event: str, fields: dict[str, Any]) -> str:
    """An event of the journal as a line for people."""
    match event, fields:
        case "began", {"missing": missing}:
            return f"began: {missing} photographs to take"
        case "moved", {"measured_range_mm": range_mm, "position_mm": position_mm}:
            return f"moved to {range_mm:g} mm, rail at {position_mm:g} mm"
        case "camera", {"model": model, "serial": serial}:
            return f"camera: {model}, serial number {serial}"
        case "trouble", {"device": device, "attempt": attempt, "error": error}:
            return f"trouble with the {device}, try {attempt}: {error}"
        case "serving", {"picked": picked}:
            return f"showing {picked}"
    words = ", ".join(f"{key} {value}" for key, value in fields.items())
    return f"{event}: {words}".rstrip(": ")
