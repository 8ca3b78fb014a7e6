"""Which homing of the rail a photograph was taken after: counted through the whole session."""

from __future__ import annotations

from pathlib import Path

import pytest

from labkit.acquisition.capture import run_plan
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.world import Fault
from labkit.errors import SessionError
from labkit.session.session import Session, begin

from .conftest import ContextMaker

SECOND_STOP = 3
"""The look round moves to the far end and to the near one, where the capture begins; the next move is to the second stop."""


def run(plan_file: Path, folder: Path, context: DeviceContext) -> Session:
    with (
        begin(plan_file, folder, resume=True) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices)
    return session


def homings(session: Session) -> dict[float | None, set[int | None]]:
    """Those of the frames of each range."""
    ranges = {frame.range_mm for frame in session.frames}
    return {
        mm: {f.meta.get("homing") for f in session.frames if f.range_mm == mm}
        for mm in ranges
    }


def test_frames_note_the_homing_and_darks_need_none(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    session = run(plan_file, tmp_path / "s", make_context(plan_file))
    assert homings(session) == {None: {None}, 2000.0: {1}, 2050.5: {1}}
    assert [event["homing"] for event in session.events if event["event"] == "homed"] == [1]


def test_a_recovery_after_lost_steps_is_another_homing(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    session = run(
        plan_file,
        tmp_path / "s",
        make_context(plan_file, [Fault("rail", "lost_steps", SECOND_STOP)]),
    )
    assert homings(session) == {None: {None}, 2000.0: {1}, 2050.5: {2}}


def test_a_resumed_capture_counts_on(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    with pytest.raises(BaseException, match="card is full"):
        # four photographs of the look round, three darks, four at the first stop, one at the second
        run(
            plan_file,
            tmp_path / "s",
            make_context(plan_file, [Fault("camera", "card_full", 4 + 3 + 4 + 2, times=9)]),
        )
    session = run(plan_file, tmp_path / "s", make_context(plan_file))
    assert homings(session) == {None: {None}, 2000.0: {1}, 2050.5: {1, 2}}
    assert homings(Session.open(tmp_path / "s")) == homings(session)


@pytest.mark.parametrize("homing", [0, 1.5, True, "1"])
def test_a_homing_that_is_no_count_is_refused(
    homing: object, plan_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "a.dng").write_bytes(b"a")
    with begin(plan_file, tmp_path / "s", resume=False) as session:
        session.log("homed", homing=1)
        session.add_frame(tmp_path / "a.dng", "a.dng", "target", 2000.0, homing=homing)
    with pytest.raises(SessionError, match="homing"):
        Session.open(tmp_path / "s")
