"""Whole sessions of an independent simulator, through the same commands, against their truth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.claims import limit
from tests.golden.measure import import_and_fit, resampled

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
CLAIM = "golden_open"

pytestmark = [
    pytest.mark.skipif(not GOLDEN.is_dir(), reason="the sessions with a known truth lie beside the project, not in it"),
    pytest.mark.slow,
    pytest.mark.timeout(1800),  # 140 s alone on two cores
]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    session = tmp_path_factory.mktemp("golden") / "session"
    import_and_fit(GOLDEN / "open", session)
    return session / "results/latest"


@pytest.fixture(scope="module")
def measured(results: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((results / "results.json").read_text())
    return loaded


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((GOLDEN / "truth-open.json").read_text())
    return loaded


def test_defocus_and_the_whole_wavefront_are_right(measured: dict[str, Any], truth: dict[str, Any]) -> None:
    true = {(f["range_mm"], f["channel"]): [f["defocus_waves"], *f["alpha"].values()] for f in truth["frames"]}
    assert len(measured["wavefronts"]) == len(true) == 9
    for fit in measured["wavefronts"]:
        error = np.array(fit["waves_rms"]) - true[fit["range_mm"], fit["channel"]]
        assert abs(error[0]) < limit(CLAIM, "defocus_waves")
        assert np.linalg.norm(error) < limit(CLAIM, "wavefront_waves")
        assert abs(fit["chi2_per_pixel"] - 1) < limit(CLAIM, "chi2")
        assert fit["global_test"]["accepted"]


def test_point_spread_functions_are_right(results: Path, truth: dict[str, Any]) -> None:
    ours, theirs = np.load(results / "psf.npz"), np.load(GOLDEN / "truth-open-psf.npz")
    spacing_um = float(truth["psf_spacing_um"])
    for key in theirs.files:
        true = theirs[key].astype(float)
        estimated = resampled(ours[f"psf_{key}"].astype(float), float(ours["spacing_um"]), len(true), spacing_um)
        assert np.abs(estimated / estimated.sum() - true / true.sum()).sum() < limit(CLAIM, "psf_l1")


def test_best_focus_magnification_and_noise_are_right(measured: dict[str, Any], truth: dict[str, Any]) -> None:
    for channel, best in measured["focus"]["best_focus_mm"].items():
        assert abs(best["value"] - truth["best_focus_mm"][channel]) < limit(CLAIM, "best_focus_mm")
    magnification = measured["focus"]["pupil_magnification"]
    assert abs(magnification["value"] - truth["mp"]) < limit(CLAIM, "magnification_z") * magnification["std"]
    for fit in measured["wavefronts"]:
        assert fit["gain"] == pytest.approx(truth["gain"], rel=limit(CLAIM, "gain_relative"))
        read_noise = np.hypot(truth["read_noise_dn"], 12**-0.5)  # rounding to whole counts is part of it
        assert fit["read_noise"] == pytest.approx(read_noise, rel=limit(CLAIM, "read_noise_relative"))
