"""The lens beside what the plan states, and its errors by source, as the report sets them."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.optics.lens import ThinLens
from labkit.report.charts import budget_chart, variance_shares
from labkit.report.contents import contents
from labkit.report.focus_charts import defocus_chart, residual_chart
from labkit.report.lens_tables import budget_table, lens_table, working_f_number
from labkit.report.photographs import Photographs
from labkit.results import Wavefront
from labkit.uncertain import Uncertain
from tests.results_samples import BUDGET, LENS, a_wavefront, some_results
from tests.unit.test_findings import SAMPLES


def row(name: str) -> tuple[str, str]:
    """Measured and stated, of a row of the table."""
    table = lens_table(some_results())
    assert table is not None
    (one,) = (row.cells for row in table.rows if row.cells[0].startswith(name))
    return one[2].replace("\N{NO-BREAK SPACE}", " "), one[3].replace(
        "\N{NO-BREAK SPACE}", " "
    )


@pytest.mark.parametrize(
    ("name", "measured", "stated"),
    [
        ("Focal length", "69.31 ± 0.12", "70.0 ± 1.4"),  # 2 % of 70 mm
        ("f-number at infinity", "2.874 ± 0.011", "2.800 ± 0.084"),  # 3 % of 2.8
        ("Pupil magnification", "0.981 ± 0.038", "—"),
        ("True ranges", "−5.8 ± 4.0", "0 ± 10"),  # 10 mm of tape
        ("Best focus", "2986.84 ± 0.42", "—"),
        ("f-number at the sensor", "2.8000 ± 0.0080", "—"),
    ],
)
def test_what_is_measured_stands_beside_what_the_plan_states(
    name: str, measured: str, stated: str
) -> None:
    assert row(name) == (measured, stated)


@pytest.mark.parametrize(
    "code",
    ["plan-contradicted", "cones-contradict-one-lens", "pupil-magnification-at-bound"],
)
def test_what_contradicts_the_plan_is_a_red_check(code: str) -> None:
    (finding,) = (one for one in SAMPLES if one.code == code)
    results = some_results(findings=(finding,))
    page = contents(results, results, [], Photographs(), set())
    assert {"good": False, "text": finding.text} in page["checks"]


def test_results_without_a_lens_have_no_rows() -> None:
    assert lens_table(some_results(lens=None)) is None
    assert budget_table(some_results(budget={})) is None


def test_the_cone_is_that_of_the_wavefront_that_knows_it_best() -> None:
    def cone(f_number: float, std: float) -> Wavefront:
        return a_wavefront(f_number=f_number, f_number_std=std)

    results = some_results(
        wavefronts=(cone(2.7, float("nan")), cone(2.9, 0.01), cone(2.8, 0.1))
    )
    assert working_f_number(results, "R") == Uncertain(2.9, 0.01)


def test_curves_are_those_of_the_lens_that_was_estimated() -> None:
    results = some_results()
    assert results.thin_lens == ThinLens(69.31, 2.874, 0.981)
    assert results.range_zero_mm == -5.8


def test_without_an_estimated_lens_curves_are_those_of_the_plan() -> None:
    results = some_results(lens=None)
    assert results.thin_lens == ThinLens(70.0, 2.8, 0.981)
    assert results.range_zero_mm == 0.0


def test_defocus_is_shown_as_blur_too() -> None:
    results = some_results()
    figure = defocus_chart(
        results, results.focus, lambda channel, ranges_mm: 0 * ranges_mm, 71.0
    )
    figure.draw_without_rendering()
    waves, blur = (
        axes.get_ylim() for axes in (figure.axes[0], figure.axes[0].child_axes[0])
    )
    np.testing.assert_allclose(blur, 300 * np.array(waves))
    schema_1 = some_results(
        wavefronts=tuple(a_wavefront(r, blur=None) for r in (3000.0, 3200.0)), focus=None
    )
    assert (
        not defocus_chart(schema_1, None, lambda channel, ranges_mm: 0 * ranges_mm, 71.0)
        .axes[0]
        .child_axes
    )


def test_no_line_runs_through_the_legend_of_defocus_against_range() -> None:
    results = some_results()
    assert results.focus is not None
    flat = defocus_chart(results, results.focus, lambda _, ranges_mm: 0 * ranges_mm, 71.0)
    for figure in (flat, residual_chart(results, results.focus, 71.0)):
        figure.draw_without_rendering()
        (axes, legend) = figure.axes[0], figure.axes[0].get_legend()
        assert legend is not None
        box = legend.get_window_extent()
        assert axes.bbox.y1 <= box.y0 < box.y1 <= figure.bbox.y1


def test_defocus_residuals_have_their_errors() -> None:
    results = some_results()
    assert results.focus is not None
    axes = residual_chart(results, results.focus, 71.0).axes[0]
    (red, _) = axes.containers
    lines = red.lines[2][0].get_segments()  # type: ignore[attr-defined]
    np.testing.assert_allclose([line[1, 1] - line[0, 1] for line in lines], [1.0, 1.2])


def test_shares_are_of_the_variance_and_make_the_whole() -> None:
    shares = variance_shares(BUDGET["best_focus_mm.R"])
    # 0.09, 0.01, 0.04 and 0.04 of 0.18
    np.testing.assert_allclose(shares, [50.0, 100 / 18, 400 / 18, 400 / 18])
    assert sum(variance_shares(dict.fromkeys(BUDGET["best_focus_mm.R"], 0.0))) == 0


def test_the_whole_of_a_row_is_its_sources_added_in_squares() -> None:
    table = budget_table(some_results())
    assert table is not None
    assert table.rows[0].cells == (
        "best focus, R",
        "mm",
        "0.300",
        "0.100",
        "0.200",
        "0.200",
        "0.424",
    )  # sqrt(0.18)


def test_bars_reach_a_hundred_per_cent_and_only_wide_pieces_are_labelled() -> None:
    axes = budget_chart(some_results()).axes[0]
    ends = [patch.get_x() + patch.get_width() for patch in axes.patches]  # type: ignore[attr-defined]
    assert max(ends) == pytest.approx(100.0)
    assert [text.get_text() for text in axes.texts] == ["50", "22", "100", "22"]


def test_a_lens_without_focus_of_some_channel_is_still_drawn() -> None:
    table = lens_table(some_results(focus=None, lens=LENS))
    assert table is not None
    assert not any(row.cells[0].startswith("Best focus") for row in table.rows)
