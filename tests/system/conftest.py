"""A bench so small and fast that a whole capture takes a moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from labkit.drivers.bench import Bench
from labkit.drivers.bench_setup import settings_for
from labkit.drivers.bench_world import Fault
from labkit.lab.devices import Room
from labkit.plan import load_plan

ADDRESS = "simulated:seed=7"

PLAN = """
[lens]
focal_length_mm = 50.0
f_number = 8.0
[sensor]
pixel_pitch_um = 6.0
[[channel]]
name = "G"
wavelength_nm = 550.0
[target]
kind = "sierpinski"
order = 2
size_mm = 9.0
[camera]
address = "simulated:seed=7"
exposure_s = 0.02
frames_per_range = 2
flats_per_range = 2
darks = 3
[rail]
address = "simulated:seed=7"
ranges_mm = [2000, 2050.5]
range_at_zero_mm = 1950.0
[display]
address = "simulated:seed=7"
pixel_pitch_mm = 0.1
pixels = [400, 400]
"""

RoomMaker = Callable[..., Room]


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def make_room() -> RoomMaker:
    """A room with the plan's bench in it, with faults, and with more or less light than the plan expects."""

    def make(plan_file: Path, faults: Sequence[Fault] = (), light: float = 1.0) -> Room:
        settings = settings_for(load_plan(plan_file), 7)
        sensor = replace(settings.sensor, white_electrons_per_s=settings.sensor.white_electrons_per_s * light)
        bench = Bench(replace(settings, sensor=sensor, halo_um=100.0), faults)
        return Room({ADDRESS: bench}, bench.wait)

    return make
