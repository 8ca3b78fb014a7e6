"""Results are written and read back as the same thing, and found by range and channel."""

from __future__ import annotations

import inspect
import json
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit import results
from labkit.errors import DataError
from labkit.findings.findings import Finding, found
from labkit.key import Key
from labkit.optics.rim import ROUND, Circle, Diaphragm, Rim
from labkit.report.html import write_report
from labkit.results import OptimumTest, ResidualSpectrum, Results, storage
from labkit.results.model import PartTried, refuse_no_covariance
from labkit.results.storage import kept_keys
from tests.results_contracts import CONTRACT, CONTRACT_2, CONTRACT_3, printed
from tests.results_samples import (
    ACCEPTED,
    BROAD,
    BUDGET,
    FOCUS,
    LENS,
    a_wavefront,
    full_results,
    some_results,
    written,
)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    folder = written(tmp_path)
    first, again = some_results(), Results.load(folder)
    assert (again.plan, again.focus and again.focus.best_focus_mm) == (
        first.plan,
        FOCUS.best_focus_mm,
    )
    assert (again.lens, again.budget) == (LENS, BUDGET)
    for w, back in zip(first, again, strict=True):
        assert (back.key, back.noll, back.test, back.frames) == (
            w.key,
            w.noll,
            w.test,
            w.frames,
        )
        assert (back.blur, back.working_f_number) == (w.blur, w.working_f_number)
        np.testing.assert_array_equal(back.covariance, w.covariance)
        np.testing.assert_array_equal(back.poses, w.poses)
        assert back.residuals
        assert w.residuals
        np.testing.assert_allclose(
            back.residuals.data, w.residuals.data, rtol=1e-7
        )  # kept in single precision


def test_everything_that_results_hold_is_read_as_it_was_written(tmp_path: Path) -> None:
    first = full_results()
    first.write(tmp_path)
    again = Results.load(tmp_path)
    assert again.as_json() == first.as_json()
    written = json.loads((tmp_path / "results.json").read_text())
    held = [written, written["focus"], written["lens"], *written["wavefronts"]]
    empty = {name for table in held for name, value in table.items() if value in (None, [])}
    assert empty == {"unanswered", "twin_waves_rms", "chi2_per_freedom"}


def test_no_key_is_defined_twice() -> None:
    # the same table checks a file, reads it and writes it: no key is spelled anywhere else
    for module in (storage, results.model, results.results):
        source = inspect.getsource(module)
        assert [
            key for key in ("waves_rms", "global_test", "blur_um") if key in source
        ] == []


def test_what_a_poor_model_leaves_and_lacks_is_kept_and_told(tmp_path: Path) -> None:
    left = ResidualSpectrum(
        np.array([0.1, 0.2]), np.array([2.5, 1.1]), np.array([7.0, 1.5])
    )
    poor = a_wavefront(
        test=replace(ACCEPTED, explains=False),
        missing=("low_pass_filter",),
        residual_spectrum=left,
    )
    folder = written(
        tmp_path,
        wavefronts=(poor, a_wavefront(3200.0)),
        parts_tried=(PartTried("veil", 3.0, False),),
    )
    back, plain = Results.load(folder).wavefronts
    assert (back.missing, plain.missing, plain.residual_spectrum) == (
        ("low_pass_filter",),
        (),
        None,
    )
    assert back.residual_spectrum is not None
    assert back.residual_spectrum.without_parts is not None
    for kept, made in zip(vars_of(back.residual_spectrum), vars_of(left), strict=True):
        np.testing.assert_array_equal(kept, made)
    html = write_report(folder).read_text()
    assert "which is not in their model: low-pass filter." in html
    assert "2.50 times the noise where it is most" in html
    assert "Without the parts that were found: 7.00 times." in html
    assert "call for no part of the camera" not in html


