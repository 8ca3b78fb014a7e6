"""The Zaber driver and the Zaber simulator, each against something else: a transcript, Zaber's own library."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Rail
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.controllers.pty_port import LineFault, PtyPort
from labkit.drivers.simulated.controllers.zaber import ZaberController
from labkit.drivers.simulated.world import BenchSettings, TruePanel, TrueSensor
from labkit.drivers.zaber.protocol import checksum, command_line, read_reply
from labkit.drivers.zaber.rail import ZaberRail, open_rail
from labkit.errors import DeviceTimeoutError, PlanError, RailError, RailLimitError
from tests.drivers.test_simulated_devices import plan

from .stops import error_of_a_move_stopped, error_of_a_move_stopped_before_it_began

MICROSTEP_MM = 0.49609375e-3
TRANSCRIPT = Path(__file__).parent / "transcripts" / "zaber-ascii.txt"


@contextmanager
def a_port(*faults: LineFault, speed: float = 2e6) -> Iterator[PtyPort]:
    port = PtyPort(ZaberController(speed=speed, acceleration=2e7), faults)
    try:
        yield port
    finally:
        port.close()


def a_rail(port: PtyPort) -> ZaberRail:
    return ZaberRail(port.path, MICROSTEP_MM, reply_s=0.5, back_s=0.5)


def controller_of(port: PtyPort) -> ZaberController:
    assert isinstance(port.controller, ZaberController)
    return port.controller


def carriage_mm(port: PtyPort) -> float:
    with port.lock:
        return controller_of(port).carriage * MICROSTEP_MM


def test_the_simulator_says_what_zabers_own_library_was_recorded_to_hear() -> None:
    controller = ZaberController(carriage=5000, speed=40_000.0)
    controller.power_on()
    recorded = [line.split(" ", 1) for line in TRANSCRIPT.read_text().splitlines()]
    compared = 0
    for (sent, command), (heard, reply) in zip(recorded[::2], recorded[1::2], strict=False):
        assert (sent, heard) == (">", "<")
        # the recorded device took as long as it took: ours is let finish where that one had
        due_s = controller.due_s()
        if due_s is not None and " IDLE " in reply:
            controller.advance(due_s)
        controller.receive(f"{command}\n".encode())
        assert controller.advance(controller.now_s).decode() == f"{reply}\r\n"
        compared += 1
    assert compared == 37  # every command


@pytest.mark.parametrize(
    ("text", "check"),
    [
        ("/1 1 03 home", "32"),
        ("/0 0 00", "00"),
        ("/1 1 12 move abs 1000", "ED"),
        ("@01 0 27 OK IDLE -- 12345", "35"),
    ],
)
def test_checksums_are_those_recorded(text: str, check: str) -> None:
    assert checksum(text) == check


def test_a_command_carries_its_id_and_checksum() -> None:
    assert command_line(1, 1, 4, "") == b"/1 1 04:FA\n"
    assert command_line(1, 0, 24, "get deviceid") == b"/1 0 24 get deviceid:3C\n"


@pytest.mark.parametrize(
    "line",
    ["@01 1 10 OK IDLE -- 0:0C", "!01 1 IDLE --:00", "#01 1 text:00", "@01 1 10 OK", ""],
)
def test_what_is_no_sound_reply_is_dropped(line: str) -> None:
    assert read_reply(line) is None


@given(st.integers(0, 20), st.integers(0, 255))
def test_one_damaged_byte_never_passes(place: int, byte: int) -> None:
    sound = bytearray(b"@01 1 21 OK IDLE -- 1000:78")
    if sound[place] != byte:
        sound[place] = byte
        assert read_reply(sound.decode("latin-1")) is None


@given(st.text(max_size=40))
def test_no_text_breaks_the_reader_or_the_simulator(text: str) -> None:
    read_reply(text)
    controller = ZaberController()
    controller.receive(text.encode() + b"\n")
    controller.receive(b"/1 1 00\n")
    assert controller.advance(1.0).endswith(b"@01 1 00 OK IDLE WR 0\r\n")


def test_zabers_own_library_drives_the_simulator() -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii")
    from zaber_motion import Units
    from zaber_motion.exceptions import CommandFailedException

    with a_port() as port, ascii_.Connection.open_serial_port(port.path) as connection:
        (device,) = connection.detect_devices(identify_devices=False)
        axis = device.get_axis(1)
        assert axis.warnings.get_flags() == {"WR"}
        axis.home()
        assert axis.warnings.get_flags() == set()
        axis.move_absolute(100_000, Units.NATIVE)
        assert axis.get_position(Units.NATIVE) == 100_000
        axis.move_relative(-20_000, Units.NATIVE)
        assert axis.get_position(Units.NATIVE) == 80_000
        assert controller_of(port).carriage == 80_000
        with pytest.raises(CommandFailedException, match="BADDATA"):
            axis.move_absolute(10_000_000, Units.NATIVE)
        axis.move_absolute(250_000, Units.NATIVE, wait_until_idle=False)
        axis.stop()
        assert not axis.is_busy()


def test_what_our_driver_did_zabers_own_library_sees() -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii")
    from zaber_motion import Units

    with a_port() as port:
        with a_rail(port) as rail:
            rail.home()
            at_mm = rail.move_to(30.0)
        with ascii_.Connection.open_serial_port(port.path) as connection:
            axis = connection.get_device(1).get_axis(1)
            assert axis.get_position(Units.NATIVE) * MICROSTEP_MM == pytest.approx(at_mm)


def test_a_homed_rail_stands_where_it_was_sent() -> None:
    with a_port() as port, a_rail(port) as rail:
        keeps: Rail = rail
        keeps.home()
        for asked_mm in (20.0, 100.0, 100.0, 1.0):
            assert keeps.move_to(asked_mm) == pytest.approx(asked_mm, abs=MICROSTEP_MM)
            assert carriage_mm(port) == pytest.approx(asked_mm, abs=MICROSTEP_MM)


def test_every_stop_is_approached_from_below() -> None:
    places: list[float] = []
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        controller_of(port).moved = lambda carriage: places.append(carriage * MICROSTEP_MM)
        rail.move_to(80.0)
        rail.move_to(40.0)
    assert places == pytest.approx([79, 80, 39, 40], abs=MICROSTEP_MM)


def test_a_rail_must_be_homed_before_it_moves() -> None:
    with (
        a_port() as port,
        a_rail(port) as rail,
        pytest.raises(RailError, match="home it first"),
    ):
        rail.move_to(10.0)


def test_a_stop_outside_the_travel_is_refused() -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        with pytest.raises(RailLimitError, match=r"0\.500 mm is outside 1\.\.151\.498 mm"):
            rail.move_to(0.5)


TROUBLES: list[tuple[str, Callable[[ZaberController], None], str]] = [
    (
        "stall",
        lambda c: c.strike("alarm"),
        "warns FS: it stalled; its position is lost: home it",
    ),
    (
        "power cut",
        lambda c: c.strike("reboot"),
        "warns WR: it has no reference; its position is lost: home it",
    ),
    (
        "moved by hand",
        lambda c: setattr(c, "position", 9000),
        "was left at 50.000 mm and stands at 4.465 mm",
    ),
]


@pytest.mark.parametrize(("name", "strike", "words"), TROUBLES)
def test_trouble_between_moves_is_told_and_homing_mends_it(
    name: str, strike: Callable[[ZaberController], None], words: str
) -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        rail.move_to(50.0)
        with port.lock:
            strike(controller_of(port))
        with pytest.raises(RailError, match=re.escape(words)):
            rail.move_to(60.0)
        rail.home()
        rail.move_to(60.0)
        assert carriage_mm(port) == pytest.approx(60.0, abs=MICROSTEP_MM)


def test_a_stop_from_another_thread_keeps_the_position() -> None:
    with a_port(speed=40_000) as port, a_rail(port) as rail:
        rail.home()
        moving = threading.Event()
        controller_of(port).noticed = lambda command: (
            moving.set() if command.startswith("move") else None
        )
        assert "was stopped at" in error_of_a_move_stopped(rail, 140.0, moving)
        assert carriage_mm(port) < 139.0
        assert rail.move_to(20.0) == pytest.approx(20.0, abs=MICROSTEP_MM)
        assert carriage_mm(port) == pytest.approx(20.0, abs=MICROSTEP_MM)


def test_a_stop_just_before_a_move_is_obeyed() -> None:
    with a_port() as port, a_rail(port) as rail:
        rail.home()
        before_mm = carriage_mm(port)
        error = error_of_a_move_stopped_before_it_began(
            rail, 100.0, controller_of(port), "get pos"
        )
        assert "was stopped before it moved" in error
        assert carriage_mm(port) == pytest.approx(before_mm, abs=0.01)
        assert rail.move_to(100.0) == pytest.approx(100.0, abs=0.01)


def test_a_device_that_says_nothing_is_told_so() -> None:
    with (
        a_port(LineFault("silence", r"get.*", lasts_s=60)) as port,
        pytest.raises(
            DeviceTimeoutError,
            match="does not answer at 115200 baud; look at its power and its cable",
        ),
    ):
        ZaberRail(port.path, MICROSTEP_MM, reply_s=0.1)


@pytest.mark.parametrize(
    ("address", "microstep_um", "words"),
    [
        ("zaber:", 0.5, "give the port as well"),
        ("zaber:/dev/ttyUSB0", None, "rail.microstep_um is missing"),
    ],
)
def test_a_plan_that_says_too_little_is_refused(
    address: str, microstep_um: float | None, words: str
) -> None:
    wanted = plan()
    assert wanted.rail
    told = wanted.model_copy(
        update={"rail": wanted.rail.model_copy(update={"microstep_um": microstep_um})}
    )
    with pytest.raises(PlanError, match=words):
        open_rail(address, told, DeviceContext())


def test_a_simulated_stage_carries_the_simulated_benchs_camera() -> None:
    bench = Bench(
        replace(
            BenchSettings(),
            sensor=TrueSensor(rows=32, cols=48),
            panel=TruePanel(pixels=(300, 400)),
        )
    )
    wanted = plan(**{"direction = -1": "direction = -1\nmicrostep_um = 0.5"})
    with open_rail(
        "zaber:simulated", wanted, DeviceContext(shared=SharedParts({"simulated:": bench}))
    ) as rail:
        rail.home()
        assert rail.move_to(30.0) == pytest.approx(30.0, abs=0.001)
        # the bench's own scatter has a standard deviation of 0.02 mm
        assert bench.position_mm == pytest.approx(30.0, abs=0.1)


@pytest.mark.parametrize(
    ("setting", "told", "words"),
    [
        ("maxspeed", "0", "has maxspeed = 0; allowed is above 0: set maxspeed"),
        ("maxspeed", "-5", "has maxspeed = -5"),
        ("maxspeed", "nan", "has maxspeed = nan"),
        ("limit.max", "NA", "reports limit.max = 'NA', which is no number"),
        ("limit.max", "nan", "leave no room to move"),
    ],
)
def test_settings_that_make_no_sense_are_named_in_one_line(
    monkeypatch: pytest.MonkeyPatch, setting: str, told: str, words: str
) -> None:
    plain = ZaberController._get

    def get(self: ZaberController, axis: int, name: str) -> str | None:
        return told if name == setting else plain(self, axis, name)

    monkeypatch.setattr(ZaberController, "_get", get)
    with a_port() as port, pytest.raises(RailError, match=words):
        a_rail(port)
