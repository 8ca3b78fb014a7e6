"""libgphoto2 in a separate process: one thread, one camera, one request at a time.

The library can hang or crash, and its handles belong to one thread; in its own process it
harms nothing else. Requests and answers are JSON over a pipe (`link` is the other end). The
process ends with the pipe, and by itself when a request exceeds its time: SIGALRM ends it
even inside the library.
"""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

REFUSED = -1
IN_PROGRESS = -110

BUSY_PAUSES_S = (0.1, 0.3, 1.0, 3.0)
"""How long to look at events before a call that met "I/O in progress" is made again."""

GRACE_S = 10
"""Whoever asked stops waiting first, and says so; only if it is gone does the alarm ring."""

EVENT_POLL_S = 0.01
"""The library returns at once when no event is queued, whatever time it was given."""

FILES_QUIET_S = 0.25
"""Where the number of files is not known, an exposure is over when none has come for this long after the raw one."""

DRAIN_S = 2.0
"""Events left over from before are taken for no longer than this."""

SETTLE_S = 1.0
"""A body may show a setting's new value a moment later."""

JPEG_START = b"\xff\xd8"
HEIF_START = b"ftyphei"


class StoppedError(Exception):
    """The other end sent a new request, or is gone: the present work is obsolete."""


class Worker:
    """The requests, each a method whose arguments and result JSON can hold. gp: the gphoto2 package."""

    def __init__(
        self, channel: Connection, gp: Any, pauses_s: Sequence[float] = BUSY_PAUSES_S
    ) -> None:
        self._channel = channel
        self._gp = gp
        self._pauses_s = pauses_s
        self._camera: Any = None
        self._added: deque[tuple[str, str]] = deque()
        self.requests: dict[str, Callable[..., Any]] = {
            name: getattr(self, name)
            for name in (
                "find",
                "open",
                "settings",
                "read",
                "set",
                "expose",
                "preview",
                "storage",
                "reset",
                "close",
            )
        }

    def find(self) -> list[list[str]]:
        """Return [model, port] of every camera on USB."""
        found = self._gp.Camera.autodetect()
        return [[found.get_name(i), found.get_value(i)] for i in range(found.count())]

    def open(self, model: str, port: str) -> str:
        """Open a camera; the library's version."""
        self.close()
        ports = self._gp.PortInfoList()
        models = self._gp.CameraAbilitiesList()
        ports.load()
        models.load()
        camera = self._gp.Camera()
        camera.set_abilities(models.get_abilities(models.lookup_model(model)))
        camera.set_port_info(ports.get_info(ports.lookup_path(port)))
        camera.init()
        self._camera = camera
        return str(self._gp.gp_library_version(self._gp.GP_VERSION_SHORT)[0])

    def settings(self) -> list[dict[str, Any]]:
        """Return all settings of the body."""
        return list(self._leaves(self._patiently(self._camera.get_config)))

    def read(self, names: list[str]) -> dict[str, Any]:
        """Return the present values of some settings."""
        return {
            name: self._value(self._patiently(self._camera.get_single_config, name))
            for name in names
        }

    def set(self, name: str, value: Any) -> Any:
        """Change a setting, and return the value that the body then reports."""
        widget = self._patiently(self._camera.get_single_config, name)
        choices = self._choices(widget)
        if choices and value not in choices:  # some values crash the library
            raise ValueError(f"{name} = {value}: allowed is {', '.join(map(str, choices))}")
        widget.set_value(value)
        self._patiently(self._camera.set_single_config, name, widget)
        end = time.monotonic() + SETTLE_S
        while (now := self.read([name])[name]) != value and time.monotonic() < end:
            self._look(0.1)
        return now

    def expose(
        self,
        folder: str,
        files: int | None,
        wait_s: float,
        keep: bool,
        live_view: bool = False,
        bulb: Any = None,
    ) -> dict[str, Any]:
        """Take a photograph and transfer its files into `folder`, each numbered.

        files: expected number, None if unknown; keep: leave them in the camera as well;
        live_view: switch the live view on if possible, because some Nikons refuse without;
        bulb: seconds, and [name, value] to press and to release, for an exposure timed
        here.
        """
        strays = self._drain(keep)
        camera = self._camera
        gp = self._gp
        if bulb:
            self._hold(*bulb)
        elif camera.get_abilities().operations & gp.GP_OPERATION_TRIGGER_CAPTURE:
            self._trigger(live_view)
        else:
            place = self._patiently(camera.capture, gp.GP_CAPTURE_IMAGE)
            self._added.append((place.folder, place.name))
        return {"files": self._collect(Path(folder), files, wait_s, keep), "strays": strays}

    def preview(self, path: str) -> None:
        """Write a picture of the live view, a JPEG, to `path`."""
        file = self._patiently(self._camera.capture_preview)
        Path(path).write_bytes(file.get_data_and_size())

    def storage(self) -> list[dict[str, Any]]:
        """Return free space of each store, in images and kilobytes, if the body reports it."""
        gp = self._gp
        stores = self._patiently(self._camera.get_storageinfo)
        return [
            {
                "images": store.freeimages
                if store.fields & gp.GP_STORAGEINFO_FREESPACEIMAGES
                else None,
                "kilobytes": store.freekbytes
                if store.fields & gp.GP_STORAGEINFO_FREESPACEKBYTES
                else None,
            }
            for store in stores
        ]

    def reset(self, port: str) -> bool:
        """Reset a device on USB, like pulling its plug, and return whether it was there. Needs libusb."""
        import usb.core

        self.close()
        bus, address = (int(number) for number in port.removeprefix("usb:").split(","))
        device = usb.core.find(bus=bus, address=address)
        if device is None:
            return False
        device.reset()
        return True

    def close(self) -> None:
        """Let the camera go."""
        camera = self._camera
        self._camera = None
        self._added.clear()
        if camera is not None:
            camera.exit()

    def _leaves(self, widget: Any) -> Iterator[dict[str, Any]]:
        children = widget.count_children()
        if not children and widget.get_type() not in (
            self._gp.GP_WIDGET_WINDOW,
            self._gp.GP_WIDGET_SECTION,
        ):
            yield {
                "name": widget.get_name(),
                "label": widget.get_label(),
                "value": self._value(widget),
                "choices": self._choices(widget),
                "readonly": bool(widget.get_readonly()),
            }
        for i in range(children):
            yield from self._leaves(widget.get_child(i))

    def _choices(self, widget: Any) -> list[Any]:
        gp = self._gp
        kind = widget.get_type()
        if kind in (gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU):
            return [widget.get_choice(i) for i in range(widget.count_choices())]
        return [0, 1] if kind == gp.GP_WIDGET_TOGGLE else []

    def _value(self, widget: Any) -> Any:
        value = widget.get_value()
        return (
            value if isinstance(value, (int, float, str)) or value is None else str(value)
        )

    def _patiently(self, call: Callable[..., Any], *args: Any) -> Any:
        """Call the library; while I/O is in progress, take events and call again."""
        for pause_s in self._pauses_s:
            try:
                return call(*args)
            except self._gp.GPhoto2Error as error:
                if error.code != IN_PROGRESS:
                    raise
                self._look(pause_s)
        return call(*args)

    def _event(self, wait_s: float) -> bool:
        """Take an event if there is one, and record the files it announces."""
        kind, data = self._camera.wait_for_event(max(1, round(1000 * wait_s)))
        if kind == self._gp.GP_EVENT_FILE_ADDED:
            self._added.append((data.folder, data.name))
        return bool(kind != self._gp.GP_EVENT_TIMEOUT)

    def _look(self, seconds: float) -> None:
        """Take events for a time, or until the other end sends a request."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if self._channel.poll():
                raise StoppedError
            if not self._event(min(left, 0.1)):
                time.sleep(min(left, EVENT_POLL_S))

    def _drain(self, keep: bool) -> int:
        """Take old files away: a file of an abandoned exposure must not pass for the next."""
        end = time.monotonic() + DRAIN_S
        while self._event(0) and time.monotonic() < end:
            pass
        strays = len(self._added)
        for place in self._added:
            self._forget(place, keep)
        self._added.clear()
        return strays

    def _trigger(self, live_view: bool) -> None:
        try:
            self._patiently(self._camera.trigger_capture)
        except self._gp.GPhoto2Error as error:
            if error.code != REFUSED or not live_view:
                raise
            self._put("viewfinder", 1)
            self._patiently(self._camera.trigger_capture)

    def _hold(self, seconds: float, press: list[Any], release: list[Any]) -> None:
        """Time an exposure here, and release the shutter in any case."""
        try:
            self._put(*press)
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                if self._channel.poll(min(left, 0.05)):
                    raise StoppedError
        finally:
            self._put(*release)

    def _put(self, name: str, value: Any) -> None:
        widget = self._patiently(self._camera.get_single_config, name)
        widget.set_value(value)
        self._patiently(self._camera.set_single_config, name, widget)

    def _collect(
        self, folder: Path, files: int | None, wait_s: float, keep: bool
    ) -> list[dict[str, Any]]:
        """Transfer files at their announcement: some bodies keep them only until the next exposure."""
        found: list[dict[str, Any]] = []
        end = last = time.monotonic()
        end += wait_s
        while time.monotonic() < end:
            self._look(EVENT_POLL_S)
            while self._added:
                found.append(
                    self._fetch(self._added.popleft(), folder / str(len(found)), keep)
                )
                last = time.monotonic()
            enough = (
                time.monotonic() - last > FILES_QUIET_S
                if files is None
                else len(found) >= files
            )
            if enough and any(file["raw"] for file in found):
                break
        return found

    def _fetch(self, place: tuple[str, str], path: Path, keep: bool) -> dict[str, Any]:
        info = self._patiently(self._camera.file_get_info, *place).file
        size = info.size if info.fields & self._gp.GP_FILE_INFO_SIZE else None
        file = self._patiently(self._camera.file_get, *place, self._gp.GP_FILE_TYPE_NORMAL)
        content = file.get_data_and_size()  # lies in `file`, which must outlive it
        head = bytes(content[:16])
        path.write_bytes(content)
        self._forget(place, keep)
        raw = not head.startswith(JPEG_START) and HEIF_START not in head
        return {"path": str(path), "name": place[1], "size": size, "raw": raw}

    def _forget(self, place: tuple[str, str], keep: bool) -> None:
        """Free the camera's memory of a file; a body that has freed the memory itself may refuse."""
        if not keep:
            try:
                self._camera.file_delete(*place)
            except self._gp.GPhoto2Error as error:
                if error.code in (-7, -52):  # it is gone altogether
                    raise


