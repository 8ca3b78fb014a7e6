"""The simulated devices one by one, and how devices are found by address."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rawpy

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Camera, Coverable, Display, ExposureSettings, Rail
from labkit.devices.registry import installed, open_camera, open_devices
from labkit.drivers.simulated import image as image_module
from labkit.drivers.simulated import tiles as tiles_module
from labkit.drivers.simulated.address import Orders, ordered
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.camera import SimulatedCamera
from labkit.drivers.simulated.display import SimulatedDisplay
from labkit.drivers.simulated.rail import SimulatedRail
from labkit.drivers.simulated.setup import settings_for, shared_bench
from labkit.drivers.simulated.tiles import tiles
from labkit.drivers.simulated.world import (
    BenchSettings,
    Fault,
    TrueLens,
    TruePanel,
    TrueRail,
    TrueSensor,
)
from labkit.errors import CameraError, DisplayError, PlanError, RailError, RailLimitError
from labkit.plan import Plan
from tests.plans import IPAD, SMALL, plan_text, simulated

TEXT = plan_text(
    SMALL,
    simulated([2000, 2100], 2200.0),
    {"rail": {"direction": -1}, "display": IPAD},
)


def plan(**changes: str) -> Plan:
    text = TEXT
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return Plan.parse(text, Path())


def a_bench(*faults: Fault) -> Bench:
    sensor, panel = TrueSensor(rows=32, cols=48), TruePanel(pixels=(300, 400))
    return Bench(
        BenchSettings(
            lens=TrueLens(f_number=8.0), sensor=sensor, panel=panel, halo_um=60.0
        ),
        faults,
    )


@pytest.fixture
def camera() -> Iterator[SimulatedCamera]:
    with SimulatedCamera(a_bench()) as camera:
        camera.configure(ExposureSettings(0.02, 100))
        yield camera


def test_a_photograph_opens_as_any_cameras_raw_file_does(
    camera: SimulatedCamera, tmp_path: Path
) -> None:
    frame = camera.expose(tmp_path / "a")
    assert frame.path == tmp_path / "a.dng"
    with rawpy.imread(str(frame.path)) as raw:
        assert raw.raw_image.shape == (32, 48)
        assert raw.other.shutter_speed == pytest.approx(0.02)


def test_a_name_with_a_dot_in_it_keeps_it(camera: SimulatedCamera, tmp_path: Path) -> None:
    assert camera.expose(tmp_path / "flat_3013.2_0").path.name == "flat_3013.2_0.dng"


def test_a_photograph_is_never_overwritten(camera: SimulatedCamera, tmp_path: Path) -> None:
    camera.expose(tmp_path / "a")
    with pytest.raises(CameraError, match="never overwritten"):
        camera.expose(tmp_path / "a")


def test_a_camera_that_was_not_configured_says_so(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="not configured"):
        SimulatedCamera(a_bench()).expose(tmp_path / "a")


def test_a_camera_off_its_cable_stays_away_until_it_is_looked_for(tmp_path: Path) -> None:
    camera = SimulatedCamera(a_bench(Fault("camera", "unplug", 1)))
    camera.configure(ExposureSettings(0.02, 100))
    for words in ("dropped off USB", "not on USB"):
        with pytest.raises(CameraError, match=words):
            camera.expose(tmp_path / "a")
    camera.identify()
    camera.configure(ExposureSettings(0.02, 100))
    camera.expose(tmp_path / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["a.dng"]


def test_a_rail_must_be_homed_before_it_moves() -> None:
    with SimulatedRail(a_bench()) as rail, pytest.raises(RailError, match="home it first"):
        rail.move_to(10.0)


def test_a_stop_outside_the_travel_is_refused() -> None:
    rail = SimulatedRail(a_bench())
    rail.home()
    with pytest.raises(RailLimitError, match=r"500\.001 mm is outside 0\.\.500 mm"):
        rail.move_to(500.001)


@pytest.mark.parametrize("before_mm", [0.0, 400.0])
def test_a_stop_is_reached_whichever_way_it_comes(before_mm: float) -> None:
    bench = a_bench()
    rail = SimulatedRail(bench)
    rail.home()
    rail.move_to(before_mm)
    # scatter has a standard deviation of 0.02 mm, play is 0.15 mm
    assert rail.move_to(200.0) == pytest.approx(200.0, abs=0.08)
    assert bench.position_mm == pytest.approx(200.0, abs=0.08)


def test_the_encoder_does_not_see_where_the_home_switch_tripped() -> None:
    exact = replace(
        a_bench().settings,
        rail=TrueRail(scatter_mm=0.0, homing_scatter_mm=0.02, tape_error_mm=3.0),
    )
    rail = SimulatedRail(bench := Bench(exact))
    errors_mm = []
    for _ in range(400):
        rail.home()
        assert rail.move_to(200.0) == pytest.approx(200.0, abs=1e-9)
        errors_mm.append(bench.range_mm - exact.rail.range_at_zero_mm - 200.0)
    # the standard deviation of 400 draws has 3.5 % relative error, and their mean 5 % of it: allow four of them
    assert np.std(errors_mm) == pytest.approx(0.02, rel=0.14)
    assert np.mean(errors_mm) == pytest.approx(3.0, abs=4 * 0.02 / 20)
    bench.light(np.full((20, 20), 255, dtype=np.uint8))
    bench.expose(0.01, 100, "a")
    (visit,) = bench.truth.visits
    assert (
        visit.actual_range_mm
        == bench.range_mm
        == pytest.approx(visit.range_mm + visit.range_zero_mm, abs=1e-9)
    )
    assert bench.truth.best_focus_mm["G"] == exact.lens.best_focus_mm["G"] - 3.0


def test_lost_steps_show_on_the_encoder_and_homing_finds_the_place_again() -> None:
    rail = SimulatedRail(a_bench(Fault("rail", "lost_steps", 1)))
    rail.home()
    with pytest.raises(RailError, match="lost steps"):
        rail.move_to(100.0)
    with pytest.raises(RailError, match="home it first"):
        rail.move_to(100.0)
    rail.home()
    assert rail.move_to(100.0) == pytest.approx(100.0, abs=0.08)


def test_a_display_says_how_large_the_picture_is() -> None:
    display = SimulatedDisplay(a_bench())
    assert display.show("white").pixels == (300, 400)
    assert display.show(np.zeros((20, 30), dtype=np.uint8)).pixels == (20, 30)
    with pytest.raises(DisplayError, match="larger than the panel"):
        display.show(np.zeros((20, 401), dtype=np.uint8))


def test_the_devices_keep_the_protocols() -> None:
    bench = a_bench()
    camera: Camera = SimulatedCamera(bench)
    rail: Rail = SimulatedRail(bench)
    display: Display = SimulatedDisplay(bench)
    assert isinstance(camera, Coverable)
    assert rail.travel_mm.high_mm == 500
    assert display.panel.pixels == (300, 400)


def test_devices_opened_together_share_one_bench_and_its_clock() -> None:
    context = DeviceContext()
    with open_devices(plan(), context=context) as devices:
        (bench,) = context.shared.values()
        before = bench.clock_s
        devices.wait(3.0)
        assert bench.clock_s == before + 3.0
        devices.rail.home()
        assert bench.clock_s > before + 3.0


def test_one_address_may_take_the_place_of_all_three() -> None:
    real = plan(**{'"simulated:"': '"nosuch:/dev/tty0"'})
    context = DeviceContext()
    with open_devices(real, simulated="simulated:seed=3", context=context) as devices:
        assert devices.camera.identify().serial == "3"


def test_two_simulated_worlds_in_one_room_are_refused() -> None:
    text = TEXT.replace('"simulated:"', '"simulated:seed=2"', 1)
    with (
        pytest.raises(PlanError, match="give simulated devices the same address"),
        open_devices(Plan.parse(text, Path())),
    ):
        pass


@pytest.mark.parametrize(
    ("address", "order"),
    [
        ("simulated:", Orders()),
        ("simulated:camera.timeout=2", Orders(1, (Fault("camera", "timeout", 2),))),
        (
            "simulated:rail.stall=1x4,seed=3,display.sleep=5",
            Orders(3, (Fault("rail", "stall", 1, 4), Fault("display", "sleep", 5))),
        ),
        (
            "simulated:lens.blades_turn_deg=-10.5,lens.blades=7,seed=2,lens.blade_rounding=0.3",
            Orders(2, pupil={"turn_deg": -10.5, "blades": 7, "rounding": 0.3}),
        ),
        (
            "simulated:lens.cats_eye=0.3,1.1,-45,lens.obstruction=0.38",
            Orders(pupil={"cats_eye": (0.3, 1.1, -45.0), "obstruction": 0.38}),
        ),
        (
            "simulated:lens.noll_22=-0.01,lens.higher_rms=0.03,lens.noll_5=0.2",
            Orders(higher_waves=0.03, stated_waves={22: -0.01, 5: 0.2}),
        ),
    ],
)
def test_seed_lens_and_faults_are_ordered_in_the_address(
    address: str, order: Orders
) -> None:
    assert ordered(address) == order


@pytest.mark.parametrize(
    "address",
    [
        "simulated:seed=x", "simulated:sed=3", "simulated:3", "simulated:seed=-1", "simulated:camera.stall=1",
        "simulated:camera.timeout=0", "simulated:camera.timeout", "simulated:,", "simulated:rail.stall=1x",
        "simulated:lens.blades=6.5", "simulated:lens.blades=many", "simulated:lens.cats_eye=0.3,1.1", "simulated:lens.coma=0.1",
        "simulated:lens.obstruction=0.3,0.4", "simulated:lens.noll=0.1", "simulated:lens.higher_rms=nan",
        "simulated:lens.noll_22=",
    ],
)  # fmt: skip
def test_an_address_that_is_not_understood_is_refused(address: str) -> None:
    with pytest.raises(
        PlanError,
        match=r"allowed is seed=N; sensor=24mp.*; a lens as in lens.blades=7.*; and faults as in .*rail.stall, rail.limit",
    ):
        open_camera(address, plan(), DeviceContext())


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ("lens.blades=2", "a diaphragm has 3 to 24 blades, or 0 for a round one, not 2"),
        (
            "lens.blades=6,lens.blade_rounding=1.1",
            r"0 \(straight\) to 1 \(a circle\), not 1.1",
        ),
        ("lens.blade_rounding=0.3", "turn and rounding are those of blades: say how many"),
        ("lens.obstruction=0.9", "0 to less than 0.9 of the diameter, not 0.9"),
        ("lens.cats_eye=1.9,1,0", "leaves a tenth of the pupil or more, not 0.01"),
        (
            "lens.cats_eye=0.5,0.4,0,lens.obstruction=0.89",
            "a tenth of the pupil or more, not 0",
        ),
        (
            "lens.noll_4=0.1",
            "stated for Noll 5 to 45, not 4; defocus, 4, comes from the range",
        ),
        ("lens.noll_46=0.1", "stated for Noll 5 to 45, not 46"),
        ("lens.noll_20=2.5", r"at most 2 waves RMS, not 2.5 \(Noll 20\)"),
        ("lens.higher_rms=-0.1", "modes beyond Noll 15 have 0 to 2 waves RMS, not -0.1"),
    ],
)
def test_a_lens_that_cannot_be_is_refused_in_one_line(order: str, says: str) -> None:
    with pytest.raises(PlanError, match=says) as refused:
        open_camera(f"simulated:{order}", plan(), DeviceContext())
    assert "\n" not in str(refused.value)


def test_the_lens_of_the_address_is_the_benchs() -> None:
    context = DeviceContext()
    address = "simulated:lens.blades=7,lens.obstruction=0.4,lens.higher_rms=0.03,lens.noll_40=0.02"
    with open_devices(plan(), simulated=address, context=context):
        (bench,) = context.shared.values()
        assert isinstance(bench, Bench)
        truth = bench.truth
    assert (truth.pupil.blades, truth.pupil.obstruction) == (7, 0.4)
    assert [*truth.modes_waves["G"]] == [*range(5, 37), 40]
    higher = [truth.modes_waves["G"][j] for j in range(16, 37)]
    assert np.linalg.norm(higher) == pytest.approx(0.03)
    assert truth.outer_f_number == pytest.approx(
        truth.f_number * (1 - 0.4**2) ** 0.5 / 1.07148066, rel=1e-8
    )  # area of a heptagon over that of its circle: 7 / (2 pi) sin(2 pi / 7) = 0.871026
    assert json.loads(truth.to_json())["pupil"]["blades"] == 7


def test_an_unknown_driver_is_told_with_those_installed() -> None:
    with pytest.raises(
        PlanError, match=r'no driver "nosuch" for a camera; installed: .*simulated:'
    ):
        open_camera("nosuch:/dev/x", plan(), DeviceContext())
    assert "simulated" in installed("rail")


def test_a_plan_without_devices_cannot_be_opened() -> None:
    bare = Plan.parse(TEXT[: TEXT.index("[rail]")], Path())
    with pytest.raises(PlanError, match=r"has no \[rail\]: to capture"), open_devices(bare):
        pass


def test_a_bench_for_a_plan_has_its_target_in_frame_and_its_ranges_on_the_rail() -> None:
    settings = settings_for(plan(), 5)
    per_mm = 50 / (2000 - 50) / 6e-3
    assert 9.0 * per_mm + 20 < settings.sensor.rows < 9.0 * per_mm + 40
    assert settings.rail.low_mm < 100 < 200 < settings.rail.high_mm
    assert all(1990 < focus < 2110 for focus in settings.lens.best_focus_mm.values())
    assert settings.lens.wavelength_nm["G"] == 550.0


def test_a_large_target_gets_a_large_sensor_and_it_is_said_how_long_that_takes() -> None:
    large = plan(**{"size_mm = 9.0": "size_mm = 243.0"})
    settings = settings_for(large, 1)
    assert settings.sensor.rows > 243 * 50 / (2000 - 50) / 6e-3
    said: list[str] = []
    shared_bench(DeviceContext(warn=said.append), "simulated:", large).close()
    (words,) = said
    assert words.startswith(
        f"the simulated camera has {settings.sensor.rows} × {settings.sensor.cols} pixels"
    )
    assert "each new picture takes about" in words


def test_a_picture_in_tiles_is_that_of_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(replace(settings_for(plan(), 5), halo_um=60.0))
    bench.light(np.random.default_rng(1).integers(0, 255, (90, 90)).astype(np.uint8))
    whole = bench._mosaic()
    monkeypatch.setattr(image_module, "MOST_AT_ONCE", 0)
    monkeypatch.setattr(tiles_module, "SIMULATED_TILE_PX", 32)
    parts = bench._mosaic()
    # single precision, and a transform whose size is another
    assert np.abs(parts - whole).max() < 2e-5 * whole.max()
    assert parts.shape == whole.shape


def test_tiles_cover_a_sensor_once() -> None:
    covered = np.zeros((70, 45), dtype=int)
    for cut in tiles(70, 45, 32):
        covered[cut] += 1
    assert np.all(covered == 1)


def test_a_sensor_without_colours_writes_tiff(tmp_path: Path) -> None:
    levels = (
        "pixel_pitch_um = 6.0\ncfa_pattern = 'mono'\nblack_level = 100\nwhite_level = 4095"
    )
    mono = plan(**{"pixel_pitch_um = 6.0": levels})
    camera = open_camera("simulated:", mono, DeviceContext())
    camera.configure(ExposureSettings(0.02, 100))
    assert camera.expose(tmp_path / "a").path.name == "a.tif"
