"""Captures on serial rails in trouble: every fault at every step, on the real drivers, a real pty, simulated controllers.

Whatever happens, each frame in the session was taken with the carriage truly where the plan wants it, and the capture
either gets over the trouble by itself or ends with one line, after which it can be resumed. The steps are of the talk
between driver and controller; all faults of a step run side by side, since they mostly wait.
"""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest

from labkit.capture.capture import capture
from labkit.capture.sequence import missing, picture_for
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
from labkit.devices.registry import open_devices
from labkit.drivers.grbl.rail import GrblRail
from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, GRBL_HAL, Firmware
from labkit.drivers.simulated.controllers.pty_port import Kind, LineFault, PtyPort
from labkit.drivers.simulated.controllers.zaber import ZaberController
from labkit.drivers.zaber.rail import ZaberRail
from labkit.errors import LabkitError
from labkit.plan import parse_plan
from labkit.session.session import Session, begin
from labkit.session.verify import verify
from tests.plans import SMALL, plan_text, simulated

DEVICES = simulated([2100, 2150, 2050], 1950.0)
ONE_OF_EACH = {"camera": {"frames_per_range": 1, "flats_per_range": 1, "darks": 0}, "rail": {"settle_s": 0}}

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

Step = tuple[str, int, float]
"""A command of the driver, its number, and the time after it in s."""

GRBL_STEPS: dict[str, Step] = {
    "asking who it is": (r"\$I", 1, 0.0),
    "asking its settings": (r"\$\$", 1, 0.0),
    "beginning to home": (r"\$H", 1, 0.0),
    "homing": (r"\$H", 1, 0.02),
    "setting the modes": (r"G21.*", 1, 0.0),
    "beginning the run-up": (r"G53.*", 1, 0.0),
    "in the run-up": (r"G53.*", 1, 0.05),
    "in the last millimetre": (r"G53.*", 1, 0.11),
    "the dwell": (r"G4.*", 1, 0.0),
    "the end of a move": (r"\$G", 3, 0.0),
    "where it stands": (r"\?", 5, 0.0),
    "the second stop": (r"G53.*", 3, 0.0),
    "moving to the second stop": (r"G53.*", 3, 0.04),
    "moving to the third stop": (r"G53.*", 5, 0.06),
    "the end of the last move": (r"\$G", 5, 0.0),
}

ZABER_STEPS: dict[str, Step] = {
    "asking its limits": (r"get limit.*", 1, 0.0),
    "beginning to home": (r"home", 1, 0.0),
    "homing": (r"home", 1, 0.02),
    "beginning the run-up": (r"move.*", 1, 0.0),
    "in the run-up": (r"move.*", 1, 0.04),
    "the last millimetre": (r"move.*", 2, 0.0),
    "where it stands": (r"get pos", 3, 0.0),
    "asking whether it moves": (r"", 4, 0.0),
    "moving to the second stop": (r"move.*", 3, 0.02),
    "moving to the third stop": (r"move.*", 5, 0.03),
}

CASES = [
    *(("grbl", step) for step in GRBL_STEPS),
    *(("grblhal", step) for step in ("asking its settings", "homing", "in the run-up", "the dwell", "where it stands")),
    *(("zaber", step) for step in ZABER_STEPS),
]

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

OPENING = ("asking who it is", "asking its settings", "asking its limits")
"""Steps before the capture begins, where nothing is tried again."""


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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
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


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Photographs:
    """Taken on the simulated bench."""
    folder = tmp_path_factory.mktemp("photographs")
    plan = parse_plan(plan_text(SMALL, DEVICES), folder)
    with open_devices(plan) as devices:
        devices.camera.configure(ExposureSettings(0.02, 100))
        devices.rail.home()
        devices.rail.move_to(150.0)
        pictures: dict[str, Picture] = {"white": "white", "target": picture_for(plan, devices).grey}
        for name, picture in pictures.items():
            devices.display.show(picture)
            devices.camera.expose(folder / name)
    return {name: (folder / f"{name}.dng").read_bytes() for name in pictures}


