"""USB trouble below libgphoto2: the kernel's answers, by umockdev, to the real libgphoto2, libusb and pyusb."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import usb.backend.libusb1

from labkit.drivers.gphoto2.camera import Gphoto2Camera
from labkit.drivers.gphoto2.link import WORKER_COMMAND, Link
from labkit.errors import CameraError

pytest.importorskip("gphoto2")

TESTBED = Path(__file__).with_name("usb_testbed.py")
SYSTEM_PYTHON = "/usr/bin/python3"
PRELOAD = "libumockdev-preload.so.0"


def _missing() -> str | None:
    """What is not installed of all that a USB testbed needs."""
    if not sys.platform.startswith("linux") or shutil.which("umockdev-wrapper") is None:
        return "umockdev"
    if usb.backend.libusb1.get_backend() is None:  # by which pyusb resets
        return "libusb-1.0-0"
    look = "import gi; gi.require_version('UMockdev', '1.0'); from gi.repository import UMockdev"
    found = subprocess.run([SYSTEM_PYTHON, "-c", look], capture_output=True, check=False)
    return "python3-gi and gir1.2-umockdev-1.0" if found.returncode else None


pytestmark = pytest.mark.skipif(
    (_lacking := _missing()) is not None,
    reason=f"without {_lacking} no USB device can be described (Debian: see the Makefile)",
)


class Testbed:
    """A camera on a USB that umockdev plays."""

    __test__ = False

    def __init__(self, busy_claims: int, error: int) -> None:
        self._process = subprocess.Popen(
            ["umockdev-wrapper", SYSTEM_PYTHON, str(TESTBED), str(busy_claims), str(error)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self._folder = self._process.stdout.readline().strip()

    def say(self, words: str) -> dict[str, int]:
        """Do that; how often the camera was claimed and reset so far."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(words + "\n")
        self._process.stdin.flush()
        counts: dict[str, int] = json.loads(self._process.stdout.readline())
        return counts

    def camera(self, wait: Callable[[float], None]) -> Gphoto2Camera:
        settings = [f"LD_PRELOAD={PRELOAD}", f"UMOCKDEV_DIR={self._folder}"]
        link = Link(
            [str(shutil.which("env")), "-u", "VCAMERADIR", *settings, *WORKER_COMMAND]
        )
        return Gphoto2Camera("", f_number=None, keep=False, wait=wait, link=link)

    def close(self) -> None:
        self._process.communicate(timeout=20)


MakeTestbed = Callable[[int, int], Testbed]


@pytest.fixture
def make() -> Iterator[MakeTestbed]:
    made: list[Testbed] = []

    def make(busy_claims: int, error: int) -> Testbed:
        made.append(Testbed(busy_claims, error))
        return made[-1]

    yield make
    for testbed in made:
        testbed.close()


def failure(testbed: Testbed, wait: Callable[[float], None] = lambda seconds: None) -> str:
    """The line with which looking for the camera ends."""
    with testbed.camera(wait) as camera, pytest.raises(CameraError) as caught:
        camera.identify()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_camera_that_another_program_holds_is_claimed_again_and_then_told(
    make: MakeTestbed,
) -> None:
    testbed = make(99, errno.EIO)
    assert "another program holds it" in failure(testbed)
    assert testbed.say("counts") == {"claims": 4, "resets": 0}  # as often as it is tried


def test_a_camera_that_is_let_go_meanwhile_is_claimed(make: MakeTestbed) -> None:
    testbed = make(2, errno.EIO)
    assert "does not answer over USB" in failure(
        testbed
    )  # nobody is behind the plug, but it is ours
    assert testbed.say("counts")["claims"] > 2


@pytest.mark.parametrize(
    ("error", "words"),
    [(errno.EIO, "does not answer over USB"), (errno.ENODEV, "not on USB any more")],
)
def test_a_camera_that_does_not_answer_is_reset_on_usb(
    error: int, words: str, make: MakeTestbed
) -> None:
    testbed = make(0, error)
    assert words in failure(testbed)
    assert testbed.say("counts")["resets"] >= 1


def test_an_unplugged_camera_is_looked_for_and_found_under_its_new_number(
    make: MakeTestbed,
) -> None:
    testbed = make(0, errno.EIO)
    testbed.say("unplug")
    assert "plug it in, switch it on" in failure(testbed)
    assert testbed.say("counts")["claims"] == 0
    pauses: list[float] = []

    def plug_in_after_two_pauses(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 2:
            testbed.say("plug")

    assert "does not answer over USB" in failure(testbed, plug_in_after_two_pauses)
    assert testbed.say("counts")["claims"] > 0
