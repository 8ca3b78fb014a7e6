"""Any camera of libgphoto2: "gphoto2:" for the only one, "gphoto2:usb:001,004", "gphoto2:ptpip:192.168.1.5".

libgphoto2 runs in a separate process (`worker`). When it hangs, crashes or loses the
camera, the camera is released, searched again, reset on USB if necessary, opened and set as
before, a bounded number of times.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any, TypeVar

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import (
    CameraInfo,
    Check,
    ClosesItself,
    ExposureSettings,
    RawFrame,
    Setting,
)
from labkit.drivers.gphoto2.files import clear_folder, fresh_folder, kept
from labkit.drivers.gphoto2.link import (
    BUSY,
    CLAIM,
    DIED,
    FULL,
    HUNG,
    IO,
    NO_CAMERA,
    TIMEOUT,
    UNPLUGGED,
    UNSUPPORTED,
    Link,
    Trouble,
)
from labkit.drivers.gphoto2.settings import (
    ISOS,
    SHUTTERS,
    Wanted,
    number_of,
    percent_of,
    seconds_of,
    wanted,
)
from labkit.errors import CameraError, DeviceTimeoutError, PlanError
from labkit.plan import Plan

Result = TypeVar("Result")

NO_LIBUSB = "libusb is missing (Debian: apt-get install libusb-1.0-0)"

ON_NETWORK = "PTP/IP Camera"
"""Model name of every camera on a network: libgphoto2 does not search networks."""

NETWORK_SILENT = "it does not answer over the network: look at battery and screen, compare the address with its network menu"

ADVICE = {
    IO: "it does not answer over USB: look at cable and battery, switch it off and on",
    UNPLUGGED: "it is not on USB any more: look at cable and battery",
    NO_CAMERA: "it is not on USB: plug it in, switch it on, its automatic power-off off",
    CLAIM: "another program holds it, often the desktop's file manager: close that, or run gio mount -s gphoto2",
    BUSY: "it stays busy: look at what its screen says",
    TIMEOUT: "it does not answer in time: look at what its screen says, switch it off and on",
    FULL: "its memory or card is full: empty it",
}

TRY_PAUSES_S = (0.5, 2.0, 5.0)
"""Pauses before new tries: an operation is tried four times."""

ASK_S, OPEN_S, CLOSE_S = 10.0, 30.0, 10.0
"""Longest times for a request to the body, for opening the body, which lists all settings, and for closing the body."""

RELEASE_S = 30.0
"""An exposure, the body's own noise reduction (as long again) and the transfer take at most this and twice the time."""

LOW_PERCENT, EMPTY_PERCENT = 20.0, 5.0
"""With less charge a capture is not begun; with less than that no photograph is taken."""


def open_camera(address: str, plan: Plan, context: DeviceContext) -> Gphoto2Camera:
    """Return the camera at an address, opened at its first use. Raises PlanError."""
    port = address.partition(":")[2]
    if port and not re.fullmatch(r"usb:\d+,\d+", port) and not _network_port(port):
        raise PlanError(
            f'address "{address}": allowed is gphoto2: for the only camera on USB, gphoto2:usb:001,004, or, on a network, '
            "gphoto2:ptpip:192.168.1.5 with the camera's address"
        )
    if find_spec("gphoto2") is None:
        raise PlanError(
            f'address "{address}" needs the package gphoto2: pip install gphoto2'
        )
    settings = plan.camera
    return Gphoto2Camera(
        _network_port(port) or port,
        f_number=(settings.f_number if settings else None) or plan.lens.f_number,
        keep=settings is not None and settings.capture_target == "card",
        wait=time.sleep,
    )


def _network_port(port: str) -> str:
    """Return a camera's network address in libgphoto2's form; empty for other addresses.

    One port number serves both connections.
    """
    found = re.fullmatch(r"ptpip:([\d.]+)((?::\d{1,5}){0,2})", port)
    try:
        host = str(IPv4Address(found[1])) if found else ""
    except ValueError:
        return ""
    ports = found[2] if found else ""
    return f"ptpip:{host}{ports * 2 if ports.count(':') == 1 else ports}" if host else ""


