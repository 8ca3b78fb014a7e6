"""A wavefront whose sign is open: both twins are in results, and no sign is printed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.results import Results, Wavefront
from labkit.uncertain import Uncertain
from tests.results_samples import a_wavefront, some_results, written

COVARIANCE = np.array([[4.0, 1.0, 0.5], [1.0, 4.0, 0.5], [0.5, 0.5, 4.0]]) * 1e-6


def of_one_range() -> Wavefront:
    """Defocus and astigmatism, which are even, and coma, which is odd; of open sign."""
    return a_wavefront(defocus=-0.579, sign_open=True, covariance=COVARIANCE)


def test_the_twin_has_its_even_modes_reversed_and_the_same_image() -> None:
    w = of_one_range()
    np.testing.assert_allclose(w.twin.waves, [0.579, -0.03, -0.04])
    assert w.twin.covariance[0, 1] == w.covariance[0, 1]
    assert w.twin.covariance[0, 2] == -w.covariance[0, 2]
    assert w.blur is not None
    assert w.twin.blur == replace(w.blur, value=-w.blur.value)
    np.testing.assert_allclose(w.twin.psf(1.0, 31), w.psf(1.0, 31), atol=1e-12)
    assert w.twin.best.strehl.value == pytest.approx(w.best.strehl.value, rel=1e-12)
    np.testing.assert_array_equal(w.twin.twin.waves, w.waves)


def test_even_modes_are_printed_without_a_sign_and_odd_ones_with_it() -> None:
    w = of_one_range()
    assert str(w[4]) == "±0.5790 ± 0.0020 waves, sign open"
    assert str(w[8]) == "-0.0400 ± 0.0020 waves"
    assert str(w.blur).startswith("±173.700 ± 0.050")
    assert f"{w[5]:+.2f}" == "±0.03 ± 0.00 waves, sign open"
    assert w[4]._repr_html_() == "±0.5790 ± 0.0020 waves, sign open"
    assert w.defocus == w[4]
    determined = a_wavefront(defocus=-0.579)
    assert str(determined[4]).startswith("-0.5790")
    assert not a_wavefront(noll=(7, 8, 9), sign_open=True).sign_open  # odd modes alone


def test_an_error_that_is_not_known_hides_no_open_sign() -> None:
    assert str(Uncertain(-3.0, sign_open=True)) == "±3 ± unknown, sign open"


def test_tables_of_results_show_no_sign_that_is_open() -> None:
    results = some_results(wavefronts=(of_one_range(),), focus=None)
    assert results.wavefront_rows()[1][2] == "±0.5790 ± 0.0020, sign open"
    assert "±0.5790 ± 0.0020, sign open" in results._repr_html_()


def test_a_table_of_coefficients_has_both_twins() -> None:
    pytest.importorskip("pandas")
    wavefronts = (of_one_range(), a_wavefront(channel="B"))
    table = some_results(wavefronts=wavefronts).to_dataframe()
    assert table["sign_open"].tolist() == [True, True, False, False, False, False]
    np.testing.assert_allclose(table["twin_waves"][:3], [0.579, -0.03, -0.04])
    assert table["twin_waves"][3:].isna().all()


def test_both_twins_are_in_the_file_and_read_back(tmp_path: Path) -> None:
    wavefronts = (of_one_range(), a_wavefront(channel="B"))
    results = some_results(wavefronts=wavefronts)
    one, other = results.as_json()["wavefronts"]
    assert one["sign_open"] is True
    assert one["waves_rms"] == pytest.approx([-0.579, 0.03, -0.04])
    assert one["twin_waves_rms"] == pytest.approx([0.579, -0.03, -0.04])
    assert (other["sign_open"], other["twin_waves_rms"]) == (False, None)
    loaded = Results.load(written(tmp_path, wavefronts=wavefronts))
    assert [w.sign_open for w in loaded] == [True, False]
    assert str(loaded[3000.0, "R"][4]) == str(of_one_range()[4])
