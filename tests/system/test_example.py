"""The same from Python: examples/measure_lens.py on a small plan, against the simulated bench's truth."""

import runpy
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from labkit.drivers.simulated import setup as bench_setup
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.simulated.world import BenchSettings
from labkit.plan import Plan
from tests.plans import IPAD, PORTRAIT, plan_text, simulated

ROOT = Path(__file__).parents[2]

PLAN = plan_text(
    PORTRAIT,
    {
        "lens": {"f_number": 4.0},
        "sensor": {"cfa_pattern": "RGGB"},
        "fit": {"zernike_noll": [4, 15]},
    },
    simulated([3000, 3200], 2950.0),
    {
        "camera": {"frames_per_range": 1, "flats_per_range": 2, "darks": 2},
        "rail": {"settle_s": 0},
        "display": IPAD,
    },
)


def test_the_example_measures_a_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # diffraction is followed as far as photon noise lets it be seen
    monkeypatch.setattr(bench_setup, "BenchSettings", partial(BenchSettings, halo_um=250.0))
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(PLAN)
    measure = runpy.run_path(str(ROOT / "examples" / "measure_lens.py"))["measure"]
    results = measure(plan_path, tmp_path / "session")
    truth = Bench(settings_for(Plan.load(plan_path), seed=1)).truth
    assert results.focus is not None
    best = results.focus["G"]
    # four standard errors, and the rail's scatter, which they do not know of
    std_mm = np.hypot(best.std, settings_for(Plan.load(plan_path), seed=1).rail.scatter_mm)
    assert best.value == pytest.approx(truth.best_focus_mm["G"], abs=4 * std_mm)
    printed = capsys.readouterr().out
    assert f"best focus G: {best}" in printed
    assert "MTF at 100 cycles/mm" in printed
    assert (
        tmp_path / "session" / "results" / "latest" / "report.html"
    ).stat().st_size > 10_000
