"""The content of the operator's page and its buttons: an observer of captures."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from datetime import datetime
from queue import SimpleQueue
from typing import Any

from labkit.devices.operator import Operator
from labkit.drivers.web.preview import FrameSummary, look_at, summarise
from labkit.finder.preview import Look
from labkit.jobs.pace import Pace
from labkit.photographs.photograph import Photograph
from labkit.types import FrameKind

LOG_LINES = 200
SHARPNESS_POINTS = 60


class Monitor:
    """The state of the operator's page. The capture's thread writes, the server's thread reads."""

    def __init__(
        self,
        requests: SimpleQueue[str],
        operator: Operator,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._now = now
        self._requests = requests
        self._operator = operator
        self._lock = threading.Condition()
        self._listeners: dict[object, Callable[[], None]] = {}
        self._phase = "idle"
        self._doing = ""
        self._done = self._total = 0
        self._pace = Pace()
        self._paused = self._stopping = False
        self._choices: list[str] = []
        self._picked: str | None = None
        self._questions = 0
        self._devices: dict[str, dict[str, str]] = {}
        self._log: deque[dict[str, str]] = deque(maxlen=LOG_LINES)
        self._frame: FrameSummary | None = None
        self._sharpness: deque[dict[str, Any]] = deque(maxlen=SHARPNESS_POINTS)
        self.preview = b""

    # the capture's side

    def noted(self, event: str, **fields: Any) -> None:
        """Receive an event."""
        with self._lock:
            self._take_note(event, fields)
            if event != "doing":
                self._write(in_words(event, fields))
        self.wake()

    def took(
        self,
        name: str,
        kind: FrameKind,
        range_mm: float | None,
        mosaic: Photograph,
        done: int,
        total: int,
    ) -> None:
        """Receive a photograph of the session."""
        self._show(look_at(name, kind, range_mm, mosaic))
        with self._lock:
            self._pace.at(done, total, self._now())
            self._done = done
            self._total = total
            # a photograph in the session means that whatever was in trouble has got over it
            self._devices = {
                device: {**state, "state": "good"}
                for device, state in self._devices.items()
            }
            self._devices["camera"] = {"state": "good", "text": f"took {name}"}
        self.wake()

    def saw(self, look: Look) -> None:
        """Receive a photograph that is no frame."""
        self._show(look)
        self.wake()

    @property
    def holds(self) -> bool:
        """Return whether the operator has pressed pause."""
        with self._lock:
            return self._paused and not self._stopping

    def may_go_on(self) -> None:
        """Hold while paused. Raises KeyboardInterrupt once the operator has pressed abort."""
        with self._lock:
            if self._paused:
                self._pace.hold(self._now())
            while self._paused and not self._stopping:
                self._lock.wait(0.5)
            self._pace.go_on(self._now())
        self.refuse_abort()

    def refuse_abort(self) -> None:
        """Raise KeyboardInterrupt, once, if the operator pressed abort."""
        with self._lock:
            if not self._stopping:
                return
            self._stopping = self._paused = False
        raise KeyboardInterrupt

    # the page's side

    def act(self, what: str) -> None:
        """Act on a button: pause, resume, abort, or one of the choices. Other names are ignored."""
        with self._lock:
            if what in self._choices:
                self._requests.put(what)
            elif self._phase == "capturing" and what in ("pause", "resume", "abort"):
                self._paused = what == "pause"
                self._stopping = self._stopping or what == "abort"
                self._write(f"operator: {what}")
                self._lock.notify_all()
        self.wake()

    def answer(self, number: int, text: str) -> None:
        """Answer the question of a number; a second answer is ignored."""
        if self._operator.answer(number, text):
            with self._lock:
                self._write(f"operator: {text or 'done'}")
            self.wake()

    def snapshot(self) -> dict[str, Any]:
        """Return the content of the page, for JSON, without the displays, which the server knows."""
        question = self._operator.question
        with self._lock:
            return {
                "phase": self._shown_phase(question is not None),
                "doing": self._doing,
                "done": self._done,
                "total": self._total,
                "left_s": self._left_s(),
                "frame": asdict(self._frame) if self._frame else None,
                "sharpness": list(self._sharpness),
                "devices": [
                    {"device": device, **state} for device, state in self._devices.items()
                ],
                "choices": list(self._choices),
                "picked": self._picked,
                "question": asdict(question) if question else None,
                "log": list(self._log),
            }

    def listen(self, who: object, wake: Callable[[], None]) -> None:
        """Call `wake`, from any thread, when the snapshot changes."""
        with self._lock:
            self._listeners[who] = wake

    def unlisten(self, who: object) -> None:
        """Remove a listener."""
        with self._lock:
            self._listeners.pop(who, None)

    def wake(self) -> None:
        """Notify every listener of changes, such as a question."""
        question = self._operator.question
        with self._lock:
            if question is not None and question.number > self._questions:
                self._questions = question.number
                self._write(f"question: {question.text}")
            listeners = tuple(self._listeners.values())
        for notify in listeners:
            notify()

    def _show(self, look: Look) -> None:
        frame, preview = summarise(self._frame.number + 1 if self._frame else 1, look)
        with self._lock:
            self._frame = frame
            self.preview = preview
            if frame.edge_px is not None:
                self._sharpness.append({"name": look.name, "edge_px": frame.edge_px})

    def _write(self, text: str) -> None:
        self._log.append(
            {
                "time": datetime.now().astimezone().isoformat(timespec="seconds"),
                "text": text,
            }
        )

    def _shown_phase(self, asking: bool) -> str:
        if self._phase != "capturing":
            return self._phase
        return (
            "stopping"
            if self._stopping
            else "asking"
            if asking
            else "paused"
            if self._paused
            else "capturing"
        )

    def _left_s(self) -> int | None:
        """Return the seconds left at the present pace, at least 1, without pauses; None before two photographs."""
        left_s = (
            None
            if self._paused or self._phase != "capturing"
            else self._pace.left_s(self._now())
        )
        return None if left_s is None else max(1, round(left_s))

    def _take_note(self, event: str, fields: dict[str, Any]) -> None:
        match event:
            case "doing":
                self._phase, self._doing = "capturing", str(fields["what"])
            case "began":
                self._phase, self._pace = "capturing", Pace()
                self._total = int(fields["total"])
                self._done = self._total - int(fields["missing"])
            case "complete" | "stopped" | "interrupted":
                self._phase = event
                self._doing = str(fields.get("error", ""))
                self._paused = self._stopping = False
            case "next":
                self._doing = f"next: {fields['command']}"
            case "focusing":
                self._phase, self._doing = "focusing", str(fields["what"])
            case "serving":
                self._phase, self._choices, self._picked = (
                    "serving",
                    list(fields["choices"]),
                    fields["picked"],
                )
            case "camera":
                self._devices["camera"] = {"state": "good", "text": str(fields["model"])}
            case "moved":
                self._devices["rail"] = {
                    "state": "good",
                    "text": f"at {fields['measured_range_mm']:g} mm",
                }
            case "trouble":
                self._devices[str(fields["device"])] = {
                    "state": "bad",
                    "text": str(fields["error"]),
                }


def in_words(event: str, fields: dict[str, Any]) -> str:
    """Return an event of the journal as a line for people."""
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
            return f"picked: {picked}"
        case "focusing", {"what": what}:
            return f"focusing: {what}"
        case "preflight", {"problems": problems}:
            return f"preflight: {'; '.join(problems) or 'all is right'}"
        case "next", {"command": command}:
            return f"next: {command}"
        case "stopped", {"error": error}:
            return f"stopped: {error}"
        case "rejected", {"file": file, "reason": reason}:
            return f"put aside as {file}: {reason}"
    words = ", ".join(f"{key} {value}" for key, value in fields.items())
    return f"{event}: {words}".rstrip(": ")
