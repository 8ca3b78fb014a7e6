"""results.json as the command line shows it, and beside the truth of a simulated bench."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from labkit.demo import Comparison, compare, compare_wavefronts, new_folder
from labkit.errors import DataError
from labkit.summary import focus_rows, read_results, wavefront_rows

RESULTS: dict[str, Any] = {
    "schema": 1,
    "reference_wavelength_nm": 450.0,
    "wavefronts": [
        {
            "range_mm": 3000.0,
            "channel": "R",
            "noll": [4, 5],
            "waves_rms": [-0.3, 0.4],
            "std": [0.001, 0.002],
            "chi2_per_pixel": 1.0123,
            "global_test": {"accepted": False},
        },
        {
            "range_mm": None,
            "channel": "R",
            "noll": [5],
            "waves_rms": [0.4],
            "std": [0.002],
            "chi2_per_pixel": 1.0,
            "global_test": {"accepted": True},
        },
    ],
    "focus": {
        "best_focus_mm": {"R": {"value": 3024.5, "std": 0.25}},
        "pupil_magnification": {"value": 0.98, "std": 0.04, "identifiable": False},
    },
}


def test_a_wavefront_is_a_row_with_its_defocus_and_its_rms() -> None:
    _, first, second = wavefront_rows(RESULTS)
    assert first == ["3000", "R", "-0.3000 ± 0.0010", "0.5000", "1.012", "REJECTED"]
    assert second == ["none", "R", "not fitted", "0.4000", "1.000", "accepted"]


def test_a_magnification_that_cannot_be_told_says_so() -> None:
    _, focus, magnification = focus_rows(RESULTS)
    assert focus == ["best focus R", "3024.50 ± 0.25 mm"]
    assert "cannot be told" in magnification[1]


def test_no_focus_fit_is_said() -> None:
    assert "not fitted" in focus_rows({**RESULTS, "focus": None})[0][0]


def test_estimates_stand_beside_the_truth_of_their_own_range_and_channel() -> None:
    visits = [SimpleNamespace(range_mm=r, defocus_waves={"R": w}) for r, w in ((2000.0, 9.0), (3000.0, -0.302))]
    truth = SimpleNamespace(best_focus_mm={"R": 3024.0}, pupil_magnification=0.985, visits=visits)
    focus, magnification, defocus = compare(RESULTS, truth)
    assert (focus.truth, focus.estimate, focus.std) == (3024.0, 3024.5, 0.25)
    assert (magnification.truth, magnification.estimate) == (0.985, 0.98)
    assert (defocus.truth, defocus.estimate, defocus.std) == (-0.302, -0.3, 0.001)


def test_a_wavefronts_error_is_over_all_modes_and_its_worst_mode_is_named() -> None:
    fit = {"range_mm": 3000.0, "channel": "R", "noll": [4, 5, 8], "waves_rms": [0.3, 0.1, 0.02], "std": [1e-3] * 3}
    visits = [SimpleNamespace(range_mm=3000.0, defocus_waves={"R": 0.3})]
    truth = SimpleNamespace(modes_waves={"R": {5: 0.096, 8: 0.023}}, visits=visits)
    (one,) = compare_wavefronts({"wavefronts": [fit]}, truth)
    assert one.error_rms == pytest.approx(0.005)
    (row,) = Comparison((), (one,), Path("report.html")).wavefront_rows()
    # sqrt(0.3^2 + 0.096^2 + 0.023^2); three modes with 0.001 each
    assert row == ["wavefront R at 3000 mm", "0.3158", "0.0050", "0.0017", "+4.0 (Noll 5)"]


@pytest.mark.parametrize("content", [None, json.dumps({"schema": 2})])
def test_other_results_are_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "results.json").write_text(content)
    with pytest.raises(DataError, match=r"labkit fit|schema 2"):
        read_results(tmp_path)


def test_a_new_folder_is_never_one_that_is_there(tmp_path: Path) -> None:
    assert new_folder(tmp_path / "demo") == tmp_path / "demo"
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo-2").mkdir()
    assert new_folder(tmp_path / "demo") == tmp_path / "demo-3"
