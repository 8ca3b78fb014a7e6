"""Capturing on the simulated bench: the whole of it, interrupted, in trouble, badly lit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import missing
from labkit.devices.context import DeviceContext, Devices
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.world import Fault
from labkit.errors import (
    CameraError,
    DataError,
    DeviceError,
    DeviceTimeoutError,
    DisplayError,
    PlanError,
    RailError,
    SessionError,
)
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.session.verify import verify

from .conftest import ContextMaker

ALL = 3 + 2 * (2 + 2)


def run(
    plan_file: Path,
    folder: Path,
    context: DeviceContext,
    resume: bool = False,
    check: bool = True,
) -> Session:
    with (
        begin(plan_file, folder, resume) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices, check=check)
    return session


def test_a_capture_takes_darks_once_and_flats_and_targets_at_every_range(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    session = run(plan_file, tmp_path / "s", make_context(plan_file))
    assert [frame.file for frame in session.frames] == [
        "dark_0.dng", "dark_1.dng", "dark_2.dng",
        "flat_2000_0.dng", "flat_2000_1.dng", "target_2000_0.dng", "target_2000_1.dng",
        "flat_2050.5_0.dng", "flat_2050.5_1.dng", "target_2050.5_0.dng", "target_2050.5_1.dng",
    ]  # fmt: skip
    assert verify(session) == []
    assert missing(session) == ()


def test_frames_of_a_stop_share_the_plans_range_and_note_the_measured_one(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    context = make_context(plan_file)
    session = run(plan_file, tmp_path / "s", context)
    targets = [frame for frame in session.frames if frame.kind == "target"]
    assert {frame.range_mm for frame in targets} == {2000.0, 2050.5}
    visits = next(iter(context.shared.values())).truth.visits
    for visit in visits:
        noted = {
            frame.meta["measured_range_mm"]
            for frame in targets
            if frame.range_mm == visit.range_mm
        }
        assert len(noted) == 1
        assert noted.pop() == pytest.approx(
            visit.actual_range_mm, abs=0.0026
        )  # half a step of the encoder


def test_flats_are_white_targets_are_not_and_darks_are_dark(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    session = run(plan_file, tmp_path / "s", make_context(plan_file))
    level = {
        f.kind: np.median(read_photograph(f.path, session.plan.sensor).counts[::2, 1::2])
        for f in session.frames
    }
    assert level["dark"] == 600
    assert level["flat"] > 9000
    assert level["target"] < level["flat"] / 4


PASSING = [
    Fault("camera", "timeout", 2),
    Fault("camera", "timeout", 5, times=2),
    Fault("camera", "unplug", 6),
    Fault("rail", "stall", 1),
    Fault("rail", "limit", 2),
    Fault("rail", "lost_steps", 2, times=2),
    Fault("display", "sleep", 3),
]


@pytest.mark.parametrize(
    "fault", PASSING, ids=lambda fault: f"{fault.device}-{fault.kind}-{fault.call}"
)
def test_passing_trouble_is_noted_and_got_over(
    fault: Fault, plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    session = run(plan_file, tmp_path / "s", make_context(plan_file, [fault]))
    assert len(session.frames) == ALL
    trouble = [event for event in session.events if event["event"] == "trouble"]
    assert [event["device"] for event in trouble] == [fault.device] * fault.times


# the look round before the first frame takes four photographs of four pictures and moves twice
LASTING = [
    (
        Fault("camera", "timeout", 8, times=99),
        DeviceTimeoutError,
        "no picture came .* within 10 s",
    ),
    (Fault("camera", "unplug", 8, times=99), CameraError, "dropped off USB"),
    (Fault("camera", "card_full", 8, times=99), CameraError, "card is full; empty it"),
    (Fault("rail", "stall", 3, times=99), DeviceTimeoutError, "still not there after 60 s"),
    (Fault("rail", "limit", 3, times=99), RailError, "ran onto a limit switch"),
    (
        Fault("rail", "lost_steps", 3, times=99),
        RailError,
        r"sent to 100\.500 mm and its encoder reads .* mm: it lost steps",
    ),
    (Fault("display", "sleep", 7, times=99), DisplayError, "went to sleep; wake it"),
]


@pytest.mark.parametrize(
    ("fault", "error", "words"), LASTING, ids=lambda x: getattr(x, "kind", None)
)
def test_lasting_trouble_stops_with_a_reason_and_resume_finishes(
    fault: Fault,
    error: type[DeviceError],
    words: str,
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
) -> None:
    with pytest.raises(error, match=words) as caught:
        run(plan_file, tmp_path / "s", make_context(plan_file, [fault]))
    assert "\n" not in str(caught.value)
    kept = {f.file: f.path.read_bytes() for f in Session.open(tmp_path / "s").frames}
    assert 0 < len(kept) < ALL
    session = run(plan_file, tmp_path / "s", make_context(plan_file), resume=True)
    assert len(session.frames) == ALL
    assert verify(session) == []
    assert all(
        (tmp_path / "s" / "frames" / name).read_bytes() == content
        for name, content in kept.items()
    )


@pytest.mark.parametrize(
    ("light", "words"),
    [
        (2.5, r"flat_2000_0, just taken, is overexposed"),
        (0.002, "flat_2000_0, just taken, is black"),
    ],
)
def test_a_badly_exposed_frame_is_put_aside_and_resume_goes_on_when_the_light_is_right(
    light: float, words: str, plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    with pytest.raises(DataError, match=words) as caught:
        run(plan_file, tmp_path / "s", make_context(plan_file, light=light), check=False)
    assert caught.value.exit_status == 2
    assert [path.name for path in (tmp_path / "s" / "rejected").iterdir()] == [
        "flat_2000_0.dng"
    ]
    assert (
        len(run(plan_file, tmp_path / "s", make_context(plan_file), resume=True).frames)
        == ALL
    )


def test_ctrl_c_stops_the_rail_and_leaves_a_session_that_resume_finishes(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    def interrupt(done: int, total: int, name: str) -> None:
        if done == 6:
            raise KeyboardInterrupt

    context = make_context(plan_file)
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=context) as devices,
        pytest.raises(KeyboardInterrupt),
    ):
        run_plan(session, devices, progress=interrupt)
    assert session.events[-1]["event"] == "interrupted"
    assert (
        len(run(plan_file, tmp_path / "s", make_context(plan_file), resume=True).frames)
        == ALL
    )


def test_resuming_what_is_complete_does_nothing(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    before = len(run(plan_file, tmp_path / "s", make_context(plan_file)).events)
    assert (
        len(run(plan_file, tmp_path / "s", make_context(plan_file), resume=True).events)
        == before
    )


def test_resume_begins_where_nothing_was_begun(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    assert (
        len(run(plan_file, tmp_path / "s", make_context(plan_file), resume=True).frames)
        == ALL
    )


def test_without_resume_a_begun_session_is_left_alone(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    run(plan_file, tmp_path / "s", make_context(plan_file))
    with pytest.raises(SessionError, match="--resume"):
        begin(plan_file, tmp_path / "s", resume=False)


def test_resuming_with_another_plan_is_refused_and_names_what_differs(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    run(plan_file, tmp_path / "s", make_context(plan_file))
    plan_file.write_text(
        plan_file.read_text().replace("2050.5", "2060").replace("darks = 3", "darks = 4")
    )
    with pytest.raises(
        PlanError,
        match=r"differs in \[camera\], \[rail\] from the one that the photographs in",
    ):
        begin(plan_file, tmp_path / "s", resume=True)


def test_a_plan_may_be_mended_until_the_first_photograph(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    right, context = plan_file.read_text(), make_context(plan_file)
    plan_file.write_text(right.replace("exposure_s = 0.02", "exposure_s = 2.0"))
    with pytest.raises(DataError, match="overexposed"):
        run(plan_file, tmp_path / "s", context, check=True)
    assert Session.open(tmp_path / "s").frames == ()
    plan_file.write_text(right)
    session = run(plan_file, tmp_path / "s", make_context(plan_file), resume=True)
    assert len(session.frames) == ALL
    assert session.plan == Plan.load(plan_file)
    assert [event["event"] for event in session.events].count("replanned") == 1
    assert verify(Session.open(tmp_path / "s")) == []


def test_a_range_beyond_the_rail_is_refused_before_anything_moves(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    context = make_context(plan_file)
    plan_file.write_text(plan_file.read_text().replace("2050.5", "2450, 1940"))
    words = r"2450 mm \(rail position 500 mm\), 1940 mm \(rail position -10 mm\): the rail goes from -5 to 105\.5 mm"
    with pytest.raises(PlanError, match=f"{words}, ranges 1945 to 2055.5 mm"):
        run(plan_file, tmp_path / "s", context)
    assert Session.open(tmp_path / "s").frames == ()


class BareCamera:
    """A camera that cannot cover its own lens."""

    def __init__(self, devices: Devices) -> None:
        for name in ("identify", "configure", "expose", "close"):
            setattr(self, name, getattr(devices.camera, name))


def test_a_person_is_asked_for_the_cap_where_the_camera_has_none(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    context = make_context(plan_file)
    bench = next(iter(context.shared.values()))
    asked = []

    def ask(words: str) -> None:
        asked.append(words)
        bench.covered = words.startswith("Put")

    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        bare = Devices(BareCamera(devices), devices.rail, devices.display, devices.wait)  # type: ignore[arg-type]
        with pytest.raises(
            PlanError,
            match=r"run this at a terminal or with --monitor, or set camera\.darks = 0",
        ):
            run_plan(session, bare)
        run_plan(session, bare, ask=ask)
    assert asked == ["Put the cap on the lens", "Take the cap off the lens"]
    assert len(session.frames) == ALL


def test_time_passes_on_the_benchs_own_clock(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    context = make_context(plan_file)
    run(plan_file, tmp_path / "s", context)
    # 5 mm home, up to 100.5 mm from -5 mm, back to 50 mm by way of 49, up to 100.5 mm, at 20 mm/s; three settlings of 1 s;
    # eleven exposures of 0.02 s, and four to look round
    assert next(iter(context.shared.values())).clock_s == pytest.approx(
        (5 + 105.5 + 51.5 + 1 + 50.5) / 20 + 3 + 15 * 0.02
    )
