"""Whole sessions of an independent simulator, through the same commands, against their truth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import RectBivariateSpline

from labkit.cli import run

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"

pytestmark = [
    pytest.mark.skipif(not GOLDEN.is_dir(), reason="the sessions with a known truth lie beside the project, not in it"),
    pytest.mark.timeout(900),
]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    session = tmp_path_factory.mktemp("golden") / "session"
    assert (
        run(["import", str(GOLDEN / "open/frames.csv"), str(GOLDEN / "open/plan.toml"), str(session), "--quiet"]) == 0
    )
    assert run(["fit", str(session), "--quiet"]) == 0
    return session / "results/latest"


@pytest.fixture(scope="module")
def found(results: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((results / "results.json").read_text())
    return loaded


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((GOLDEN / "truth-open.json").read_text())
    return loaded


def test_defocus_and_the_whole_wavefront_are_right(found: dict[str, Any], truth: dict[str, Any]) -> None:
    true = {(f["range_mm"], f["channel"]): [f["defocus_waves"], *f["alpha"].values()] for f in truth["frames"]}
    assert len(found["wavefronts"]) == len(true) == 9
    for fit in found["wavefronts"]:
        error = np.array(fit["waves_rms"]) - true[fit["range_mm"], fit["channel"]]
        assert abs(error[0]) < 0.006
        assert np.linalg.norm(error) < 0.012
        assert 0.9 < fit["chi2_per_pixel"] < 1.5
        assert fit["global_test"]["accepted"]


def test_point_spread_functions_are_right_to_three_percent(results: Path, truth: dict[str, Any]) -> None:
    ours, theirs = np.load(results / "psf.npz"), np.load(GOLDEN / "truth-open-psf.npz")
    spacing_um = float(truth["psf_spacing_um"])
    for key in theirs.files:
        true = theirs[key].astype(float)
        seen = _resampled(ours[f"psf_{key}"].astype(float), float(ours["spacing_um"]), len(true), spacing_um)
        assert np.abs(seen / seen.sum() - true / true.sum()).sum() < 0.03


def test_best_focus_magnification_and_noise_are_right(found: dict[str, Any], truth: dict[str, Any]) -> None:
    for channel, best in found["focus"]["best_focus_mm"].items():
        assert abs(best["value"] - truth["best_focus_mm"][channel]) < 1.0
    magnification = found["focus"]["pupil_magnification"]
    assert abs(magnification["value"] - truth["mp"]) < 4 * magnification["std"]
    for fit in found["wavefronts"]:
        assert fit["gain"] == pytest.approx(truth["gain"], rel=0.02)  # photon transfer knows it to 0.4 %
        assert fit["read_noise"] == pytest.approx(np.hypot(truth["read_noise_dn"], 12**-0.5), rel=0.03)


def _resampled(psf: npt.NDArray[np.float64], spacing_um: float, size: int, new_um: float) -> npt.NDArray[np.float64]:
    old = (np.arange(len(psf)) - len(psf) // 2) * spacing_um
    new = (np.arange(size) - size // 2) * new_um
    return np.asarray(RectBivariateSpline(old, old, psf)(new, new))
