"""Every fault of every simulated device at every step of a capture, its look round beforehand included.

A fault that passes is got over; one that lasts ends the capture with one line, and the session can be resumed. Either
way every frame is there in the end, none was touched once it was taken, and each was taken where the plan wants it, of
the picture that its kind means, as the world itself tells.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.acquisition.capture import run_plan
from labkit.devices.context import DeviceContext
from labkit.devices.observer import Observer
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.rail import SimulatedRail
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.simulated.world import Fault
from labkit.errors import DeviceError, InputError, RailError
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.session.verify import verify
from labkit.types import Floats32
from tests.plans import SMALL, plan_text, simulated

PLAN = plan_text(
    SMALL,
    simulated([2000, 2050], 1950.0),
    {"camera": {"frames_per_range": 1, "flats_per_range": 1, "darks": 1}},
)
NEAR_MM = 0.1
"""Five standard deviations of the bench's scatter."""

FRAMES = {
    "dark_0": "dark", "flat_2000_0": "white", "target_2000_0": "target", "flat_2050_0": "white", "target_2050_0": "target",
}  # fmt: skip

LOOKS = 4
"""Photographs of the look round: white and target at either end."""

STEPS = {"camera": LOOKS + len(FRAMES), "rail": 3, "display": LOOKS + len(FRAMES)}
"""Exposures, moves (to either end, and back to the first stop), pictures shown."""

KINDS = {
    "camera": ("timeout", "unplug", "card_full"),
    "rail": ("stall", "limit", "lost_steps"),
    "display": ("sleep",),
}
FAULTS = [
    Fault(device, kind, step)  # type: ignore[arg-type]
    for device, steps in STEPS.items()
    for step in range(1, steps + 1)
    for kind in KINDS[device]
]


class WatchedBench(Bench):
    """Notes what truly stood before the camera at each photograph; draws each picture once for all tests."""

    drawn: dict[tuple[float, bytes], Floats32] = {}  # noqa: RUF012

    def __init__(self, plan_file: Path, *faults: Fault) -> None:
        super().__init__(settings_for(Plan.load(plan_file), 1), faults)
        self.seen: dict[str, tuple[str, float]] = {}

    def expose(self, exposure_s: float, iso: int, name: str) -> NDArray[np.uint16]:
        shown = (
            "dark"
            if self.covered or not self._codes.any()
            else "white"
            if self._codes.all()
            else "target"
        )
        self.seen[Path(name).stem] = shown, self.range_mm
        return super().expose(exposure_s, iso, name)

    def _picture(self) -> Floats32:
        key = self._asked_mm, self._codes.tobytes()
        if key not in self.drawn:
            self.drawn[key] = super()._picture()
        return self.drawn[key]


def run(plan_file: Path, folder: Path, bench: Bench, *observers: Observer) -> Session:
    context = DeviceContext(
        shared=SharedParts({"simulated:": bench}), observers=tuple(observers)
    )
    with (
        begin(plan_file, folder, resume=True) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices)
    return session


def wrong(session: Session, *benches: WatchedBench) -> Iterator[str]:
    """Frames that are not what they are said to be."""
    for frame in session.frames:
        shown, range_mm = next(
            bench.seen[frame.path.stem]
            for bench in benches
            if frame.path.stem in bench.seen
        )
        if shown != FRAMES[frame.path.stem]:
            yield f"{frame.file} shows {shown}"
        if frame.range_mm is not None and abs(range_mm - frame.range_mm) > NEAR_MM:
            yield f"{frame.file} was taken at {range_mm:.3f} mm"


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def told(fault: Fault) -> str:
    return f"{fault.device}-{fault.call}-{fault.kind}"


@pytest.mark.parametrize("fault", FAULTS, ids=told)
def test_a_fault_that_passes_is_noted_and_got_over(
    fault: Fault, plan_file: Path, tmp_path: Path
) -> None:
    bench = WatchedBench(plan_file, fault)
    session = run(plan_file, tmp_path / "s", bench)
    assert [event["device"] for event in session.events if event["event"] == "trouble"] == [
        fault.device
    ]
    assert {frame.path.stem for frame in session.frames} == FRAMES.keys()
    assert verify(session) == list(wrong(session, bench)) == []


@pytest.mark.parametrize("fault", FAULTS, ids=told)
def test_a_fault_that_lasts_is_told_in_a_line_and_resuming_completes(
    fault: Fault, plan_file: Path, tmp_path: Path
) -> None:
    bench, again = (
        WatchedBench(plan_file, Fault(fault.device, fault.kind, fault.call, times=99)),
        WatchedBench(plan_file),
    )
    with pytest.raises(DeviceError) as caught:
        run(plan_file, tmp_path / "s", bench)
    assert "\n" not in str(caught.value)
    taken = {frame.file: frame.sha256 for frame in Session.open(tmp_path / "s").frames}
    session = run(plan_file, tmp_path / "s", again)
    assert {frame.path.stem for frame in session.frames} == FRAMES.keys()
    assert taken.items() <= {frame.file: frame.sha256 for frame in session.frames}.items()
    assert not {Path(file).stem for file in taken} & again.seen.keys()
    assert verify(session) == list(wrong(session, again, bench)) == []


@pytest.mark.parametrize("call", range(1, 50, 2))
def test_a_disk_that_fills_up_at_any_write_ends_in_a_line_and_resuming_completes(
    call: int, plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # every write that counts is followed by a sync; from the one of that number on, none succeeds
    calls, sync = count(1), os.fsync

    def full(handle: int) -> None:
        if next(calls) >= call:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    bench, again = WatchedBench(plan_file), WatchedBench(plan_file)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=r"cannot write .*: No space left on device"):
            run(plan_file, tmp_path / "s", bench)
    session = run(plan_file, tmp_path / "s", again)
    assert {frame.path.stem for frame in session.frames} == FRAMES.keys()
    assert verify(session) == list(wrong(session, again, bench)) == []


class Impatient:
    """Looks on, and presses Ctrl-C as a step begins."""

    def __init__(self, step: int) -> None:
        self._left = step

    def noted(self, event: str, **fields: Any) -> None: ...

    def took(self, *args: Any) -> None: ...

    def may_go_on(self) -> None:
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt


DOING = 2 + 2 * (1 + 2) + (1 + 1) + 2 * (1 + 2 * (1 + 1)) - 1
"""To set the camera, to home; to move and photograph at either end; the dark; to move, show and photograph at two stops,
at the first of which it stands."""


@pytest.mark.parametrize("step", range(1, DOING + 1))
def test_ctrl_c_at_any_step_ends_in_a_session_that_resuming_completes(
    step: int, plan_file: Path, tmp_path: Path
) -> None:
    bench, again = WatchedBench(plan_file), WatchedBench(plan_file)
    with pytest.raises(KeyboardInterrupt):
        run(plan_file, tmp_path / "s", bench, Impatient(step))
    assert Session.open(tmp_path / "s").events[-1]["event"] == "interrupted"
    session = run(plan_file, tmp_path / "s", again)
    assert {frame.path.stem for frame in session.frames} == FRAMES.keys()
    assert verify(session) == list(wrong(session, again, bench)) == []


def test_a_rail_that_does_not_even_stop_does_not_hide_ctrl_c(
    plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stuck(rail: SimulatedRail) -> None:
        raise RailError("gone")

    monkeypatch.setattr(SimulatedRail, "stop", stuck)
    with pytest.raises(KeyboardInterrupt):
        run(plan_file, tmp_path / "s", WatchedBench(plan_file), Impatient(5))
    assert Session.open(tmp_path / "s").events[-1]["event"] == "interrupted"