def serve(channel: Connection, gp: Any, pauses_s: Sequence[float] = BUSY_PAUSES_S) -> None:
    """Answer requests until the other end closes."""
    worker = Worker(channel, gp, pauses_s)
    while True:
        try:
            request = json.loads(channel.recv_bytes())
        except EOFError:
            break
        signal.alarm(math.ceil(request["limit_s"]) + GRACE_S)
        answer: dict[str, Any] = {"id": request["id"]}
        try:
            answer["value"] = worker.requests[request["do"]](**request["with"])
        except gp.GPhoto2Error as error:
            answer |= {"code": error.code, "error": str(error.string)}
        except StoppedError:
            answer |= {"code": 0, "error": "stopped"}
        except Exception as error:
            answer |= {"code": 0, "error": f"{type(error).__name__}: {error}"}
        signal.alarm(0)
        try:
            channel.send_bytes(json.dumps(answer).encode())
        except OSError:
            break
    worker.close()


def refuse(channel: Connection, why: str) -> None:
    """Answer every request by why the library cannot be loaded, until the other end closes."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            request = json.loads(channel.recv_bytes())
            answer = {"id": request["id"], "code": 0, "error": why}
            channel.send_bytes(json.dumps(answer).encode())


if __name__ == "__main__":
    near = Connection(int(sys.argv[1]))
    try:
        import gphoto2
    except (ImportError, OSError) as error:  # of what it is linked with
        refuse(near, f"the package gphoto2 cannot be loaded: {error}")
    else:
        serve(near, gphoto2)
