"""The tethered camera on the real libgphoto2: its virtual camera, with every kind of trouble at every call."""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usb.core

from labkit.cli import run
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import (
    Adjustable,
    Camera,
    Checkable,
    ExposureSettings,
    Previewing,
)
from labkit.devices.registry import open_camera
from labkit.drivers.gphoto2 import camera as gphoto2_camera
from labkit.drivers.gphoto2.camera import Gphoto2Camera, find_cameras
from labkit.drivers.gphoto2.link import Link
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.errors import CameraError, DeviceError, DeviceTimeoutError, PlanError
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan, Sensor
from tests.plans import SMALL, plan_text

gphoto2 = pytest.importorskip("gphoto2")

FAULTY = Path(__file__).with_name("faulty_gphoto2.py")
SENSOR = Sensor(pixel_pitch_um=4.0)
AT_20_MS = ExposureSettings(0.02, 100)

RAW_ONLY = {
    "name": "imagequality",
    "value": "NEF (Raw)",
    "choices": ["JPEG Fine", "NEF (Raw)", "NEF+Fine"],
}


class Scene:
    """What the virtual camera photographs: a raw file with a number in it, read anew at each download."""

    def __init__(self, folder: Path) -> None:
        self.photograph = folder / "DCIM" / "100NIKON" / "DSC_0001.JPG"
        self.photograph.parent.mkdir(parents=True)
        self.show(0)

    def show(self, number: int) -> None:
        self.photograph.unlink(missing_ok=True)
        counts = np.full((64, 96), 1000 + number, dtype=np.uint16)
        write_raw(
            self.photograph,
            counts,
            RawTags(black_level=600, white_level=16383, exposure_s=0.02, iso=100),
        )


def number_in(path: Path) -> int:
    return int(np.median(read_photograph(path, SENSOR).counts)) - 1000


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    monkeypatch.setenv("VCAMERADIR", str(tmp_path / "vcamera"))
    return Scene(tmp_path / "vcamera")


MakeCamera = Callable[..., Gphoto2Camera]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeCamera]:
    """Makes cameras whose libgphoto2 is troubled as told; one that hangs is not waited for long."""
    limits = {
        limit: getattr(gphoto2_camera, limit) for limit in ("ASK_S", "OPEN_S", "CLOSE_S")
    }
    made = []
    numbers = itertools.count()

    def make(
        port: str = "", keep: bool = False, waited: list[float] | None = None, **spec: Any
    ) -> Gphoto2Camera:
        hangs = spec.get("fault", {}).get("kind") == "hang"
        for name, limit in limits.items():
            monkeypatch.setattr(gphoto2_camera, name, 2.0 if hangs else limit)
        folder = tmp_path / f"calls{next(numbers)}"
        folder.mkdir()
        command = [sys.executable, str(FAULTY), json.dumps({**spec, "folder": str(folder)})]
        waits: list[float] = [] if waited is None else waited
        camera = Gphoto2Camera(
            port,
            f_number=2.8,
            keep=keep,
            wait=waits.append,
            link=Link(command),
            release_s=spec.get("release_s", 0.5),
        )
        made.append(camera)
        return camera

    yield make
    for camera in made:
        camera.close()


def fault(call: str, kind: int | str, at: int = 1, times: int = 1) -> dict[str, Any]:
    return {"call": call, "kind": kind, "at": at, "times": times}


def two_frames(camera: Gphoto2Camera, scene: Scene, folder: Path) -> list[int]:
    """Two photographs of two scenes; what is in them."""
    seen = []
    camera.identify()
    camera.configure(AT_20_MS)
    for number in (1, 2):
        scene.show(number)
        seen.append(number_in(camera.expose(folder / f"frame_{number}").path))
    return seen


def test_it_is_a_camera_that_can_be_asked_and_checked(
    make: MakeCamera, scene: Scene
) -> None:
    camera: Camera = make()
    assert isinstance(camera, Adjustable)
    assert isinstance(camera, Checkable)


def test_frames_come_out_of_the_real_library_with_their_settings(
    scene: Scene, tmp_path: Path
) -> None:
    with Gphoto2Camera("", f_number=2.8, keep=False, wait=lambda s: None) as camera:
        info = camera.identify()
        camera.configure(AT_20_MS)
        scene.show(5)
        frame = camera.expose(tmp_path / "flat_3013.2_0")
    assert (info.model, info.serial) == ("Nikon DSC D750", "0.1")
    assert frame.path == tmp_path / "flat_3013.2_0.dng"
    assert number_in(frame.path) == 5
    assert (frame.exposure_s, frame.iso) == (0.02, 100)
    settings = frame.meta["camera_settings"]
    assert settings["shutterspeed"] == "0.0200s"
    assert settings["f-number"] == "f/2.8"
    assert settings["capturetarget"] == "Internal RAM"
    assert settings["battery"] == "50%"
    assert settings["free_images"] == 150
    assert not (tmp_path / ".incoming").exists()


