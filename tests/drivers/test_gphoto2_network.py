"""The tethered camera on a network: the real libgphoto2 and a camera played at a port of this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Camera
from labkit.devices.registry import open_camera
from labkit.drivers.gphoto2 import camera as gphoto2_camera
from labkit.errors import DeviceError, PlanError
from labkit.plan import Plan
from tests.drivers.ptpip_peer import Peer
from tests.drivers.test_gphoto2 import AT_20_MS, Scene, number_in
from tests.plans import SMALL, plan_text

pytest.importorskip("gphoto2")


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path / "camera")


@pytest.fixture
def peer(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Peer]]:
    """Makes cameras on a network that deliver the scene, of a libgphoto2 without its virtual USB."""
    monkeypatch.delenv("VCAMERADIR", raising=False)
    made: list[Peer] = []

    def make(silent: bool = False) -> Peer:
        made.append(Peer(scene.photograph, silent))
        return made[-1]

    yield make
    for each in made:
        each.close()


def on_network(port: int) -> Camera:
    return open_camera(
        f"gphoto2:ptpip:127.0.0.1:{port}", Plan.parse(plan_text(SMALL)), DeviceContext()
    )


def test_a_camera_on_a_network_is_found_at_its_address_set_and_photographs(
    peer: Callable[..., Peer], scene: Scene, tmp_path: Path
) -> None:
    with on_network(peer().port) as camera:
        info = camera.identify()
        camera.configure(AT_20_MS)
        scene.show(7)
        frame = camera.expose(tmp_path / "target_1600_0")
        scene.show(8)
        again = camera.expose(tmp_path / "target_1600_1")
    assert (info.model, info.serial) == ("Peer 1", "0815")
    assert [number_in(frame.path), number_in(again.path)] == [7, 8]
    assert frame.meta["camera_settings"]["shutterspeed"] == "0.0200s"
    assert frame.meta["camera_settings"]["iso"] == "100"


@pytest.mark.parametrize("silent", [True, False])
def test_where_no_camera_answers_on_a_network_the_address_is_doubted(
    silent: bool, peer: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gphoto2_camera, "TRY_PAUSES_S", (0.0,))
    monkeypatch.setattr(gphoto2_camera, "OPEN_S", 1.5)
    there = peer(silent)
    if not silent:
        there.close()
    with (
        on_network(there.port) as camera,
        pytest.raises(DeviceError, match=r"over the network: .*its network menu \(libgph"),
    ):
        camera.identify()


@pytest.mark.parametrize(
    "port",
    ["ptpip:", "ptpip:camera", "ptpip:192.168.1.300", "ptpip:192.168.1.2:1:2:3", "usb:1"],
)
def test_an_address_that_is_none_is_refused_with_what_is_allowed(port: str) -> None:
    with pytest.raises(
        PlanError,
        match=r"the only camera on USB, gphoto2:usb:001,004, or, on a network, gphoto2:ptpip:",
    ):
        open_camera(f"gphoto2:{port}", Plan.parse(plan_text(SMALL)), DeviceContext())
