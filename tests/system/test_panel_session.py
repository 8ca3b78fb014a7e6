"""Sessions in front of a panel whose pixels the camera sees, from the plan to best focus."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labkit
from labkit.acquisition.capture import run_plan
from labkit.cli import run
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.errors import DataError, PlanError
from labkit.plan import Plan
from labkit.session.session import Session
from tests.plans import Tables, plan_text

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
LIT = 0.003
"""Of a stripe's share that is lit; measured: 0.0014 across and 0.0002 down."""

PIXELS = "\n[target.pixels]\npitch_mm = 0.1245\n"
CLOSE: Tables = {
    "lens": {"focal_length_mm": 70.0, "f_number": 8.0},
    "sensor": {"pixel_pitch_um": 4.3},
    "channel": [
        {"name": "R", "wavelength_nm": 620.0},
        {"name": "G", "wavelength_nm": 540.0},
    ],
    "target": {"kind": "sierpinski", "order": 3, "size_mm": 5.4},
    "camera": {
        "address": "simulated:",
        "exposure_s": 0.02,
        "frames_per_range": 1,
        "flats_per_range": 4,
        "darks": 4,
    },
    "rail": {
        "address": "simulated:",
        "ranges_mm": [640.0, 670.0],
        "range_at_zero_mm": 620.0,
    },
    "display": {"address": "simulated:", "pixel_pitch_mm": 0.1, "pixels": [400, 400]},
}

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def bench() -> Bench:
    settings = settings_for(Plan.parse(plan_text(CLOSE)), 3)
    sensor = replace(
        settings.sensor, white_electrons_per_s=0.5 * settings.sensor.white_electrons_per_s
    )
    # black is black here: what an LCD's black lets through shows its stripes too, which the model lacks
    panel = replace(settings.panel, layout="rgb-stripes", contrast=1e6)
    return Bench(replace(settings, sensor=sensor, panel=panel, halo_um=350.0))


@pytest.fixture(scope="module")
def photographed(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Of a plan that says nothing of the panel's pixels."""
    folder = tmp_path_factory.mktemp("close")
    plan, context = (
        plan_text(CLOSE),
        DeviceContext(shared=SharedParts({"simulated:": bench})),
    )
    with (
        Session.create(folder / "session", plan, folder) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices, check=False)
    return Session.open(folder / "session")


def test_the_bench_is_measured_though_its_panels_pixels_are_seen(
    bench: Bench, photographed: Session
) -> None:
    plan = photographed.plan.replace(target={"pixels": {"layout": "rgb-stripes"}})
    results = labkit.fit(photographed, plan=plan, name="stripes", workers=1)
    panel, focus = bench.settings.panel, results.focus
    assert (
        abs(results.model_parts["panel_pixels.lit_across"].value - panel.lit_across) < LIT
    )
    assert abs(results.model_parts["panel_pixels.lit_down"].value - panel.lit_down) < LIT
    assert focus is not None
    for channel in ("R", "G"):
        assert (
            abs(focus[channel].value - bench.truth.best_focus_mm[channel])
            < 4 * focus[channel].std
        )
    assert all(w.test is not None and w.test.explains for w in results.wavefronts)
    assert "panel-pixels-seen" not in {finding.code for finding in results.findings}


def test_a_plan_without_the_panels_pixels_is_told_of_them(photographed: Session) -> None:
    with pytest.raises(DataError) as told:
        labkit.fit(photographed, name="without", workers=1)
    assert 'add pixels = { pitch_mm = 0.1, layout = "rgb-stripes" } to [target]' in str(
        told.value
    )
    assert "\n" not in str(told.value)


def test_other_stripes_than_the_photographs_show_are_refused(photographed: Session) -> None:
    for pixels, words in (
        ({"layout": "bgr-stripes"}, 'layout = "bgr-stripes": the photographs show another'),
        ({"layout": "rgb-rows"}, 'layout = "rgb-rows": the photographs show another'),
    ):
        with pytest.raises(PlanError, match=words):
            labkit.fit(
                photographed,
                plan=photographed.plan.replace(target={"pixels": pixels}),
                name="wrong",
                workers=1,
            )


@pytest.mark.skipif(
    not GOLDEN.is_dir(),
    reason="the sessions with a known truth lie beside the project, not in it",
)
def test_an_independent_session_before_a_panel_is_right(tmp_path: Path) -> None:
    plan, golden, session = (
        tmp_path / "plan.toml",
        GOLDEN / "panel-open",
        tmp_path / "session",
    )
    plan.write_text((golden / "plan.toml").read_text() + PIXELS)
    assert (
        run(["import", str(golden / "frames.csv"), str(plan), str(session), "--quiet"]) == 0
    )
    some = [
        "--channel",
        "G",
        "--range",
        "640",
        "--range",
        "676",
        "--name",
        "some",
        "--workers",
        "1",
    ]
    assert run(["fit", str(session), *some, "--quiet"]) == 0
    measured: dict[str, Any] = json.loads(
        (session / "results/some/results.json").read_text()
    )
    truth = json.loads((GOLDEN / "truth-panel-open.json").read_text())
    true = {
        (f["range_mm"], f["channel"]): [f["defocus_waves"], *f["alpha"].values()]
        for f in truth["frames"]
    }
    assert len(measured["wavefronts"]) == 2
    for fit in measured["wavefronts"]:
        error = np.subtract(fit["waves_rms"], true[fit["range_mm"], "G"])
        assert fit["optimum"]["accepted"]
        assert np.linalg.norm(error) < 0.002  # measured: 0.0011
        assert (
            abs(fit["chi2_per_pixel"] - 1) < 0.15
        )  # measured: 0.076; the simulator's halo ends at 600 um
    best = measured["focus"]["best_focus_mm"]["G"]
    assert abs(best["value"] - truth["best_focus_mm"]["G"]) < min(
        0.01, 3 * best["std"]
    )  # measured: 0.005 mm, 0.4 errors
    # the panel's truth: 0.82 and 0.88; measured: 0.0056 and 0.0009 off
    assert abs(measured["model_parts"]["panel_pixels.lit_across"]["value"] - 0.82) < 0.01
    assert abs(measured["model_parts"]["panel_pixels.lit_down"]["value"] - 0.88) < 0.0017
