"""A bench so small and fast that a whole capture takes a moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from labkit.devices.context import DeviceContext
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.simulated.world import Fault
from labkit.plan import load_plan
from tests.plans import SMALL, plan_text, simulated

ADDRESS = "simulated:seed=7"

PLAN = plan_text(
    SMALL,
    simulated([2000, 2050.5], 1950.0, ADDRESS),
    {"camera": {"frames_per_range": 2, "flats_per_range": 2, "darks": 3}},
)

ContextMaker = Callable[..., DeviceContext]


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def make_context() -> ContextMaker:
    """A context with the plan's bench in it, with faults, and with more or less light than the plan expects."""

    def make(plan_file: Path, faults: Sequence[Fault] = (), light: float = 1.0) -> DeviceContext:
        settings = settings_for(load_plan(plan_file), 7)
        sensor = replace(settings.sensor, white_electrons_per_s=settings.sensor.white_electrons_per_s * light)
        bench = Bench(replace(settings, sensor=sensor, halo_um=100.0), faults)
        return DeviceContext(shared=SharedParts({ADDRESS: bench}))

    return make
