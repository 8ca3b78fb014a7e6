"""The worker's process with trouble to order between it and the real libgphoto2: run as a script by test_gphoto2.

Its first argument is JSON: `fault`, a library call's name, the number of the call, how often and what then happens (an
error code, "hang" or "crash"); `extra`, settings that the virtual camera lacks; `files`, what each exposure delivers;
`preview`, the JPEG that its live view shows;
`folder`, where calls are counted, for a fault does not come again because the process was started again.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections import deque
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gphoto2

from labkit.drivers.gphoto2.worker import serve

SPEC = json.loads(sys.argv[1])
LET_GO: list[Any] = []
JPEG = b"\xff\xd8\xff\xe0 a JPEG"


def counted(call: str) -> None:
    """Count a call to the library, and do what is due on it."""
    tally = Path(SPEC["folder"]) / call
    with tally.open("ab") as file:
        file.write(b".")
        number = file.tell()
    fault = SPEC.get("fault")
    if (
        not fault
        or fault["call"] != call
        or not fault["at"] <= number < fault["at"] + fault["times"]
    ):
        return
    match fault["kind"]:
        case "hang":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            time.sleep(60)
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case code:
            raise gphoto2.GPhoto2Error(code)


class ExtraWidget:
    """A setting that the virtual camera lacks. `snaps`: what it takes instead of what is set; `drifts`: it turns to
    that by itself after each exposure; `ignores` what is set."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self._fields = fields
        self._value = fields["value"]

    def get_name(self) -> str:
        return str(self._fields["name"])

    def get_label(self) -> str:
        return self.get_name()

    def get_type(self) -> int:
        return int(
            gphoto2.GP_WIDGET_RADIO
            if self._fields.get("choices")
            else gphoto2.GP_WIDGET_TOGGLE
        )

    def get_readonly(self) -> bool:
        return bool(self._fields.get("readonly"))

    def count_children(self) -> int:
        return 0

    def count_choices(self) -> int:
        return len(self._fields["choices"])

    def get_choice(self, number: int) -> Any:
        return self._fields["choices"][number]

    def get_value(self) -> Any:
        return self._value

    def set_value(self, value: Any) -> None:
        self._value = self._fields.get("snaps", value)


class Tree:
    """The real camera's settings and the extra ones below one root."""

    def __init__(self, *children: Any) -> None:
        self._children = children

    def get_type(self) -> int:
        return int(gphoto2.GP_WIDGET_WINDOW)

    def count_children(self) -> int:
        return len(self._children)

    def get_child(self, number: int) -> Any:
        return self._children[number]


class FaultyCamera:
    """A camera as gphoto2.Camera, out of a real one."""

    def __init__(self) -> None:
        self._real = gphoto2.Camera()
        self._extra = {one["name"]: dict(one) for one in SPEC.get("extra", [])}
        self._files = deque[Any]()
        self._pressed: float | None = None

    @staticmethod
    def autodetect() -> Any:
        counted("autodetect")
        return gphoto2.Camera.autodetect()

    def __getattr__(self, call: str) -> Any:
        if call in ("set_abilities", "set_port_info"):
            return getattr(self._real, call)
        if call == "get_abilities":
            operations = (
                0 if SPEC.get("no_trigger") else gphoto2.GP_OPERATION_TRIGGER_CAPTURE
            )
            return lambda: SimpleNamespace(operations=operations)

        changed = getattr(type(self), f"_{call}", None)

        def counted_call(*args: Any) -> Any:
            counted(call)
            return changed(self, *args) if changed else getattr(self._real, call)(*args)

        return counted_call

    def _exit(self) -> None:
        """The virtual camera takes 0.3 s for it, and so it does when it is thrown away; it can be opened twice."""
        if SPEC.get("slow_exit"):  # then what it holds is gone, too
            self._real.exit()
        else:
            LET_GO.append(self._real)

    def _get_config(self) -> Any:
        return Tree(self._real.get_config(), *map(ExtraWidget, self._extra.values()))

    def _get_single_config(self, name: str) -> Any:
        return (
            ExtraWidget(self._extra[name])
            if name in self._extra
            else self._real.get_single_config(name)
        )

    def _set_single_config(self, name: str, widget: Any) -> None:
        if name == "bulb":
            self._bulb(widget.get_value())
        elif name not in self._extra:
            self._real.set_single_config(name, widget)
        elif not self._extra[name].get("ignores"):
            self._extra[name]["value"] = widget.get_value()

    def _bulb(self, pressed: int) -> None:
        if pressed:
            self._pressed = time.monotonic()
            return
        if self._pressed is not None:
            held_s = time.monotonic() - self._pressed
            (Path(SPEC["folder"]) / "held_s").write_text(str(held_s))
            self._real.trigger_capture()

    def _trigger_capture(self) -> None:
        self._real.trigger_capture()
        for one in self._extra.values():
            one["value"] = one.get("drifts", one["value"])

    def _capture_preview(self) -> Any:
        """The virtual camera says that it has a live view, and has none."""
        if "preview" not in SPEC:
            return self._real.capture_preview()
        content = Path(SPEC["preview"]).read_bytes()
        return SimpleNamespace(get_data_and_size=lambda: content)

    def _wait_for_event(self, milliseconds: int) -> Any:
        if self._files:
            return gphoto2.GP_EVENT_FILE_ADDED, self._files.popleft()
        kind, data = self._real.wait_for_event(milliseconds)
        if kind == gphoto2.GP_EVENT_FILE_ADDED and "files" in SPEC:
            for number, what in enumerate(SPEC["files"]):
                self._files.append(
                    SimpleNamespace(
                        folder=data.folder, name=data.name, what=what, number=number
                    )
                )
            if not self._files:
                return gphoto2.GP_EVENT_UNKNOWN, None
            self._names = {
                f"{one.number}{one.what}-{data.name}": one for one in self._files
            }
            for name, one in self._names.items():
                one.name = name
            return self._wait_for_event(milliseconds)
        return kind, data

    def _file_get_info(self, folder: str, name: str) -> Any:
        kind, real = _split(name)
        info = self._real.file_get_info(folder, real)
        size = (
            len(JPEG) if kind == "jpeg" else info.file.size + (1 if kind == "short" else 0)
        )
        return SimpleNamespace(
            file=SimpleNamespace(size=size, fields=gphoto2.GP_FILE_INFO_SIZE)
        )

    def _file_get(self, folder: str, name: str, what: int) -> Any:
        kind, real = _split(name)
        file = self._real.file_get(folder, real, what)
        content = bytes(file.get_data_and_size())
        if kind == "jpeg":
            content = JPEG
        elif kind == "garbage":
            content = bytes(len(content))
        return SimpleNamespace(get_data_and_size=lambda: content)

    def _file_delete(self, folder: str, name: str) -> None:
        """The virtual camera takes 0.15 s for it."""


def _split(name: str) -> tuple[str, str]:
    head, _, real = name.rpartition("-")
    return head.lstrip("0123456789"), real


class Faulty:
    """gphoto2 with another Camera."""

    Camera = FaultyCamera

    def __getattr__(self, name: str) -> Any:
        return getattr(gphoto2, name)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[2])), Faulty(), pauses_s=(0.01, 0.02))