def test_numbers_and_psfs_are_of_all_the_light_after_reading_too(tmp_path: Path) -> None:
    folder = written(
        tmp_path, wavefronts=(a_wavefront(spectrum=BROAD), a_wavefront(3200.0))
    )
    broad, alone = Results.load(folder).wavefronts
    np.testing.assert_allclose(
        np.array(broad.spectrum.shares), np.array(BROAD.shares), rtol=1e-12
    )
    assert alone.spectrum.nodes == (1.0,)
    assert broad.strehl.value == pytest.approx(
        a_wavefront(spectrum=BROAD).strehl.value, abs=1e-12
    )
    stored = np.load(folder / "psf.npz")
    kept, spacing_um = stored[f"psf_{broad.key}"], float(stored["spacing_um"])
    np.testing.assert_allclose(kept, broad.psf(spacing_um, len(kept)), atol=1e-8)
    assert np.abs(kept - a_wavefront().psf(spacing_um, len(kept))).sum() > 0.005
    lines = json.loads((folder / "results.json").read_text())["wavefronts"][0]["spectrum"]
    assert [nm for nm, _ in lines] == pytest.approx(
        [0.98 * broad.wavelength_nm, broad.wavelength_nm, 1.02 * broad.wavelength_nm]
    )


def vars_of(spectrum: ResidualSpectrum) -> tuple[Any, ...]:
    return spectrum.cycles_per_px, spectrum.power, spectrum.without_parts


def test_what_schema_1_prints_is_read_as_results_without_a_lens(tmp_path: Path) -> None:
    results = printed(tmp_path, CONTRACT)
    w = results[3000, "R"]
    assert str(w[4]) == "0.1000 ± 0.0010 waves"
    assert results.focus
    assert str(results.focus["R"]) == "3024.00 ± 0.40 mm"
    assert (results.lens, results.budget, w.blur) == (None, {}, None)
    assert w.f_number == 2.8  # of the plan
    assert isnan(w.f_number_std)
    assert w.test == OptimumTest("embedding", True, 0.4, 3, explains=True)


def test_what_schema_2_prints_is_read(tmp_path: Path) -> None:
    results = printed(tmp_path, CONTRACT_2)
    assert results.lens is not None
    numbers = (
        results.lens.focal_length,
        results.lens.f_number,
        results.lens.pupil_magnification,
        results.lens.range_zero,
    )
    assert [str(x) for x in numbers] == [
        "69.100 ± 0.090 mm",
        "2.8700 ± 0.0080",
        "0.960 ± 0.050",
        "-5.8 ± 4.0 mm",
    ]
    assert results.budget == CONTRACT_2["budget"]
    w = results[3000, "R"]
    assert str(w.working_f_number) == "2.9400 ± 0.0080"
    assert str(w.blur) == "-34.650 ± 0.011 um"
    assert results.budget_rows()[1] == [
        "best_focus_mm.G",
        "0.020",
        "0.010",
        "0.030",
        "0.000",
        "0.037",
    ]  # sqrt(0.0014)


@pytest.mark.parametrize("contract", [CONTRACT, CONTRACT_2])
def test_warnings_of_earlier_schemas_are_notes(
    tmp_path: Path, contract: dict[str, Any]
) -> None:
    results = printed(tmp_path, contract)
    assert results.findings == (Finding("note", None, {}, "..."),)
    assert results.warnings == ("...",)


def test_what_schema_3_prints_is_read(tmp_path: Path) -> None:
    results = printed(tmp_path, CONTRACT_3)
    (finding,) = results.findings
    assert (finding.code, finding.key, finding.warns) == ("camera-part-found", None, True)
    assert finding.numbers == CONTRACT_3["findings"][0]["numbers"]
    assert results[Key(3000, "R")].key == Key(3000.0, "R")


