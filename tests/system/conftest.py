"""A bench so small and fast that a whole capture takes a moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import pytest

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import picture_for
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import ExposureSettings, Picture
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.simulated.world import Fault
from labkit.plan import Plan
from labkit.session.session import Session
from labkit.types import Floats32
from tests.plans import SMALL, plan_text, simulated

from .rails_in_trouble import DEVICES, Photographs

ADDRESS = "simulated:seed=7"

PLAN = plan_text(
    SMALL,
    simulated([2000, 2050.5], 1950.0, ADDRESS),
    {"camera": {"frames_per_range": 2, "flats_per_range": 2, "darks": 3}},
)

ContextMaker = Callable[..., DeviceContext]


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def make_context() -> ContextMaker:
    return small_bench


def small_bench(
    plan_file: Path, faults: Sequence[Fault] = (), light: float = 1.0
) -> DeviceContext:
    """A context with the plan's bench in it, with faults, and with more or less light than the plan expects."""
    settings = settings_for(Plan.load(plan_file), 7)
    sensor = replace(
        settings.sensor, white_electrons_per_s=settings.sensor.white_electrons_per_s * light
    )
    bench = OnceDrawn(replace(settings, sensor=sensor, halo_um=100.0), faults)
    return DeviceContext(shared=SharedParts({ADDRESS: bench}))


class OnceDrawn(Bench):
    """A bench that draws a picture, which has no noise, once for all tests of a process."""

    drawn: ClassVar[dict[tuple[str, float, bytes, bytes], Floats32]] = {}

    def _mosaic(self) -> Floats32:
        # relative to white: it does not depend on the light's strength
        sensor = replace(self.settings.sensor, white_electrons_per_s=1.0)
        lens = repr(replace(self.settings, sensor=sensor))
        pose, codes = self.view.to_pixels().tobytes(), self._codes.tobytes()
        key = lens, self.range_mm, pose, codes
        if key not in self.drawn:
            self.drawn[key] = super()._mosaic()
        return self.drawn[key]


@pytest.fixture
def photograph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where libgphoto2's virtual camera takes its pictures from."""
    monkeypatch.setenv("VCAMERADIR", str(tmp_path / "vcamera"))
    path = tmp_path / "vcamera" / "DCIM" / "100NIKON" / "DSC_0001.JPG"
    path.parent.mkdir(parents=True)
    return path


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Photographs:
    """Taken on the simulated bench."""
    folder = tmp_path_factory.mktemp("photographs")
    plan = Plan.parse(plan_text(SMALL, DEVICES), folder)
    bench = Bench(replace(settings_for(plan, 1), halo_um=100.0))
    with open_devices(
        plan, context=DeviceContext(shared=SharedParts({"simulated:": bench}))
    ) as devices:
        devices.camera.configure(ExposureSettings(0.02, 100))
        devices.rail.home()
        devices.rail.move_to(150.0)
        pictures: dict[str, Picture] = {
            "white": "white",
            "target": picture_for(plan, devices).grey,
        }
        for name, picture in pictures.items():
            devices.display.show(picture)
            devices.camera.expose(folder / name)
    return {name: (folder / f"{name}.dng").read_bytes() for name in pictures}


def capture_few(folder: Path, noll: tuple[int, int]) -> Path:
    """Capture one photograph at each of two ranges, through a lens with the modes that the plan names; return the folder."""
    few = {
        "camera": {"frames_per_range": 1, "flats_per_range": 2, "darks": 2},
        "fit": {"zernike_noll": list(noll)},
    }
    text = plan_text(SMALL, simulated([2000, 2050.5], 1950.0, ADDRESS), few)
    return capture_through(range(noll[0] + 1, noll[1] + 1), text, folder)


def capture_through(modes: Sequence[int], text: str, folder: Path) -> Path:
    """Capture a plan's session through a lens with some modes beyond defocus; return the folder."""
    settings = settings_for(Plan.parse(text, folder.parent), 7)
    lens = replace(settings.lens, noll=tuple(modes))
    bench = Bench(replace(settings, lens=lens))
    context = DeviceContext(shared=SharedParts({ADDRESS: bench}))
    with (
        Session.create(folder, text, folder.parent) as opened,
        open_devices(opened.plan, context=context) as devices,
    ):
        run_plan(opened, devices, check=False)
    return folder


@pytest.fixture(scope="session")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two ranges, one photograph each, that is fitted in a moment. Tests use copies."""
    return capture_few(tmp_path_factory.mktemp("captured") / "night-1", (4, 5))
