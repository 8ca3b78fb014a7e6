"""What the report says of fits that do not hold, or whose sign is open: nothing that misleads."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.figure_style import channel_inks
from labkit.report.charts import zernike_chart
from labkit.report.curves import at_best_focus, curves_of
from labkit.report.figures import Artist
from labkit.report.html import write_report
from labkit.report.photographs import Photographs
from labkit.results import Wavefront
from tests.results_samples import ACCEPTED, a_wavefront, some_results, written

INCOMPLETE = replace(ACCEPTED, name="session", explains=False)
PLUS_MINUS = "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}"


@pytest.fixture(autouse=True)
def words_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without their figures, which take most of the time."""
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})


def report(tmp_path: Path, *wavefronts: Wavefront, **changed: Any) -> str:
    folder = written(tmp_path, wavefronts=wavefronts, **changed)
    return write_report(folder).read_text(encoding="utf-8")


def test_nothing_reads_as_good_where_the_model_is_incomplete(tmp_path: Path) -> None:
    ranges_mm = (3000.0, 3100.0, 3200.0)
    html = report(tmp_path, *(a_wavefront(r, test=INCOMPLETE) for r in ranges_mm))
    assert '<li class="bad">in 3 of 3 fits the model is incomplete' in html
    assert '<li class="good">optimum found in 3 of 3 fits</li>' in html
    assert '<li class="bad">model explains the photographs in 0 of 3 fits, not' in html
    assert "no sign" not in html


def test_an_open_sign_is_no_sign_in_any_table(tmp_path: Path) -> None:
    html = report(tmp_path, a_wavefront(3000.0, "R", -0.3, sign_open=True), focus=None)
    assert f"±0.3000{PLUS_MINUS}0.0011, sign open" in html  # defocus
    assert f"±0.0300{PLUS_MINUS}0.0012, sign open" in html  # astigmatism, which is even
    assert f"<td>\N{MINUS SIGN}0.0400{PLUS_MINUS}0.0013</td>" in html  # coma, which is odd
    assert '<li class="bad">the sign of all even modes is open' in html
    assert "\N{MINUS SIGN}0.3000" not in html


def test_modes_of_open_sign_are_drawn_with_their_twins() -> None:
    def bars(sign_open: bool) -> list[float]:
        wavefronts = (a_wavefront(sign_open=sign_open),)
        focused = at_best_focus(some_results(wavefronts=wavefronts))
        figure = zernike_chart(focused, 450.0, channel_inks(["R"]))
        assert figure is not None
        return sorted(patch.get_width() for patch in figure.axes[0].patches)  # type: ignore[attr-defined]

    np.testing.assert_allclose(bars(False), [-0.04, 0.03])
    np.testing.assert_allclose(bars(True), [-0.04, -0.04, -0.03, 0.03])


def test_an_error_that_nothing_confirms_is_not_printed(tmp_path: Path) -> None:
    alone = a_wavefront(test=INCOMPLETE)
    html = report(tmp_path, alone, focus=None)
    row = html[html.index("Strehl ratio</td>") :].split("</tr>")[0]
    value = f"{alone.best.strehl.value:.3f}"
    assert f"{value}\N{NO-BREAK SPACE}(error\N{NO-BREAK SPACE}unknown)" in row
    assert "±" not in row
    defocus = "<td>0.0751\N{NO-BREAK SPACE}(error\N{NO-BREAK SPACE}unknown)</td>"
    assert defocus in html[html.index("χ²/pixel") :]


def test_of_defocus_alone_no_number_of_the_lens_is_shown(tmp_path: Path) -> None:
    alone = a_wavefront(noll=(4,), waves=np.array([0.1]), covariance=1e-6 * np.eye(1))
    html = report(tmp_path, alone, focus=None)
    assert "1.000" not in html
    assert (
        html[html.index("Strehl ratio</td>") :]
        .split("</tr>")[0]
        .endswith("<td>not fitted</td>")
    )
    assert html.count("<strong>not fitted</strong>") >= 3  # the cards that lead
    results = some_results(wavefronts=(alone,), focus=None)
    curves = curves_of(results, at_best_focus(results))
    assert list(Artist(results, curves, Photographs()).at_best_focus()) == []
