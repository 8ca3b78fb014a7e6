"""Results are written and read back as the same thing, and found by range and channel."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.errors import DataError
from labkit.results import Results
from labkit.results.storage import kept_keys
from tests.results_samples import FOCUS, a_wavefront, some_results, written

CONTRACT = {
    "schema": 1,
    "labkit_version": "0.1.0",
    "created": "2026-11-21T12:00:00+00:00",
    "plan_sha256": "00",
    "convention": "corrected",
    "reference_wavelength_nm": 450.0,
    "wavefronts": [
        {
            "range_mm": 3000.0, "channel": "R", "wavelength_nm": 650.0,
            "noll": [4, 5], "waves_rms": [0.1, 0.0], "std": [0.001, 0.001], "covariance": [[1e-6, 0], [0, 1e-6]],
            "pose": [0, 0, 0, 0, 0, 0, 0, 0], "gain": 0.45, "read_noise": 1.1, "chi2_per_pixel": 1.01,
            "global_test": {"name": "embedding", "p_value": 0.4, "accepted": True, "starts": 3},
            "seconds": 4.2, "frames": ["target_3000_0.dng"],
        }
    ],
    "focus": {
        "best_focus_mm": {"R": {"value": 3024.0, "std": 0.4}},
        "pupil_magnification": {"value": 0.98, "std": 0.04, "identifiable": False},
        "residual_waves": {"R": [0.001, -0.002, 0.001]},
    },
    "warnings": ["..."],
}  # fmt: skip
"""results.json as its contract prints it."""


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    folder = written(tmp_path)
    first, again = some_results(), Results.load(folder)
    assert (again.plan, again.focus and again.focus.best_focus_mm) == (first.plan, FOCUS.best_focus_mm)
    for w, back in zip(first, again, strict=True):
        assert (back.key, back.noll, back.test, back.frames) == (w.key, w.noll, w.test, w.frames)
        np.testing.assert_array_equal(back.covariance, w.covariance)
        np.testing.assert_array_equal(back.poses, w.poses)
        assert back.residuals
        assert w.residuals
        np.testing.assert_allclose(back.residuals.data, w.residuals.data, rtol=1e-7)  # kept in single precision


def test_what_the_contract_prints_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "latest"
    folder.mkdir(parents=True)
    plan = {"plan": some_results().plan.model_dump(mode="json", exclude_none=True)}
    (folder / "results.json").write_text(json.dumps({**CONTRACT, **plan}))
    results = Results.load(tmp_path)
    assert str(results[3000, "R"][4]) == "0.1000 ± 0.0010 waves"
    assert results.focus
    assert str(results.focus["R"]) == "3024.00 ± 0.40 mm"


def test_every_key_of_the_contract_is_written() -> None:
    entry = some_results().as_json()
    assert CONTRACT.keys() <= entry.keys()
    assert CONTRACT["wavefronts"][0].keys() <= entry["wavefronts"][0].keys()  # type: ignore[index]
    assert CONTRACT["focus"].keys() <= entry["focus"].keys()  # type: ignore[attr-defined]


def test_a_range_of_many_digits_keeps_its_residuals_and_its_psf(tmp_path: Path) -> None:
    folder = written(tmp_path, wavefronts=(a_wavefront(1234.567),))
    assert Results.load(folder)[1234.567, "R"].residuals is not None
    with np.load(folder / "psf.npz") as arrays:
        assert set(arrays) == {"spacing_um", "psf_1234.567_R"}


def test_psfs_are_kept_as_the_contract_says(tmp_path: Path) -> None:
    with np.load(written(tmp_path) / "psf.npz") as arrays:
        psf = arrays["psf_3000_R"]
    assert psf.shape[0] == psf.shape[1]
    assert psf.shape[0] % 2 == 1
    assert psf.sum() == pytest.approx(1.0, abs=1e-5)


def test_a_wavefront_is_found_by_range_and_channel() -> None:
    results = some_results()
    assert results[3200, "B"] is results.wavefronts[3]
    with pytest.raises(KeyError, match="no wavefront at 3100 mm, channel 'R': there are 3000 mm R"):
        results[3100, "R"]
    with pytest.raises(KeyError, match="Noll mode 11"):
        results[3200, "B"][11]


def test_a_table_has_a_row_for_each_coefficient() -> None:
    pandas = pytest.importorskip("pandas")
    table = some_results().to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["range_mm", "channel", "mode", "waves", "std"]
    assert len(table) == 12
    coma = table[(table["range_mm"] == 3200) & (table["channel"] == "B") & (table["mode"] == 8)]
    assert coma[["waves", "std"]].to_numpy().tolist() == [[-0.04, 0.0013]]


def test_a_notebook_shows_tables_and_obeys_no_names() -> None:
    html = some_results(wavefronts=(a_wavefront(channel="<b>"),), focus=None)._repr_html_()
    assert html.count("<table>") == 2
    assert "<td>&lt;b&gt;</td>" in html


def test_a_wavefront_is_a_row_with_its_defocus_and_its_rms() -> None:
    rejected = replace(a_wavefront(3000.0, "R", -0.3).test, accepted=False)  # type: ignore[type-var]
    results = some_results(wavefronts=(a_wavefront(3000.0, "R", -0.3, test=rejected), a_wavefront(None)))
    _, first, second = results.wavefront_rows()
    # sqrt(0.3^2 + 0.03^2 + 0.04^2)
    assert first == ["3000", "R", "-0.3000 ± 0.0011", "0.3041", "1.018", "REJECTED"]
    assert second[:2] == ["", "R"]


def test_a_magnification_that_is_not_determined_is_marked() -> None:
    _, focus, _, magnification, *lens = some_results().focus_rows()
    assert focus == ["best focus R", "2986.84 ± 0.42 mm"]
    assert "do not determine" in magnification[1]
    assert ["focal length", "69.31 ± 0.12 mm"] in lens
    assert "not fitted" in some_results(focus=None).focus_rows()[0][0]


def test_a_report_of_earlier_results_does_not_stay(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (folder / "figures").mkdir()
    (folder / "report.html").write_text("old")
    some_results().write(folder)
    assert {path.name for path in folder.iterdir()} == {"results.json", "psf.npz", "residuals.npz"}


def test_what_a_folder_keeps_is_known_without_reading_it_all(tmp_path: Path) -> None:
    assert kept_keys(written(tmp_path)) == {"3000_R", "3000_B", "3200_R", "3200_B"}
    assert kept_keys(tmp_path) == set()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "run labkit fit first"),
        ("{", "cannot read"),
        ('{"schema": 7}', "schema 7"),
        ('{"schema": 1}', "plan"),
        ("[" * 100_000, "cannot read"),
    ],
)
def test_results_that_cannot_be_read_give_one_line(tmp_path: Path, text: str | None, complaint: str) -> None:
    folder = tmp_path / "results" / "latest"
    folder.mkdir(parents=True)
    if text is not None:
        (folder / "results.json").write_text(text)
    with pytest.raises(DataError, match=complaint) as caught:
        Results.load(tmp_path)
    assert "\n" not in str(caught.value)


def test_other_names_of_results_are_offered(tmp_path: Path) -> None:
    some_results().write(tmp_path / "results" / "22-modes")
    with pytest.raises(DataError, match="results there are: 22-modes"):
        Results.load(tmp_path)