def test_findings_and_tiles_are_read_back(tmp_path: Path) -> None:
    findings = (
        found(
            "chi2-unusual",
            Key(3000.0, "R", (0, 2)),
            chi2_per_pixel=float("nan"),
            low=0.9,
            high=1.5,
        ),
        replace(found("no-dark-frames"), warns=False),
    )
    folder = written(
        tmp_path, findings=findings, wavefronts=(a_wavefront(tile=(0, 2)), a_wavefront())
    )
    again = Results.load(folder)
    assert again.findings == findings
    assert again.warnings == (findings[0].text,)
    assert [w.key for w in again] == [Key(3000.0, "R", (0, 2)), Key(3000.0, "R")]
    assert again[Key(3000, "R", (0, 2))] is again.wavefronts[0]
    with np.load(folder / "psf.npz") as arrays:
        assert set(arrays) == {"spacing_um", "psf_3000_R_0_2", "psf_3000_R"}


@pytest.mark.parametrize("contract", [CONTRACT, CONTRACT_2, CONTRACT_3])
def test_every_key_of_the_contract_is_written(contract: dict[str, Any]) -> None:
    entry = some_results().as_json()
    assert contract.keys() <= entry.keys()
    written = entry["wavefronts"][0]
    assert contract["wavefronts"][0].keys() <= written.keys()
    assert contract["focus"].keys() <= entry["focus"].keys()
    assert entry["schema"] == 3
    for part in ("optimum", "model") if contract["schema"] >= 2 else ():
        assert contract["wavefronts"][0][part].keys() <= written[part].keys()
    assert entry["lens"].keys() == {*CONTRACT_2["lens"], "modes", "pupil", "wavelengths_nm"}
    assert entry["lens"]["modes"] == {"orders": [], "noll": [4, 8]}
    assert entry["lens"]["pupil"] == {
        "blades": None,
        "turn_deg": None,
        "roundness": None,
        "obstruction": {"value": 0.0, "std": 0.0},
        "rim": [],
        "cats_eye": None,
        "outer_f_number": entry["lens"]["f_number"],
    }
    assert written["optimum"]["accepted"] == written["global_test"]["accepted"]


def test_optimum_and_model_are_two_questions(tmp_path: Path) -> None:
    assert ACCEPTED.explains
    folder = written(
        tmp_path,
        wavefronts=(a_wavefront(test=replace(ACCEPTED, explains=False)),),
        joint={"f_number": 0.3},
    )
    entry = json.loads((folder / "results.json").read_text())
    assert entry["wavefronts"][0]["optimum"]["accepted"] is True
    assert entry["wavefronts"][0]["model"]["accepted"] is False
    again = Results.load(folder)
    assert again.wavefronts[0].test == replace(ACCEPTED, explains=False)
    assert again.joint == {"f_number": 0.3}


def test_results_without_a_lens_say_so_in_their_file(tmp_path: Path) -> None:
    folder = written(
        tmp_path,
        lens=None,
        budget={},
        wavefronts=(a_wavefront(blur=None, f_number_std=float("nan")),),
    )
    entry = json.loads((folder / "results.json").read_text())
    assert (entry["lens"], entry["budget"], entry["wavefronts"][0]["blur_um"]) == (
        None,
        {},
        None,
    )
    assert entry["wavefronts"][0]["f_number_working"] == {"value": 2.8, "std": None}
    again = Results.load(folder)
    assert (again.lens, again.budget, again.wavefronts[0].blur) == (None, {}, None)


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
    with pytest.raises(
        KeyError, match="no wavefront of R at 3100 mm: there are R at 3000 mm, B at 3000 mm"
    ):
        results[3100, "R"]
    with pytest.raises(KeyError, match="Noll mode 11"):
        results[3200, "B"][11]


def test_a_table_has_a_row_for_each_coefficient() -> None:
    pandas = pytest.importorskip("pandas")
    table = some_results().to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns)[:5] == ["range_mm", "channel", "noll", "waves", "std"]
    assert len(table) == 12
    coma = table[
        (table["range_mm"] == 3200) & (table["channel"] == "B") & (table["noll"] == 8)
    ]
    assert coma[["waves", "std"]].to_numpy().tolist() == [[-0.04, 0.0013]]


