"""Captures on serial rails: trouble while a photograph is taken, slips, and Ctrl-C in mid-move."""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL
from labkit.drivers.simulated.controllers.zaber import ZaberController
from labkit.session.session import Session

from .rails_in_trouble import (
    FAST,
    FAULTS,
    MICROSTEP_MM,
    NEAR_MM,
    RAILS,
    Bench,
    Photographs,
    run,
    side_by_side,
    wrong_frames,
)

pytestmark = pytest.mark.timeout(600)  # of a machine that does much else


def once(name: str, do: Callable[[], None]) -> Callable[[str], None]:
    """To be called before each exposure: does it before the first of that name."""
    left = [do]
    return lambda what: left.pop()() if what == name and left else None


@pytest.mark.parametrize("kind", RAILS)
def test_trouble_while_exposing_spoils_no_frame(
    kind: str, photographs: Photographs, tmp_path: Path
) -> None:
    def found(name: str, folder: Path) -> list[str]:
        setup, port = RAILS[kind], RAILS[kind].port([])
        bench = Bench(photographs, setup, port)
        bench.before_exposure = once("flat_2150_0", lambda: port.strike(*FAULTS[name]))
        try:
            ended = run(setup, bench, folder)
        finally:
            port.close()
        session = Session.open(folder)
        frames = (
            2 if name == "unplugged for good" else 6
        )  # what was taken while it went is not trusted
        if len(session.frames) != frames or (ended is None) != (frames == 6):
            return [f"{name}: {len(session.frames)} frames, {ended}"]
        return wrong_frames(session, bench, setup)

    assert side_by_side(found, tmp_path) == []


def test_a_frame_during_which_the_stage_was_moved_is_taken_again(
    photographs: Photographs, tmp_path: Path
) -> None:
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
    # steps alone do not tell: this holds what docs/guides/bench.md says of rails without an encoder
    port = RAILS["grbl"].port([])
    controller = port.controller
    assert isinstance(controller, GrblController)
    with RAILS["grbl"].rail(port) as rail:
        rail.home()
        port.strike("slip")
        rail.move_to(-100.0)
        assert controller.machine.carriage_mm(controller.now_s) == pytest.approx(
            -97.0, abs=NEAR_MM
        )
        rail.home()
        rail.move_to(-100.0)
        assert controller.machine.carriage_mm(controller.now_s) == pytest.approx(
            -100.0, abs=NEAR_MM
        )
    port.close()


def test_ctrl_c_in_mid_move_stops_the_carriage_and_resume_finishes(
    photographs: Photographs, tmp_path: Path
) -> None:
    slow = replace(
        RAILS["grbl"],
        port=lambda faults: grbl_port(GRBL, {**FAST, 110: 12_000}, faults=faults),
    )
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
