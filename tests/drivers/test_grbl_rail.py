"""The GRBL driver, on simulated controllers behind a real pseudo-terminal."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Check, Rail, Travel
from labkit.devices.shared import SharedParts
from labkit.drivers.grbl.protocol import Report, homing_s, moving_s, read_report, travel
from labkit.drivers.grbl.rail import GrblRail, open_rail
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.controllers.grbl import LEADSCREW, grbl_port
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, GRBL_HAL, Firmware
from labkit.drivers.simulated.controllers.pty_port import LineFault, PtyPort
from labkit.drivers.simulated.world import BenchSettings, TruePanel, TrueSensor
from labkit.errors import DeviceTimeoutError, PlanError, RailError, RailLimitError
from tests.drivers.test_simulated_devices import plan

from .stops import error_of_a_move_stopped, error_of_a_move_stopped_before_it_began

FAST = {24: 60_000, 25: 600_000, 110: 60_000, 120: 20_000}
STEP_MM = 0.004


@contextmanager
def a_port(
    settings: Mapping[int, float] | None = None,
    firmware: Firmware = GRBL,
    options: str = "V",
    faults: tuple[LineFault, ...] = (),
) -> Iterator[PtyPort]:
    port = grbl_port(firmware, FAST | dict(settings or {}), options, faults)
    try:
        yield port
    finally:
        port.close()


def a_rail(port: PtyPort) -> GrblRail:
    return GrblRail(port.path, reply_s=0.5, back_s=0.5)


def controller_of(port: PtyPort) -> GrblController:
    assert isinstance(port.controller, GrblController)
    return port.controller


def carriage_mm(port: PtyPort) -> float:
    with port.lock:
        return controller_of(port).machine.carriage_mm(controller_of(port).now_s)


@pytest.mark.parametrize(
    "firmware", [GRBL, GRBL_HAL], ids=lambda firmware: firmware.banner.split()[0]
)
def test_a_homed_rail_stands_where_it_was_sent(firmware: Firmware) -> None:
    with a_port(firmware=firmware) as port, a_rail(port) as rail:
        keeps: Rail = rail
        keeps.home()
        for asked_mm in (-200.0, -100.5, -100.5, -291.9):
            assert keeps.move_to(asked_mm) == pytest.approx(asked_mm, abs=STEP_MM)
            assert carriage_mm(port) == pytest.approx(asked_mm, abs=STEP_MM)


def test_every_stop_is_approached_from_below() -> None:
    places: list[float] = []
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        controller_of(port).moved = places.append
        for asked_mm in (-100.0, -200.0, -150.0):
            rail.move_to(asked_mm)
    assert places == pytest.approx([-101, -100, -201, -200, -151, -150])


def test_a_rail_must_be_homed_before_it_moves() -> None:
    with (
        a_port() as port,
        a_rail(port) as rail,
        pytest.raises(RailError, match="home it first"),
    ):
        rail.move_to(-100.0)


@pytest.mark.parametrize("asked_mm", [-292.1, -1.9, float("nan")])
def test_a_stop_outside_the_travel_is_refused_before_anything_moves(
    asked_mm: float,
) -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        with pytest.raises(RailLimitError, match=r"mm is outside -292\.\.-2 mm"):
            rail.move_to(asked_mm)
        assert carriage_mm(port) == pytest.approx(-293.0)


@pytest.mark.parametrize(
    ("settings", "options", "is_hal", "expected"),
    [
        ({23: 1}, "V", False, Travel(-293, -2)),
        ({23: 0}, "V", False, Travel(-293, -2)),
        ({23: 1}, "VZ", False, Travel(0, 293)),
        ({23: 0}, "VZ", False, Travel(-293, 0)),
        ({23: 1, 22: 9}, "VNML+", True, Travel(0, 293)),
        ({23: 1, 22: 1}, "VZ", True, Travel(-293, -2)),
    ],
)
def test_travel_follows_where_the_machine_counts_from(
    settings: dict[int, float], options: str, is_hal: bool, expected: Travel
) -> None:
    assert travel(LEADSCREW | settings, is_hal, options) == expected


@pytest.mark.parametrize(("options", "asked_mm"), [("V", -150.0), ("VZ", 150.0)])
def test_a_machine_with_its_zero_at_home_counts_upwards(
    options: str, asked_mm: float
) -> None:
    with a_port({23: 1}, options=options) as port, a_rail(port) as rail:
        rail.home()
        assert rail.move_to(asked_mm) == pytest.approx(asked_mm, abs=STEP_MM)


def test_reports_of_work_positions_are_counted_from_the_machines_zero() -> None:
    with a_port({10: 0}) as port, a_rail(port) as rail:
        with port.lock:
            controller_of(port).offset_mm[0] = -37.5
        rail.home()
        assert rail.move_to(-100.0) == pytest.approx(-100.0, abs=STEP_MM)
        assert carriage_mm(port) == pytest.approx(-100.0, abs=STEP_MM)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({22: 0, 20: 0}, r"homing turned off \(\$22=0\).* set \$22=1"),
        ({13: 1}, r"inches \(\$13=1\); set \$13=0"),
        ({130: 3}, r"no room to move: travel \$130 = 3 mm"),
        ({130: 0}, r"its travel in mm \$130=0; allowed is above 0, .*: set \$130"),
        ({130: -300}, r"its travel in mm \$130=-300; .*: set \$130"),
        ({130: 2147483.648}, r"its travel in mm \$130=2.14748e\+06; .*: set \$130"),
        ({110: 0}, r"its largest speed in mm/min \$110=0; .*: set \$110"),
        ({110: -500}, r"its largest speed in mm/min \$110=-500; .*: set \$110"),
        ({25: 0}, r"searches for its limit switch \$25=0; .*: set \$25"),
        ({24: 0}, r"approaches its limit switch \$24=0; .*: set \$24"),
        ({27: 0}, r"backs off its limit switch in mm \$27=0; .*: set \$27"),
        ({120: 0}, r"its acceleration in mm/s² \$120=0; .*: set \$120"),
        ({100: 0}, r"its steps per mm \$100=0; .*: set \$100"),
        ({110: float("nan")}, r"no number as its setting \$110; set \$110 again"),
        ({25: float("inf")}, r"no number as its setting \$25; set \$25 again"),
    ],
)
def test_settings_that_no_rail_can_be_driven_with_are_refused(
    settings: dict[int, float], words: str
) -> None:
    with a_port(settings) as port, pytest.raises(RailError, match=words):
        a_rail(port)


@pytest.mark.parametrize(
    "reports", [2, 0, 1023], ids=["no offset", "nothing", "parser state"]
)
def test_reports_of_grblhal_that_a_position_cannot_be_told_from_are_refused_at_once(
    reports: int,
) -> None:
    with (
        a_port({10: reports}, GRBL_HAL) as port,
        pytest.raises(RailError, match=rf"\(\$10={reports}\).*set \$10=511"),
    ):
        a_rail(port)


def test_reports_of_grblhals_work_positions_with_their_offset_are_enough() -> None:
    with a_port({10: 32}, GRBL_HAL) as port, a_rail(port) as rail:
        with port.lock:
            controller_of(port).offset_mm[0] = -37.5
        rail.home()
        assert rail.move_to(-100.0) == pytest.approx(-100.0, abs=STEP_MM)


def test_settings_other_than_the_docs_ask_for_are_named_for_a_person_to_look_at() -> None:
    with a_port() as port, a_rail(port) as rail:
        assert rail.check(1) == Check()
    with a_port({1: 25, 20: 0, 21: 0, 130: 200}) as port, a_rail(port) as rail:
        check = rail.check(1)
    assert check.problems == ()
    assert [words.split()[2].rstrip(":;,") for words in check.by_hand] == [
        "$1=25",
        "$20=0",
        "$21=0",
        "$130=200",
    ]
    assert (
        "motors are let go 25 ms after each move, and the carriage may creep; set $1=255"
        in check.by_hand[0]
    )


def test_homing_without_a_switch_ends_with_the_alarm_in_words() -> None:
    with a_port() as port, a_rail(port) as rail:
        with port.lock:
            controller_of(port).machine.switch_works = False
        with pytest.raises(
            RailError, match="alarm 9: homing did not find the limit switch"
        ):
            rail.home()
        with port.lock:
            controller_of(port).machine.switch_works = True
        rail.home()
        assert rail.move_to(-100.0) == pytest.approx(-100.0, abs=STEP_MM)


def test_a_port_that_is_held_is_not_shared() -> None:
    with (
        a_port() as port,
        a_rail(port),
        pytest.raises(RailError, match="held by another program; `labkit devices`"),
    ):
        a_rail(port)


def test_a_port_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(RailError, match=r"there is no serial port /dev/ttyNOPE; found: "):
        GrblRail("/dev/ttyNOPE")


def test_a_file_is_no_port() -> None:
    with pytest.raises(RailError, match="does not open as a serial port"):
        GrblRail("/dev/null")


@contextmanager
def a_talker(answer: bytes) -> Iterator[str]:
    """A device that answers the same to everything."""
    near, far = os.openpty()
    tty.setraw(far)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            os.read(near, 100)
            os.write(near, answer)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield os.ttyname(far)
    finally:
        stop.set()
        os.write(far, b"x")
        thread.join(5)
        os.close(near)
        os.close(far)


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        (
            b"Grbl 0.9j ['$' for help]\r\n",
            RailError,
            r'runs "Grbl 0\.9j .*"; GRBL 1\.1 or grblHAL is needed',
        ),
        (
            b"echo:Marlin 2.1\r\nok\r\n",
            DeviceTimeoutError,
            "does not answer as GRBL at 115200 baud",
        ),
        (b"\xff\x00\xfe" * 700, DeviceTimeoutError, "does not answer as GRBL"),
        (b"", DeviceTimeoutError, "look at its power and its cable"),
    ],
)
def test_what_is_no_grbl_1_1_is_told_so(
    answer: bytes, error: type[Exception], words: str
) -> None:
    with a_talker(answer) as path, pytest.raises(error, match=words):
        GrblRail(path, reply_s=0.2)


@pytest.mark.parametrize("late_s", [0.55, 0.7, 0.9])
def test_banners_of_two_resets_are_both_awaited(late_s: float) -> None:
    with a_port() as port:
        port.strike("late", late_s)
        with a_rail(port) as rail:
            rail.home()
            assert rail.move_to(-150.0) == pytest.approx(-150.0, abs=0.01)


def test_a_stop_from_another_thread_keeps_the_position() -> None:
    with a_port({110: 3000, 120: 500}) as port, a_rail(port) as rail:
        rail.home()
        moving = threading.Event()
        controller = controller_of(port)
        controller.noticed = lambda command: (
            moving.set() if controller.state == "Run" and command == "?" else None
        )
        assert "was stopped" in error_of_a_move_stopped(rail, -20.0, moving)
        assert -293.0 < carriage_mm(port) < -20.0
        # it still knows where it is, without homing, and is right
        assert rail.move_to(-100.0) == pytest.approx(-100.0, abs=STEP_MM)
        assert carriage_mm(port) == pytest.approx(-100.0, abs=STEP_MM)


def test_a_stop_just_before_a_move_is_obeyed() -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        before_mm = carriage_mm(port)
        assert "was stopped" in error_of_a_move_stopped_before_it_began(
            rail, -150.0, controller_of(port), "?"
        )
        assert carriage_mm(port) == pytest.approx(before_mm, abs=0.01)
        assert rail.move_to(-150.0) == pytest.approx(-150.0, abs=0.01)


def test_a_stop_while_homing_loses_the_position() -> None:
    with a_port({25: 3000}) as port, a_rail(port) as rail:
        homing = threading.Event()
        controller_of(port).noticed = lambda command: (
            homing.set() if command == "$H" else None
        )
        failed: list[Exception] = []

        def home() -> None:
            try:
                rail.home()
            except RailError as error:
                failed.append(error)

        thread = threading.Thread(target=home)
        thread.start()
        assert homing.wait(5)
        rail.stop()
        thread.join(10)
        assert failed
        with pytest.raises(RailError, match="home it first"):
            rail.move_to(-100.0)


def test_a_stop_at_rest_changes_nothing() -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        rail.move_to(-100.0)
        rail.stop()
        assert rail.move_to(-120.0) == pytest.approx(-120.0, abs=STEP_MM)


def test_a_hold_that_someone_pressed_is_told_and_homing_goes_on() -> None:
    with (
        a_port({110: 6000}, faults=(LineFault("slip", "never"),)) as port,
        a_rail(port) as rail,
    ):
        rail.home()
        controller = controller_of(port)
        controller.noticed = lambda command: (
            controller.receive(b"!") if command.startswith("G4") else None
        )
        with pytest.raises(RailError, match=r"was stopped \(it reports Hold:\d\); home it"):
            rail.move_to(-20.0)
        controller.noticed = lambda command: None
        with pytest.raises(RailError, match="home it first"):
            rail.move_to(-20.0)
        rail.home()
        assert rail.move_to(-200.0) == pytest.approx(-200.0, abs=STEP_MM)


def test_a_counter_that_jumps_between_moves_is_noticed() -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        rail.move_to(-100.0)
        with port.lock:
            controller_of(port).machine.position = (-93.0, -293.0, -293.0)
        with pytest.raises(
            RailError,
            match=r"was left at -100\.000 mm and now reports -93\.000 mm; its position is lost",
        ):
            rail.move_to(-150.0)


def test_locks_are_never_lifted_without_homing() -> None:
    # $X would let it move with its position unknown; "$H=1" wedges the firmware
    heard: list[str] = []
    with a_port(faults=(LineFault("alarm", r"G53.*"),)) as port:
        inner = controller_of(port).noticed

        def listen(command: str) -> None:
            heard.append(command)
            inner(command)

        controller_of(port).noticed = listen
        with a_rail(port) as rail:
            rail.home()
            with pytest.raises(
                RailError,
                match="alarm 1: it ran onto a limit switch; its position is lost: home it",
            ):
                rail.move_to(-100.0)
            rail.home()
            rail.move_to(-100.0)
    assert not [command for command in heard if command.startswith(("$X", "$H="))]
    assert all(len(command) < 80 for command in heard)


def test_closing_stops_what_is_under_way() -> None:
    with a_port({110: 600}) as port:
        rail = a_rail(port)
        rail.home()
        with port.lock:
            controller_of(port).noticed = lambda command: None
        with pytest.raises(DeviceTimeoutError):
            rail._carry_out(["G53 G0 X-20", "G4 P0.01"], -0.4, watch=False)
        rail.close()
        with port.lock:
            assert controller_of(port).machine.motion is None
        rail.close()


def test_an_address_without_a_port_is_refused() -> None:
    with pytest.raises(PlanError, match="give the port as well, such as grbl:/dev/ttyUSB0"):
        open_rail("grbl:", plan(), DeviceContext())


def test_a_simulated_controller_carries_the_simulated_benchs_camera() -> None:
    sensor, panel = TrueSensor(rows=32, cols=48), TruePanel(pixels=(300, 400))
    bench = Bench(BenchSettings(sensor=sensor, panel=panel))
    with open_rail(
        "grbl:simulated", plan(), DeviceContext(shared=SharedParts({"simulated:": bench}))
    ) as rail:
        rail.home()
        assert rail.move_to(60.0) == pytest.approx(60.0, abs=STEP_MM)
        # the bench's own scatter has a standard deviation of 0.02 mm
        assert bench.position_mm == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize(
    ("line", "report"),
    [
        (
            "<Idle|MPos:-250.000,-293.000,-293.000|Bf:15,128|FS:0,0>",
            Report("Idle", -250.0, True, None),
        ),
        (
            "<Alarm|MPos:0.000,0.000,0.000|Bf:15,128|FS:0,0|WCO:1.500,0.000,0.000>",
            Report("Alarm", 0.0, True, 1.5),
        ),
        ("<Hold:1|WPos:3.250|FS:0,0|Pn:X|WCO:-7.000>", Report("Hold:1", 3.25, False, -7.0)),
        (
            "<Home|MPos:0.000,0.000,0.000|Bf:100,1023|FS:0,0|WCO:0.000,0.000,0.000|H:0>",
            Report("Home", 0, True, 0.0),
        ),
        ("<Idle|MPos:-250.000,-293.000,-293.000|Bf:15,128|FS:0,0", None),
        ("<Idle|MPos:-25\ufffd.000,-293.000,-293.000|Bf:15,128|FS:0,0>", None),
        ("<Idle|MPos:-250.000,-293.0<Idle|MPos:-250.000,-293.000,-293.000|FS:0,0>", None),
        ("ok", None),
    ],
)
def test_reports_are_read_whole_or_not_at_all(line: str, report: Report | None) -> None:
    assert read_report(line) == report


@given(st.text(max_size=60))
def test_no_text_breaks_the_reader(text: str) -> None:
    assert read_report(text) is None or text.startswith("<")


def test_times_allowed_are_those_of_the_machine() -> None:
    # 50 mm/s after 2.5 mm of ramp at 500 mm/s²: 100 mm take 2.0 s and the ramps 0.1 s more
    assert moving_s(LEADSCREW, 100.0) == pytest.approx(2.2)
    # 1.5 times 295 mm at 50 mm/s and ten pull-offs of 2 mm at 5 mm/s, twice
    assert homing_s(LEADSCREW) == pytest.approx(2 * (8.85 + 4.0))