def run(setup: Setup, bench: Bench, folder: Path, resume: bool = False, check: bool = False) -> str | None:
    """Capture; None if it came to its end, else the line that it ended with."""
    plan = folder.with_suffix(".toml")
    plan.write_text(plan_text(SMALL, DEVICES, ONE_OF_EACH, {"rail": {"range_at_zero_mm": setup.zero_mm}}))
    try:
        with setup.rail(bench.port) as rail, begin(plan, folder, resume) as session:
            capture(session, bench.devices(rail), check=check)
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


def problems(
    setup: Setup, step: str, at: Step, name: str, photographs: Photographs, folder: Path, check: bool = False
) -> list[str]:
    """What goes wrong in a capture with one fault: empty if all is as it should be."""
    kind, lasts_s = FAULTS[name]
    command, nth, after_s = at
    port = setup.port([LineFault(kind, command, nth, after_s=after_s, lasts_s=lasts_s)])
    found = []
    bench = Bench(photographs, setup, port)
    try:
        ended = run(setup, bench, folder, check=check)
        for_good = name == "unplugged for good"
        if for_good != (ended is not None) and step not in OPENING:
            found.append(f"{name}: {ended or 'no error, though the rail is gone'}")
        if not port.struck:
            found.append(f"{name}: the step never came")
        if ended and "\n" in ended:
            found.append(f"{name}: more than one line")
    finally:
        port.close()
    return found + [f"{name}: {problem}" for problem in left_over(setup, bench, folder, ended)]


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
    return found + wrong_frames(session, bench, setup) + [str(left) for left in (*missing(session), *verify(session))]


@pytest.mark.parametrize(("kind", "step"), CASES)
def test_every_fault_at_every_step_is_got_over_or_told(
    kind: str, step: str, photographs: Photographs, tmp_path: Path
) -> None:
    at = (ZABER_STEPS if kind == "zaber" else GRBL_STEPS)[step]
    assert side_by_side(lambda name, folder: problems(RAILS[kind], step, at, name, photographs, folder), tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "step", "at"),
    [
        ("grbl", "homing", (r"\$H", 1, 0.02)),
        ("grbl", "moving to the near end", (r"G53.*", 1, 0.05)),
        ("grbl", "where it stands there", (r"\$G", 3, 0.0)),
        ("grbl", "moving to the far end", (r"G53.*", 3, 0.04)),
        ("zaber", "homing", ("home", 1, 0.02)),
        ("zaber", "moving to the near end", ("move.*", 1, 0.04)),
        ("zaber", "moving to the far end", ("move.*", 3, 0.02)),
    ],
)
def test_every_fault_of_the_look_round_is_got_over_or_told(
    kind: str, step: str, at: Step, photographs: Photographs, tmp_path: Path
) -> None:
    assert (
        side_by_side(lambda name, folder: problems(RAILS[kind], step, at, name, photographs, folder, True), tmp_path)
        == []
    )


def side_by_side(find: Callable[[str, Path], list[str]], folder: Path) -> list[str]:
    """What is found of every fault; they run at the same time."""
    with ThreadPoolExecutor(len(FAULTS)) as pool:
        return [
            found for one in pool.map(lambda name: find(name, folder / name.replace(" ", "_")), FAULTS) for found in one
        ]


COMMANDS = {
    "grbl": [r"\$I", r"\$\$", r"\$H", r"G21.*", r"G53.*", r"G4.*", r"\$G", r"\?", "\x18"],
    "zaber": ["get.*", "home", "move.*", "", "warnings.*", "stop"],
}