def find_cameras() -> list[tuple[str, str]]:
    """Return (address, model) of every USB camera that libgphoto2 knows, or raise CameraError."""
    if find_spec("gphoto2") is None:
        raise CameraError("the package gphoto2 is missing: pip install gphoto2")
    link = Link()
    try:
        return [
            (f"gphoto2:{port}", _printable(model))
            for model, port in link.ask("find", ASK_S)
        ]
    except Trouble as trouble:
        if "libusb" in str(trouble) or (trouble.code == DIED and not _has_libusb()):
            raise CameraError(NO_LIBUSB) from trouble
        raise
    finally:
        link.close(CLOSE_S)


def _has_libusb() -> bool:
    from usb.backend import libusb1

    return libusb1.get_backend() is not None


class Gphoto2Camera(ClosesItself):
    """A Camera, Adjustable, Checkable, SelfRecovering and Previewing.

    port: "usb:001,004", "ptpip:192.168.1.5", or "" for the only camera on USB; f_number: to set if the body allows;
    keep: photographs go to the card and stay there; wait: function that waits, in seconds; link: to libgphoto2;
    release_s: longest time from the end of an exposure to its file.
    """

    def __init__(
        self,
        port: str,
        *,
        f_number: float | None,
        keep: bool,
        wait: Callable[[float], None],
        link: Link | None = None,
        release_s: float = RELEASE_S,
    ) -> None:
        self._port = port
        self._f_number = f_number
        self._keep = keep
        self._wait = wait
        self._link = link or Link()
        self._release_s = release_s
        self._is_open = False
        self._seen_at = ""
        self._exposure: ExposureSettings | None = None
        self._wanted: Wanted | None = None
        self._body: dict[str, Setting] = {}
        self._info: CameraInfo | None = None
        self._recovered: list[str] = []

    @property
    def _on_network(self) -> bool:
        return self._port.startswith("ptpip:")

    def recovered(self) -> tuple[str, ...]:
        """Describe the faults recovered from since the last call."""
        recovered, self._recovered = tuple(self._recovered), []
        return recovered

    def identify(self) -> CameraInfo:
        """Return model and serial number, after reconnecting if necessary."""

        def ask() -> CameraInfo:
            self._state()
            assert self._info is not None
            return self._info

        return self._doing("finding the camera", ask)

    def configure(self, settings: ExposureSettings) -> None:
        """Set exposure, aperture, raw format and storage, and switch off automatic functions. Raises
        CameraError.
        """
        self._exposure, self._wanted = settings, None
        self._doing("setting the camera", self._set_all)

    def expose(self, path: Path) -> RawFrame:
        """Expose once into `path` plus the raw format's suffix; without `configure`, with the body's settings."""
        return self._doing(
            f"photographing {path.name}", lambda: self._expose(path), path.parent
        )

    def preview(self, path: Path) -> Path | None:
        """Write a picture of the live view to `path` plus ".jpg"; None from a body without live view."""
        made = path.with_name(f"{path.name}.jpg")
        try:
            self._doing(
                "live view", lambda: self._link.ask("preview", ASK_S, path=str(made))
            )
        except (CameraError, DeviceTimeoutError) as error:
            if isinstance(error.__cause__, Trouble) and error.__cause__.code == UNSUPPORTED:
                return None
            raise
        return made

    def settings(self) -> tuple[Setting, ...]:
        """Return all settings of the body."""
        return self._doing("listing the camera's settings", self._list)

    def check(self, frames: int) -> Check:
        """Check the battery, and the card if photographs stay on it; list what to check by hand."""
        problems = []
        state = self._doing("asking the camera for battery and storage", self._state)
        charge = percent_of(state.get("battery"))
        if charge is not None and charge < LOW_PERCENT:
            problems.append(
                f"the camera's battery is at {charge:g} %: charge it, or feed it from the mains"
            )
        free = state.get("free_images")
        if self._keep and free is not None and free < frames:
            problems.append(
                f"the camera's card has room for {free} photographs, {frames} are to come: empty it"
            )
        return Check(tuple(problems), self._wanted.by_hand if self._wanted else ())

    def close(self) -> None:
        """Let the camera go; again does nothing."""
        self._is_open = False
        self._link.close(CLOSE_S)

    def _doing(
        self, what: str, action: Callable[[], Result], folder: Path | None = None
    ) -> Result:
        """Use the open camera; on trouble recover and try again, a bounded number of times."""
        pauses = iter((*TRY_PAUSES_S, None))
        for attempt, pause_s in enumerate(pauses, 1):
            try:
                self._open()
                return action()
            except Trouble as trouble:
                if pause_s is None or trouble.code == UNSUPPORTED:
                    raise _error(what, trouble, attempt, self._on_network) from trouble
                self._recovered.append(f"{what}, try {attempt}: {trouble}")
                self._let_go(trouble.code, attempt)
                self._wait(pause_s)
            finally:
                if folder is not None:
                    clear_folder(folder)
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _let_go(self, code: int, attempt: int) -> None:
        """Close the camera, and remove obstacles to opening it again."""
        self._is_open = False
        if code == CLAIM:
            _unmount()
        try:
            self._link.ask("close", CLOSE_S)
            if (
                self._seen_at
                and not self._on_network
                and (
                    code in (HUNG, DIED)
                    or (attempt > 1 and code in (IO, UNPLUGGED, TIMEOUT))
                )
            ):
                self._link.ask("reset", ASK_S, port=self._seen_at)
        except Trouble:
            self._link.kill()

    def _open(self) -> None:
        """Find and open the camera, and restore its settings."""
        if self._is_open:
            return
        if self._on_network:
            model, port = ON_NETWORK, self._port
        else:
            model, port = self._choose(
                [(model, port) for model, port in self._link.ask("find", ASK_S)]
            )
        self._seen_at = "" if self._on_network else port
        version = self._link.ask("open", OPEN_S, model=model, port=port)
        try:
            self._list()
            said = {name: str(setting.value) for name, setting in self._body.items()}
            model = said.get("cameramodel", model) if self._on_network else model
            info = CameraInfo(
                _printable(model),
                _printable(said.get("serialnumber", "")),
                f"libgphoto2 {version}",
            )
            if self._info not in (None, info):
                raise CameraError(
                    f"another camera came back: {info}; the session's is {self._info}: plug that in"
                )
            self._info = info
            if self._wanted is not None:
                self._set_all()
        except CameraError:
            self._link.close(CLOSE_S)
            raise
        self._is_open = True

    def _choose(self, found: list[tuple[str, str]]) -> tuple[str, str]:
        """Return the camera to open: at the requested port; the only one; or, after a loss, of its model."""
        listed = ", ".join(f"{model} at {port}" for model, port in found)
        if not found:
            raise Trouble(NO_CAMERA, "no camera found")
        for model, port in found:
            if port == self._port:
                return model, port
        if self._info is not None:  # plugged in again, it has another number
            found = [
                (model, port)
                for model, port in found
                if _printable(model) == self._info.model
            ]
        elif self._port:
            raise CameraError(
                f"no camera at {self._port}; there is {listed}: give camera.address as one of these"
            )
        if len(found) > 1:
            raise CameraError(
                f'several cameras: {listed}; say which, as camera.address = "gphoto2:{found[0][1]}"'
            )
        if not found:
            raise Trouble(NO_CAMERA, f"only {listed} found")
        return found[0]

    def _list(self) -> tuple[Setting, ...]:
        listed = tuple(
            Setting(
                one["name"],
                one["label"],
                one["value"],
                tuple(one["choices"]),
                one["readonly"],
            )
            for one in self._link.ask("settings", OPEN_S)
        )
        self._body = {setting.name: setting for setting in listed}
        return listed

    def _set_all(self) -> None:
        assert self._exposure is not None
        self._list()
        self._wanted = wanted(
            self._body, self._exposure, self._f_number, "card" if self._keep else "ram"
        )
        for name, value in self._wanted.changes:
            if self._body[name].value != value:
                self._set(name, value)
        self._set_right()

    def _set_right(self) -> dict[str, Any]:
        """Read back all settings made, and return the values.

        Bodies change settings by themselves, or when another is set.
        """
        if self._wanted is None:
            return {}
        asked = dict(self._wanted.changes)
        now: dict[str, Any] = self._link.ask("read", ASK_S, names=list(asked))
        wrong = {name: value for name, value in asked.items() if now[name] != value}
        for name, value in wrong.items():
            self._set(name, value)
        if wrong:
            now = self._link.ask("read", ASK_S, names=list(asked))
            for name, value in asked.items():
                _refuse_other(name, value, now[name])
        return now

    def _set(self, name: str, value: Any) -> None:
        _refuse_other(name, value, self._link.ask("set", ASK_S, name=name, value=value))

    def _state(self) -> dict[str, Any]:
        """Return battery and free storage, as far as the body reports them."""
        state: dict[str, Any] = {}
        if "batterylevel" in self._body:
            state["battery"] = self._link.ask("read", ASK_S, names=["batterylevel"])[
                "batterylevel"
            ]
        try:
            stores = self._link.ask("storage", ASK_S)
        except Trouble as trouble:
            if trouble.code != UNSUPPORTED:
                raise
            stores = []
        for key, name in (("images", "free_images"), ("kilobytes", "free_kilobytes")):
            if known := [store[key] for store in stores if store[key] is not None]:
                state[name] = max(known)
        return state

    def _expose(self, path: Path) -> RawFrame:
        if (
            self._exposure is not None and self._wanted is None
        ):  # setting it was given up half-way
            self._set_all()
        now, state = self._set_right(), self._state()
        charge = percent_of(state.get("battery"))
        if charge is not None and charge < EMPTY_PERCENT:
            raise CameraError(f"the camera's battery is at {charge:g} %: charge it")
        wanted = self._wanted
        exposure_s, iso = self._exposed(now)
        bulb = None
        if wanted and wanted.bulb:
            bulb = [wanted.exposure_s, list(wanted.bulb.press), list(wanted.bulb.release)]
        wait_s = self._release_s + 2 * exposure_s
        answer = self._link.ask(
            "expose",
            wait_s + exposure_s + ASK_S,
            folder=str(fresh_folder(path.parent)),
            files=wanted.files if wanted else None,
            wait_s=wait_s,
            keep=self._keep,
            live_view="viewfinder" in self._body,
            bulb=bulb,
        )
        made = kept(answer["files"], path, wait_s)
        meta = {
            **now,
            **state,
            **({"strays": answer["strays"]} if answer["strays"] else {}),
        }
        return RawFrame(made, exposure_s, iso, {"camera_settings": meta})

    def _exposed(self, now: Mapping[str, Any]) -> tuple[float, int]:
        """Return shutter time and ISO of the next photograph: as set, or as the body reports, or as ordered."""
        values = {name: setting.value for name, setting in self._body.items()} | dict(now)
        seconds = next(
            (s for name in SHUTTERS if name in values and (s := seconds_of(values[name]))),
            None,
        )
        iso = next(
            (n for name in ISOS if name in values and (n := number_of(values[name]))),
            None,
        )
        if self._exposure is not None:
            seconds = self._wanted.exposure_s if self._wanted else self._exposure.exposure_s
            iso = iso or self._exposure.iso
        return seconds or 1.0, round(iso or 0)