def test_a_notebook_shows_tables_and_obeys_no_names() -> None:
    html = some_results(wavefronts=(a_wavefront(channel="<b>"),), focus=None)._repr_html_()
    assert html.count("<table>") == 3
    assert "<li>no dark frames: the black level of the files (or the plan)" in html
    assert "<ul>" not in some_results(findings=())._repr_html_()
    (strehl,) = {best.strehl for best in some_results(focus=None).at_best_focus()[:1]}
    assert "<th>Strehl ratio</th>" in html
    assert f"<td>{strehl}</td>" in some_results()._repr_html_()
    assert "all numbers hold" in html
    assert "<td>&lt;b&gt;</td>" in html


def test_a_small_error_is_printed_with_its_digits_and_never_as_nothing() -> None:
    sharp = a_wavefront(covariance=np.diag([1e-10, 4e-10, 4e-10]))
    _, row = some_results(wavefronts=(sharp,)).wavefront_rows()
    assert row[2] == "+0.075100 ± 0.000010"
    assert (
        row[3] == "0.090222 ± 0.000014"
    )  # sqrt(0.0751² · 1e-10 + 0.05² · 4e-10) / 0.090222


def test_a_wavefront_is_a_row_with_its_defocus_and_its_rms() -> None:
    rejected = replace(a_wavefront(3000.0, "R", -0.3).test, accepted=False)  # type: ignore[type-var]
    results = some_results(
        wavefronts=(a_wavefront(3000.0, "R", -0.3, test=rejected), a_wavefront(None))
    )
    _, first, second = results.wavefront_rows()
    # sqrt(0.3^2 + 0.03^2 + 0.04^2)
    assert first == [
        "3000",
        "R",
        "-0.3 ± unknown",
        "0.3041 ± unknown",
        "1.018",
        "doubtful",
        "explains the photographs",
    ]
    assert second[:2] == ["", "R"]


def test_a_row_has_as_many_digits_as_its_error() -> None:
    small = a_wavefront(
        covariance=np.diag([1.21e-10, 1e-10, 1e-10])
    )  # standard errors of 1.1e-5 and 1e-5
    (_, row) = some_results(wavefronts=(small,)).wavefront_rows()
    assert row[2].endswith("± 0.000011")
    assert "± 0.0000 " not in " ".join([*row, ""])


def test_a_magnification_that_is_not_determined_is_marked() -> None:
    _, focus, _, magnification, *lens = some_results().focus_rows()
    assert focus == ["best focus R", "2986.84 ± 0.42 mm"]
    assert "do not determine" in magnification[1]
    assert ["focal length", "69.31 ± 0.12 mm"] in lens
    _, focus, magnification, *lens = some_results(focus=None).focus_rows()
    assert focus == ["best focus", "not fitted, see the warnings"]
    assert "do not determine" in magnification[1]
    assert ["focal length", "69.31 ± 0.12 mm"] in lens


def test_a_report_of_earlier_results_does_not_stay(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (folder / "figures").mkdir()
    (folder / "report.html").write_text("old")
    some_results().write(folder)
    assert {path.name for path in folder.iterdir()} == {
        "results.json",
        "psf.npz",
        "residuals.npz",
    }


def test_what_a_folder_keeps_is_known_without_reading_it_all(tmp_path: Path) -> None:
    assert kept_keys(written(tmp_path)) == {
        Key(mm, channel) for mm in (3000, 3200) for channel in "RB"
    }
    assert kept_keys(tmp_path) == set()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "run labkit fit first"),
        ("{", "cannot read"),
        ('{"schema": 7}', "schema 7, of a newer labkit; this version knows schemas to 3"),
        ('{"schema": 0}', "schema 0; this version reads schemas 1 to 3"),
        ('{"schema": 1}', "labkit_version"),
        ("[" * 100_000, "cannot read"),
    ],
)
def test_results_that_cannot_be_read_give_one_line(
    tmp_path: Path, text: str | None, complaint: str
) -> None:
    folder = tmp_path / "results" / "latest"
    folder.mkdir(parents=True)
    if text is not None:
        (folder / "results.json").write_text(text)
    with pytest.raises(DataError, match=complaint) as caught:
        Results.load(tmp_path)
    assert "\n" not in str(caught.value)