def several(seed: int) -> tuple[Setup, list[LineFault]]:
    """A rail, and two to four faults anywhere."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(RAILS)))
    commands, kinds = COMMANDS["zaber" if name == "zaber" else "grbl"], sorted({kind for kind, _ in FAULTS.values()})
    faults = [
        LineFault(
            kinds[rng.integers(len(kinds))],
            commands[rng.integers(len(commands))],
            nth=int(rng.integers(1, 9)),
            times=int(rng.integers(1, 3)),
            after_s=float(rng.choice([0.0, rng.uniform(0, 0.3)])),
            lasts_s=float(rng.uniform(0, 1.2)),
        )
        for _ in range(rng.integers(2, 5))
    ]
    return RAILS[name], faults


@pytest.mark.parametrize("first", range(0, 48, 12))
def test_several_faults_in_one_capture_lose_no_frame_and_spoil_none(
    first: int, photographs: Photographs, tmp_path: Path
) -> None:
    def one(seed: int) -> list[str]:
        setup, faults = several(seed)
        port = setup.port(faults)
        bench = Bench(photographs, setup, port)
        ended = run(setup, bench, tmp_path / str(seed))
        port.close()
        return [f"{seed}: {problem}" for problem in left_over(setup, bench, tmp_path / str(seed), ended)]

    with ThreadPoolExecutor(12) as pool:
        assert [problem for found in pool.map(one, range(first, first + 12)) for problem in found] == []


def once(name: str, do: Callable[[], None]) -> Callable[[str], None]:
    """To be called before each exposure: does it before the first of that name."""
    left = [do]
    return lambda what: left.pop()() if what == name and left else None


@pytest.mark.parametrize("kind", RAILS)
def test_trouble_while_exposing_spoils_no_frame(kind: str, photographs: Photographs, tmp_path: Path) -> None:
    def found(name: str, folder: Path) -> list[str]:
        setup, port = RAILS[kind], RAILS[kind].port([])
        bench = Bench(photographs, setup, port)
        bench.before_exposure = once("flat_2150_0", lambda: port.strike(*FAULTS[name]))
        try:
            ended = run(setup, bench, folder)
        finally:
            port.close()
        session = Session.open(folder)
        frames = 2 if name == "unplugged for good" else 6  # what was taken while it went is not trusted
        if len(session.frames) != frames or (ended is None) != (frames == 6):
            return [f"{name}: {len(session.frames)} frames, {ended}"]
        return wrong_frames(session, bench, setup)

    assert side_by_side(found, tmp_path) == []


def test_a_frame_during_which_the_stage_was_moved_is_taken_again(photographs: Photographs, tmp_path: Path) -> None:
    setup, port = RAILS["zaber"], RAILS["zaber"].port([])
    bench = Bench(photographs, setup, port)
    controller = port.controller
    assert isinstance(controller, ZaberController)

    def knock() -> None:
        with port.lock:
            controller.position += 3 / MICROSTEP_MM

    bench.before_exposure = once("target_2150_0", knock)
    ended = run(setup, bench, tmp_path / "s")
    port.close()
    session = Session.open(tmp_path / "s")
    assert (ended, len(session.frames)) == (None, 6)
    assert wrong_frames(session, bench, setup) == []
    trouble = [event["error"] for event in session.events if event["event"] == "trouble"]
    assert trouble[0].startswith("after target_2150_0: the Zaber at ")
    assert "was left at 120.000 mm and stands at 123.000 mm" in trouble[0]


def test_a_slip_that_the_controller_cannot_know_of_is_mended_by_homing(
    photographs: Photographs, tmp_path: Path
) -> None:
    # steps alone do not tell: this holds what docs/bench.md says of rails without an encoder
    port = RAILS["grbl"].port([])
    controller = port.controller
    assert isinstance(controller, GrblController)
    with RAILS["grbl"].rail(port) as rail:
        rail.home()
        port.strike("slip")
        rail.move_to(-100.0)
        assert controller.machine.carriage_mm(controller.now_s) == pytest.approx(-97.0, abs=NEAR_MM)
        rail.home()
        rail.move_to(-100.0)
        assert controller.machine.carriage_mm(controller.now_s) == pytest.approx(-100.0, abs=NEAR_MM)
    port.close()


def test_ctrl_c_in_mid_move_stops_the_carriage_and_resume_finishes(photographs: Photographs, tmp_path: Path) -> None:
    slow = replace(RAILS["grbl"], port=lambda faults: grbl_port(GRBL, {**FAST, 110: 12_000}, faults=faults))
    port = slow.port([])
    bench = Bench(photographs, slow, port)
    controller = port.controller
    inner = controller.noticed

    def interrupt(command: str) -> None:
        inner(command)
        if command.startswith("G53 G0 X-151"):
            threading.Timer(0.15, _thread.interrupt_main).start()

    controller.noticed = interrupt
    with pytest.raises(KeyboardInterrupt):
        run(slow, bench, tmp_path / "s")
    assert -200.0 <= bench.carriage_mm() < -151.0
    controller.noticed = inner
    assert run(slow, bench, tmp_path / "s", resume=True) is None
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 6
    assert wrong_frames(session, bench, slow) == []
    port.close()
