"""Simulated ports: they unplug and come back as real ones do, and leave nothing behind."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from labkit.drivers.grbl.rail import GrblRail
from labkit.drivers.serial.wire import SerialWire
from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.motion import Braking, Move
from labkit.drivers.simulated.controllers.pty_port import LineFault
from labkit.errors import RailError

FAST = {24: 60_000, 25: 600_000, 110: 60_000, 120: 20_000}


def handles() -> set[tuple[str, str]]:
    """The process's open files, each with what it leads to: others may close theirs meanwhile."""
    return {
        (handle.name, os.readlink(handle))
        for handle in Path("/proc/self/fd").iterdir()
        if handle.is_symlink()  # the handle that lists the folder is closed by now
    }


def again_and_again(action: Callable[[], object]) -> None:
    while True:
        action()


def test_a_dozen_rails_and_many_moves_leave_no_thread_no_handle_no_folder_behind() -> None:
    threads, before = set(threading.enumerate()), handles()
    folders = []
    for round_ in range(12):
        port = grbl_port(settings=FAST)
        folders.append(Path(port.path).parent)
        with GrblRail(port.path, reply_s=0.5, after_close=port.close) as rail:
            rail.home()
            for stop in range(20 if round_ == 0 else 1):
                rail.move_to(-20.0 - stop)
    assert not set(threading.enumerate()) - threads
    assert not handles() - before
    assert not [folder for folder in folders if folder.exists()]


def test_a_line_that_comes_back_again_and_again_costs_no_handle() -> None:
    port = grbl_port(settings=FAST)
    with GrblRail(port.path, reply_s=0.5, back_s=2.0, after_close=port.close) as rail:
        rail.home()
        before = handles()
        for _ in range(10):
            port.strike("unplug", lasts_s=0.05)
            with pytest.raises(RailError, match="plug the rail in again"):
                again_and_again(lambda: rail.move_to(-50.0))
            rail.home()
            assert rail.move_to(-50.0) == pytest.approx(-50.0, abs=0.004)
        assert len(handles()) <= len(before)


def test_an_unplugged_port_is_gone_as_pyserial_sees_it() -> None:
    # what was seen of real pseudo-terminals: an error on reading and writing, and no such file on opening again
    port = grbl_port()
    try:
        with serial.Serial(port.path, timeout=0.2) as line:
            line.read(200)
            port.strike("unplug", lasts_s=60)
            with pytest.raises(serial.SerialException):
                again_and_again(lambda: (line.write(b"?"), line.read(200)))
        with pytest.raises(serial.SerialException, match="No such file"):
            serial.Serial(port.path)
    finally:
        port.close()


@pytest.mark.parametrize(
    ("fault", "heard"),
    [
        (LineFault("stale", r"\$I"), "ok"),
        (LineFault("garbage", r"\$I"), "\ufffd\x00[VER:1.1h.2\ufffd190830:]"),
        (LineFault("partial", r"\$I", lasts_s=0.05), "[VER:1.1h.20190830:]"),
        (LineFault("torn", r"\$I"), "[VER:1.1h.2[OPT:V,15,128]"),
        (LineFault("silence", r"\$I", lasts_s=60), None),
        (LineFault("late", r"\$I", lasts_s=0.1), "[VER:1.1h.20190830:]"),
    ],
)
def test_faults_of_the_line_are_what_they_say(fault: LineFault, heard: str | None) -> None:
    port = grbl_port(faults=[fault])
    try:
        wire = SerialWire(port.path, 115200)
        while wire.line(time.monotonic() + 0.1) is not None:
            pass  # the banner
        wire.send(b"$I\n")
        assert wire.line(time.monotonic() + 1.0) == heard
        wire.close()
    finally:
        port.close()


def test_noise_without_end_is_thrown_away() -> None:
    near, far = os.openpty()
    wire = SerialWire(os.ttyname(far), 115200)
    for _ in range(3):
        os.write(near, b"x" * 900)
        assert wire.line(time.monotonic() + 0.05) is None
    os.write(near, b"\nok\n")
    lines = [wire.line(time.monotonic() + 0.5), wire.line(time.monotonic() + 0.5)]
    assert "ok" in lines
    wire.close()
    os.close(near)
    os.close(far)


def test_a_move_keeps_its_times_and_its_acceleration() -> None:
    # 100 mm at 50 mm/s with 500 mm/s²: 0.1 s up, 1.9 s at speed, 0.1 s down
    move = Move((0.0,), (100.0,), 3.0, 50.0, 500.0)
    assert move.end_s == pytest.approx(5.1)
    assert move.along(3.1) == pytest.approx((2.5, 50.0))
    assert move.along(4.0) == pytest.approx((47.5, 50.0))
    assert move.along(5.0) == pytest.approx((97.5, 50.0))
    assert move.along(9.0) == (100.0, 0.0)
    # too short to reach its speed: 0.2 s up to 20 mm/s after 2 mm, and down again
    short = Move((0.0,), (4.0,), 0.0, 50.0, 100.0)
    assert short.end_s == pytest.approx(0.4)
    assert short.along(0.2) == pytest.approx((2.0, 20.0))


def test_braking_takes_its_way_and_no_more() -> None:
    move = Move((0.0, 5.0), (100.0, 5.0), 0.0, 50.0, 500.0)
    braking = Braking(move, 1.0)  # at 47.5 mm and 50 mm/s: 0.1 s and 2.5 mm
    assert braking.end_s == pytest.approx(1.1)
    assert braking.position(1.1) == pytest.approx((50.0, 5.0))
    assert braking.position(9.0) == pytest.approx((50.0, 5.0))