WHERE = {"range_mm": None, "channel": None, "tile": None}


@pytest.mark.parametrize(
    "damage",
    [
        {"findings": None},
        {"findings": [{"code": "a-code"}]},
        {"findings": [{"code": "NO CODE", "where": WHERE, "numbers": {}, "text": "..."}]},
        {
            "findings": [
                {
                    "code": "a-code",
                    "where": WHERE | {"channel": "R", "tile": 3},
                    "numbers": {},
                    "text": "...",
                }
            ]
        },
        {"findings": [{"code": "a-code", "where": WHERE, "numbers": [1], "text": "..."}]},
        {"wavefronts": [CONTRACT_3["wavefronts"][0] | {"key": {"channel": "R"}}]},
    ],
)
def test_damaged_findings_and_keys_give_one_line(
    tmp_path: Path, damage: dict[str, Any]
) -> None:
    with pytest.raises(
        DataError, match=r"is not as schema 3 has it: .+; fit the session again"
    ) as caught:
        printed(tmp_path, CONTRACT_3 | damage)
    assert "\n" not in str(caught.value)


def test_other_names_of_results_are_offered(tmp_path: Path) -> None:
    some_results().write(tmp_path / "results" / "22-modes")
    with pytest.raises(DataError, match="results there are: 22-modes"):
        Results.load(tmp_path)


def test_the_pupil_is_kept_with_each_wavefront(tmp_path: Path) -> None:
    rim = Rim(
        (Diaphragm(6, 0.1, 0.2), Circle(), Circle(0.2, 0.9, 0.3)),
        (0.01, 0.0, 0.02, 0.0),
        0.17,
    )
    wavefronts = (a_wavefront(rim=rim), a_wavefront(channel="B"))
    read = Results.load(written(tmp_path, wavefronts=wavefronts))
    cut, kept = read.wavefronts
    assert kept.rim == ROUND
    assert cut.fitted.rim == cut.rim
    assert cut.rim.edges(90)[0] == pytest.approx(rim.edges(90)[0], rel=1e-12)
    assert cut.outer_f_number.value == pytest.approx(cut.f_number / rim.outer)
    assert cut.outer_f_number.value < cut.f_number


@pytest.mark.parametrize(
    ("pupil", "words"),
    [
        ({"cuts": [{"blades": 2, "turn_deg": 0, "roundness": 0}]}, "blades"),
        ({"obstructed": 0.95}, "obstructed"),
        ({"uneven": [0.7, 0.0, 0.4, 0.0]}, "no closed curve"),
        ({"cuts": [{"shift": 1.0, "radius": 0.9, "direction_deg": 0}]}, "1 off"),
    ],
)
def test_a_pupil_that_cannot_be_gives_one_line(
    tmp_path: Path, pupil: dict[str, object], words: str
) -> None:
    folder = written(tmp_path)
    file = folder / "results.json"
    entry = json.loads(file.read_text())
    entry["wavefronts"][0]["pupil"] = pupil
    file.write_text(json.dumps(entry))
    with pytest.raises(DataError, match=words) as caught:
        Results.load(folder)
    assert "\n" not in str(caught.value)


def test_a_covariance_that_overflows_its_variances_is_none() -> None:
    with pytest.raises(ValueError, match="has a variance below 0"):
        refuse_no_covariance("it", np.array([[1e-300, 1e200], [1e200, 1e-300]]))