def _error(
    what: str, trouble: Trouble, tries: int, on_network: bool
) -> CameraError | DeviceTimeoutError:
    """Return the error of a trouble, with a line for people."""
    text = str(trouble)
    if on_network and trouble.code in (IO, TIMEOUT, HUNG, UNPLUGGED):
        text = f"{NETWORK_SILENT} (libgphoto2: {text})"
    elif trouble.code in ADVICE:
        text = f"{ADVICE[trouble.code]} (libgphoto2: {text})"
    elif trouble.code in (HUNG, DIED):
        text = f"{text}: switch the camera off and on, look at its cable"
    line = f"{what} failed {tries} times: {text}"
    return (
        DeviceTimeoutError(line) if trouble.code in (TIMEOUT, HUNG) else CameraError(line)
    )


def _printable(text: str) -> str:
    """Return the printable part of the name that a camera gives itself."""
    return "".join(letter for letter in text if letter.isprintable())


def _refuse_other(name: str, asked: Any, is_now: Any) -> None:
    if asked != is_now:
        raise CameraError(
            f"{name} was set to {asked}, but the camera has {is_now}: look at its dials and locks"
        )


def _unmount() -> None:
    """Ask the desktop's file manager to let cameras go."""
    if gio := shutil.which("gio"):
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            subprocess.run(
                [gio, "mount", "-s", "gphoto2"],
                timeout=10,
                capture_output=True,
                check=False,
            )
