"""Rails in trouble: real drivers on a real pty, simulated controllers with faults, and a camera and display beside them.

For tests of what a capture does then: `run` captures, `wrong_frames` and `left_over` look at the session afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import missing
from labkit.devices.context import Devices
from labkit.devices.protocols import (
    Camera,
    CameraInfo,
    Display,
    ExposureSettings,
    PanelInfo,
    Picture,
    Rail,
    RawFrame,
    Shown,
)
from labkit.drivers.grbl.rail import GrblRail
from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, GRBL_HAL, Firmware
from labkit.drivers.simulated.controllers.pty_port import Kind, LineFault, PtyPort
from labkit.drivers.simulated.controllers.zaber import ZaberController
from labkit.drivers.zaber.rail import ZaberRail
from labkit.errors import LabkitError
from labkit.session.session import Session, begin
from labkit.session.verify import verify
from tests.plans import SMALL, plan_text, simulated

DEVICES = simulated([2100, 2150, 2050], 1950.0)
ONE_OF_EACH = {
    "camera": {"frames_per_range": 1, "flats_per_range": 1, "darks": 0},
    "rail": {"settle_s": 0},
}

Photographs = Mapping[str, bytes]

NEAR_MM = 0.03
"""Rounding to steps or microsteps, and the driver's own tolerance of 0.02 mm."""

MICROSTEP_MM = 0.5e-3
FAST = {24: 60_000, 25: 600_000, 110: 60_000, 120: 20_000}


@dataclass(frozen=True)
class Setup:
    """A kind of rail: its controller with faults, its driver, and where the rail's zero is."""

    zero_mm: float
    port: Callable[[Sequence[LineFault]], PtyPort]
    rail: Callable[[PtyPort], Rail]
    carriage_mm: Callable[[Any], float]


def grbl(firmware: Firmware) -> Setup:
    return Setup(
        2300.0,
        lambda faults: grbl_port(firmware, FAST, faults=faults),
        lambda port: GrblRail(port.path, reply_s=0.8, back_s=0.4),
        lambda controller: controller.machine.carriage_mm(controller.now_s),
    )


RAILS = {
    "grbl": grbl(GRBL),
    "grblhal": grbl(GRBL_HAL),
    "zaber": Setup(
        2030.0,
        lambda faults: PtyPort(ZaberController(speed=2e6, acceleration=2e7), faults),
        lambda port: ZaberRail(port.path, MICROSTEP_MM, reply_s=0.8, back_s=0.4),
        lambda controller: controller.carriage * MICROSTEP_MM,
    ),
}

FAULTS: dict[str, tuple[Kind, float]] = {
    "late": ("late", 0.2),
    "too late": ("late", 1.2),
    "stale": ("stale", 0.0),
    "silence": ("silence", 0.2),
    "long silence": ("silence", 1.2),
    "garbage": ("garbage", 0.0),
    "partial": ("partial", 0.1),
    "torn": ("torn", 0.0),
    "unplugged": ("unplug", 0.2),
    "unplugged for good": ("unplug", 1e6),
    "reboot": ("reboot", 0.0),
    "reset": ("reset", 0.0),
    "alarm": ("alarm", 0.0),
}


class Bench:
    """A camera and a display that ask nothing, beside a rail; notes where the carriage truly is at each exposure.

    photographs: of "white" and of "target", whichever is shown.
    """

    def __init__(self, photographs: Photographs, setup: Setup, port: PtyPort) -> None:
        self.photographs = photographs
        self.setup = setup
        self.port = port
        self.shown = "target"
        self.taken: dict[str, float] = {}
        self.before_exposure: Callable[[str], None] = lambda name: None

    def carriage_mm(self) -> float:
        with self.port.lock:
            return self.setup.carriage_mm(self.port.controller)

    def devices(self, rail: Rail) -> Devices:
        return Devices(StubCamera(self), rail, StubDisplay(self))


class Stub:
    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        pass

    def close(self) -> None:
        pass


class StubCamera(Stub, Camera):
    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def identify(self) -> CameraInfo:
        return CameraInfo("stub", "1", "stub")

    def configure(self, settings: ExposureSettings) -> None:
        pass

    def expose(self, path: Path) -> RawFrame:
        self.bench.before_exposure(path.name)
        self.bench.taken[f"{path.name}.dng"] = self.bench.carriage_mm()
        whole = path.with_name(f"{path.name}.dng")
        whole.write_bytes(self.bench.photographs[self.bench.shown])
        return RawFrame(whole, 0.02, 100)


class StubDisplay(Stub, Display):
    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    @property
    def panel(self) -> PanelInfo:
        return PanelInfo((400, 400), 0.1)

    def show(self, picture: Picture) -> Shown:
        self.bench.shown = picture if isinstance(picture, str) else "target"
        return Shown((400, 400))


def run(
    setup: Setup, bench: Bench, folder: Path, resume: bool = False, check: bool = False
) -> str | None:
    """Capture; None if it came to its end, else the line that it ended with."""
    plan = folder.with_suffix(".toml")
    plan.write_text(
        plan_text(
            SMALL, DEVICES, ONE_OF_EACH, {"rail": {"range_at_zero_mm": setup.zero_mm}}
        )
    )
    try:
        with setup.rail(bench.port) as rail, begin(plan, folder, resume) as session:
            run_plan(session, bench.devices(rail), check=check)
    except LabkitError as error:
        return str(error)
    return None


def wrong_frames(session: Session, bench: Bench, setup: Setup) -> list[str]:
    """Frames that were taken with the carriage elsewhere than the session says."""
    found = []
    for kept in session.frames:
        assert kept.range_mm is not None
        off_mm = bench.taken[kept.file] - (kept.range_mm - setup.zero_mm)
        noted_mm = bench.taken[kept.file] - kept.meta["position_mm"]
        if max(abs(off_mm), abs(noted_mm)) > NEAR_MM:
            found.append(f"{kept.file} off by {off_mm:.3f} mm")
    return found


def left_over(setup: Setup, bench: Bench, folder: Path, ended: str | None) -> list[str]:
    """What is wrong with a session once its capture is over, resumed with the trouble mended where it had `ended`."""
    found = []
    if ended:
        again = Bench(bench.photographs, setup, setup.port([]))
        again.taken = bench.taken
        problem = run(setup, again, folder, resume=True)
        again.port.close()
        found += [f"resumed: {problem}"] if problem else []
    session = Session.open(folder)
    return (
        found
        + wrong_frames(session, bench, setup)
        + [str(left) for left in (*missing(session), *verify(session))]
    )


def side_by_side(find: Callable[[str, Path], list[str]], folder: Path) -> list[str]:
    """What is found of every fault; they run at the same time."""
    with ThreadPoolExecutor(len(FAULTS)) as pool:
        return [
            found
            for one in pool.map(
                lambda name: find(name, folder / name.replace(" ", "_")), FAULTS
            )
            for found in one
        ]
