"""Tables of edge spreads against the spreads themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.charts.spread_table import SpreadTable
from labkit.edges.camera import camera_of
from labkit.edges.spread import edge_spread
from labkit.plan import Plan
from tests.edge_scenes import TABLES
from tests.plans import plan_text


@pytest.mark.parametrize("defocus", [0.05, -0.4, 1.6])
@pytest.mark.parametrize("azimuth", [0.09, 1.66, -2.2])
def test_a_table_reads_as_the_spread(
    defocus: float, azimuth: float, tmp_path: pytest.TempPathFactory
) -> None:
    plan = Plan.parse(plan_text(TABLES), tmp_path)  # type: ignore[arg-type]
    optics = camera_of(plan, "M", None, 15000.0, 2000.0).optics
    optics = replace(optics, f_number=4.0 if defocus > 1 else optics.f_number)
    waves = np.zeros(len(optics.noll))
    waves[:4] = defocus, 0.1, -0.05, 0.06
    r_um = np.random.default_rng(1).uniform(-70, 70, 300)
    found = SpreadTable(optics, azimuth, 75.0).read(waves, r_um)
    true = edge_spread(optics, waves, azimuth, 75.0).read(r_um)
    assert np.abs(found[0] - true[0]).max() < 4e-5  # 2e-5 measured
    size = np.abs(true[1:]).max(axis=1, keepdims=True)
    assert (np.abs(found[1:-1] - true[1:-1]) / size[:-1]).max() < 0.02  # steps of the climb