def test_the_librarys_own_cameras_are_listed_by_address(
    scene: Scene, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_cameras() == [("gphoto2:usb:001,001", "Nikon DSC D750")]

    def no_backend(find_all: bool) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", no_backend)
    assert run(["devices", "--json"]) == 0
    said = json.loads(capfd.readouterr().out)
    assert said["cameras"] == [
        {"address": "gphoto2:usb:001,001", "model": "Nikon DSC D750"}
    ]
    assert said["usb"] is None
    assert run(["devices", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert run(["devices"]) == 0
    assert "USB\n  not looked at\n" in capfd.readouterr().out


def test_a_library_that_cannot_be_loaded_for_lack_of_libusb_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = "libusb-1.0.so.0: cannot open shared object file: No such file or directory"
    (tmp_path / "gphoto2.py").write_text(f"raise ImportError({missing!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(CameraError, match=r"^libusb is missing"):
        find_cameras()
    (tmp_path / "gphoto2.py").write_text("raise ImportError('libltdl.so.7: not found')")
    words = r"^the package gphoto2 cannot be loaded: libltdl\.so\.7: not found$"
    with pytest.raises(CameraError, match=words):
        find_cameras()


def test_a_library_that_crashes_without_libusb_is_said_to_lack_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    command = (sys.executable, "-c", "import os; os.abort()")
    monkeypatch.setattr(gphoto2_camera, "Link", lambda: Link(command))
    with pytest.raises(CameraError, match="libgphoto2 crashed in 'find'"):
        find_cameras()
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: None)
    with pytest.raises(CameraError, match=r"^libusb is missing"):
        find_cameras()


def test_settings_are_listed_and_what_cannot_be_asked_is_left_to_a_person(
    make: MakeCamera, scene: Scene
) -> None:
    camera = make()
    shutter = next(
        setting for setting in camera.settings() if setting.name == "shutterspeed"
    )
    assert "0.0200s" in shutter.choices
    camera.configure(AT_20_MS)
    check = camera.check(20)
    assert check.problems == ()
    assert "vibration reduction off" in check.by_hand
    assert "ISO 100" in check.by_hand


def test_without_configuring_it_photographs_as_the_body_is_set(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    frame = make().expose(tmp_path / "a")
    assert (frame.exposure_s, frame.iso) == (0.01, 0)


CALLS = [
    ("autodetect", 1), ("init", 1), ("get_config", 1), ("get_single_config", 2), ("set_single_config", 1),
    ("get_storageinfo", 1), ("trigger_capture", 1), ("trigger_capture", 2), ("wait_for_event", 3), ("file_get_info", 2),
    ("file_get", 1), ("file_get", 2),
]  # fmt: skip
KINDS = [-7, -10, -52, -53, -110, "hang", "crash"]


@pytest.mark.parametrize(("call", "at"), CALLS)
@pytest.mark.parametrize("kind", KINDS)
def test_passing_trouble_is_got_over_and_no_frame_is_lost_or_mixed_up(
    call: str, at: int, kind: int | str, make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    camera = make(fault=fault(call, kind, at), extra=[RAW_ONLY])
    assert two_frames(camera, scene, tmp_path) == [1, 2]


LASTING = {
    -7: "does not answer over USB",
    -10: "does not answer in time",
    -52: "not on USB any more",
    -53: "another program holds it",
    -105: "plug it in, switch it on",
    -110: "stays busy",
    -3: "card is full: empty it",
    -6: "Unsupported operation",
    "hang": "libgphoto2 did not come back from",
    "crash": r"libgphoto2 crashed in '\w+' \(signal 11\)",
}


@pytest.mark.parametrize("call", ["init", "trigger_capture"])
@pytest.mark.parametrize("kind", LASTING)
def test_lasting_trouble_ends_in_one_line_and_the_camera_serves_again_when_it_is_over(
    call: str, kind: int | str, make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    waited: list[float] = []
    with pytest.raises(DeviceError, match=LASTING[kind]) as caught:
        two_frames(
            make(fault=fault(call, kind, times=999), extra=[RAW_ONLY], waited=waited),
            scene,
            tmp_path,
        )
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, DeviceTimeoutError) == (kind in (-10, "hang"))
    assert waited == ([] if kind == -6 else [*gphoto2_camera.TRY_PAUSES_S])
    assert [path for path in tmp_path.iterdir() if path.suffix == ".dng"] == []
    assert two_frames(make(extra=[RAW_ONLY]), scene, tmp_path) == [1, 2]


def test_the_camera_may_fill_up_and_is_opened_again(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    # the virtual camera stops delivering after 26 photographs, until it is opened anew
    camera = make(extra=[RAW_ONLY], release_s=0.2, slow_exit=True)
    camera.configure(AT_20_MS)
    handles = []
    for number in range(60):
        scene.show(number)
        assert number_in(camera.expose(tmp_path / f"frame_{number}").path) == number
        handles.append(len(os.listdir("/proc/self/fd")))
    assert max(handles) == handles[0]


@pytest.mark.parametrize("files", [["jpeg", "raw"], ["raw", "jpeg"]])
def test_of_raw_and_jpeg_the_raw_is_kept_whichever_comes_first(
    files: Sequence[str], make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    both = {"name": "imageformat", "value": "RAW + JPEG", "choices": ["L", "RAW + JPEG"]}
    assert two_frames(make(files=files, extra=[both]), scene, tmp_path) == [1, 2]
    (tmp_path / "again").mkdir()  # by a body that does not tell its format
    assert two_frames(make(files=files), scene, tmp_path / "again") == [1, 2]


def test_a_camera_that_sends_only_jpegs_is_told_off(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    with pytest.raises(
        CameraError, match="a JPEG, and no raw file: set its image quality to raw"
    ):
        two_frames(make(files=["jpeg"]), scene, tmp_path)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (["short"], "came with .* of .* bytes"),
        (["garbage"], "no whole raw file"),
        (["raw", "raw"], "2 raw files came of one exposure"),
        ([], "no photograph came within"),
    ],
)
def test_files_that_are_not_whole_or_not_one_are_never_kept(
    files: Sequence[str], words: str, make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    with pytest.raises(DeviceError, match=words):
        two_frames(make(files=files, release_s=0.2), scene, tmp_path)
    assert list(tmp_path.glob("frame*")) == []


def test_a_file_of_an_exposure_that_was_given_up_does_not_pass_for_the_next(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    # the trigger works, then events fail: the file of that exposure is still to come
    camera = make(fault=fault("wait_for_event", -10, at=3), extra=[RAW_ONLY])
    assert two_frames(camera, scene, tmp_path) == [1, 2]


def test_a_long_exposure_is_timed_here_where_the_body_has_bulb(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    shutter = {"name": "shutterspeed2", "value": "1/50", "choices": ["1/50", "Bulb"]}
    camera = make(extra=[RAW_ONLY, shutter, {"name": "bulb", "value": 0}])
    camera.configure(
        ExposureSettings(1.2, 100)
    )  # of its own the virtual camera exposes 1 s at most
    frame = camera.expose(tmp_path / "a")
    assert frame.exposure_s == 1.2
    assert frame.meta["camera_settings"]["shutterspeed2"] == "Bulb"
    held_s = float((tmp_path / "calls0" / "held_s").read_text())
    assert 1.2 <= held_s < 1.6


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ({"name": "iso", "value": "200", "choices": ["200", "400"]}, "ISO 100: allowed are 200, 400"),
        ({"name": "focusmode", "value": "AF-S", "choices": ["AF-S"], "readonly": True}, "set manual focus"),
        ({"name": "imagequality", "value": "JPEG Fine", "choices": ["JPEG Fine"]}, "offers no raw format"),
        ({"name": "longexpnr", "value": "On", "choices": ["On"]}, "set long exposure noise reduction off"),
        ({"name": "imagestabilization", "value": "On", "choices": ["On"]}, "set vibration reduction off"),
        ({"name": "iso", "value": "200", "choices": ["100", "200"], "snaps": "200"}, "set to 100, but the camera has 200"),
        ({"name": "iso", "value": "200", "choices": ["100", "200"], "ignores": True}, "set to 100, but the camera has"),
    ],
)  # fmt: skip
def test_what_the_body_will_not_do_is_said(
    extra: dict[str, Any], words: str, make: MakeCamera, scene: Scene
) -> None:
    with pytest.raises(CameraError, match=words):
        make(extra=[extra]).configure(AT_20_MS)


def test_a_setting_that_turns_by_itself_is_turned_back_before_the_next_frame(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    drifting = {"name": "iso", "value": "100", "choices": ["100", "200"], "drifts": "200"}
    camera = make(extra=[RAW_ONLY, drifting])
    camera.configure(AT_20_MS)
    for number in range(2):
        assert (
            camera.expose(tmp_path / f"frame_{number}").meta["camera_settings"]["iso"]
            == "100"
        )


def test_a_low_battery_and_a_full_card_are_told_before_and_an_empty_battery_stops(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    camera = make(
        keep=True,
        extra=[
            {"name": "batterylevel", "value": "15%", "readonly": True, "choices": ["15%"]}
        ],
    )
    camera.configure(AT_20_MS)
    battery, card = camera.check(200).problems
    assert "battery is at 15 %" in battery
    assert "room for 150 photographs, 200 are to come" in card
    empty = make(
        extra=[{"name": "batterylevel", "value": "3%", "readonly": True, "choices": ["3%"]}]
    )
    empty.configure(AT_20_MS)
    with pytest.raises(CameraError, match="battery is at 3 %"):
        empty.expose(tmp_path / "a")


def test_a_camera_without_trigger_is_made_to_capture(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    assert two_frames(make(no_trigger=True), scene, tmp_path) == [1, 2]


def test_a_port_with_no_camera_is_told_with_those_that_there_are(
    make: MakeCamera, scene: Scene
) -> None:
    with pytest.raises(
        CameraError,
        match=r"no camera at usb:009,009; there is Nikon DSC D750 at usb:001,001",
    ):
        make("usb:009,009").identify()
    assert make("usb:001,001").identify().model == "Nikon DSC D750"


def test_the_photograph_of_an_exposure_in_flight_is_not_overwritten(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    (tmp_path / "a.dng").write_bytes(b"mine")
    with pytest.raises(CameraError, match="never overwritten"):
        make().expose(tmp_path / "a")
    assert (tmp_path / "a.dng").read_bytes() == b"mine"


def test_it_is_opened_by_address(scene: Scene) -> None:
    with open_camera(
        "gphoto2:", Plan.parse(plan_text(SMALL), Path()), DeviceContext()
    ) as camera:
        assert camera.identify().serial == "0.1"
    with pytest.raises(PlanError, match="allowed is gphoto2: for the only camera"):
        open_camera("gphoto2:nikon", Plan.parse(plan_text(SMALL), Path()), DeviceContext())


def test_a_body_that_wants_live_view_first_is_given_it(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    waited: list[float] = []
    live_view = {"name": "viewfinder", "value": 0}
    camera = make(
        fault=fault("trigger_capture", -1), extra=[RAW_ONLY, live_view], waited=waited
    )
    assert two_frames(camera, scene, tmp_path) == [1, 2]
    assert waited == []


def test_the_desktops_file_manager_is_asked_to_let_the_camera_go(
    make: MakeCamera, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gio = tmp_path / "bin" / "gio"
    gio.parent.mkdir()
    gio.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\n')
    gio.chmod(0o755)
    monkeypatch.setenv("PATH", f"{gio.parent}:{os.environ['PATH']}")
    make(fault=fault("init", -53, times=2)).identify()
    assert (tmp_path / "asked").read_text() == "mount -s gphoto2\n" * 2


def test_ctrl_c_in_an_exposure_is_obeyed_at_once_and_leaves_the_camera_usable(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    camera = make(files=[], release_s=30.0)
    camera.identify()
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        camera.expose(tmp_path / "a")
    assert (
        camera.identify().serial == "0.1"
    )  # the worker gave up waiting for the file when it was asked again


def test_the_worker_ends_with_the_pipe() -> None:
    link = Link()
    link.ask("close", 10.0)
    process, channel = link._process, link._channel
    assert process is not None
    assert channel is not None
    channel.close()
    assert process.wait(10) == 0


def test_live_view_is_a_picture_and_a_body_without_it_says_so_at_once(
    make: MakeCamera, scene: Scene, tmp_path: Path
) -> None:
    (tmp_path / "live").write_bytes(b"\xff\xd8 as the body sends it")
    assert make().preview(tmp_path / "focus_1") is None
    camera: Camera = make(
        preview=str(tmp_path / "live"), fault=fault("capture_preview", -7)
    )
    assert isinstance(camera, Previewing)
    seen = camera.preview(tmp_path / "focus_2")
    assert seen is not None
    assert seen.read_bytes() == (tmp_path / "live").read_bytes()
