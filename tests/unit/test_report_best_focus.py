"""What the report gives of a lens at best focus, against closed forms."""

from typing import Any

import numpy as np
import pytest

from labkit.figure_style import CHANNEL_INKS
from labkit.optics.psf import diffraction_mtf
from labkit.report.charts import modulation_chart, mtf_chart, strehl_chart
from labkit.report.curves import (
    ChannelFocus,
    Curves,
    at_best_focus,
    curves_of,
    full_nyquist_per_mm,
    plane_nyquist_per_mm,
)
from labkit.report.focus_charts import energy_chart
from labkit.report.lens_tables import depth_table, focus_table
from labkit.report.pictures import map_limit, opd_picture
from labkit.results import Focus, Wavefront
from labkit.uncertain import Uncertain
from tests.results_samples import PLAN, a_wavefront, some_results


def with_modes(noll: tuple[int, ...], waves: list[float]) -> Wavefront:
    return a_wavefront(
        noll=noll,
        waves=np.array(waves),
        covariance=1e-6 * np.eye(len(noll)),
        f_number_std=0.0,
        lambda_n=None,
    )


def at_focus(noll: tuple[int, ...], waves: list[float]) -> ChannelFocus:
    return ChannelFocus(with_modes(noll, waves), PLAN.sensor)


def curves(**changed: object) -> list[Curves]:
    results = some_results(**changed)
    return curves_of(results, at_best_focus(results))


def test_coma_at_best_focus_has_the_span_and_the_angle_of_its_closed_form() -> None:
    best = at_focus((4, 7, 8), [0.8, 0.0, -0.04]).best
    # a sqrt(8) (3 r³ - 2 r) cos(theta): greatest at the rim, where a negative one is to the left
    assert best.peak_to_valley.value == pytest.approx(2 * np.sqrt(8) * 0.04, rel=1e-3)
    assert best.peak_to_valley.std == pytest.approx(2 * np.sqrt(8) * 1e-3, rel=1e-3)
    assert best.coma is not None
    assert best.coma.magnitude.value == pytest.approx(0.04)
    assert abs(best.coma.angle_deg.value) == pytest.approx(180.0)
    assert best.trefoil is None


def test_defocus_does_not_enter_what_is_given_at_best_focus() -> None:
    best = at_focus((4,), [0.8])
    assert best.best.strehl.value == pytest.approx(1.0)
    assert best.photographed.strehl.value < 0.3
    assert best.mtf50("x").value == pytest.approx(
        0.40397 / (650e-6 * 2.8), rel=1e-4
    )  # of Goodman's perfect MTF


def test_each_channel_is_taken_where_it_is_nearest_to_focus() -> None:
    wavefronts = tuple(
        a_wavefront(r, "R", d) for r, d in ((2800.0, -0.9), (3000.0, -0.1), (3200.0, 0.4))
    )
    (best,) = at_best_focus(some_results(wavefronts=wavefronts))
    assert best.photographed.range_mm == 3000.0


@pytest.mark.parametrize(
    ("channel", "pattern", "plane"),
    [("R", None, 52.3), ("G", "RGGB", 52.3), ("R", "mono", 104.6)],
)
def test_a_colour_of_a_filter_array_has_half_the_sampling(
    channel: str, pattern: str | None, plane: float
) -> None:
    sensor = PLAN.sensor.model_copy(update={"cfa_pattern": pattern})
    assert full_nyquist_per_mm(sensor) == pytest.approx(104.6, abs=0.05)  # 500 / 4.78 µm
    assert plane_nyquist_per_mm(sensor, channel) == pytest.approx(plane, abs=0.05)


def test_mtf_at_the_planes_own_nyquist_is_the_closed_form_with_and_without_the_pixel() -> (
    None
):
    best = at_focus((4,), [0.8])
    nyquist = 250 / 4.78
    perfect = float(diffraction_mtf(np.array(nyquist * 650e-6 * 2.8)))
    assert best.at_nyquist("y").value == pytest.approx(perfect, rel=1e-9)
    # half of Nyquist's frequency of all pixels: sinc(1/4)
    assert best.camera_at_nyquist("y").value == pytest.approx(
        perfect * np.sin(np.pi / 4) / (np.pi / 4), rel=1e-9
    )
    cells = {row.cells[0]: row.cells[2] for row in focus_table([best]).rows}
    assert cells["Nyquist of its own pixels"] == "52.3"
    assert cells["Coma"] == "not fitted"


def test_maps_share_one_scale_that_is_even_about_zero() -> None:
    strong, weak = (at_focus((8,), [waves]).fitted for waves in (0.04, 0.01))
    limit = map_limit([strong, weak])
    assert limit == pytest.approx(
        np.sqrt(8) * 0.04, rel=0.06
    )  # on the rim; few samples end a little within it
    figure = opd_picture({"R": strong, "B": weak}, limit, 450.0, "3000 mm")
    assert {axes.images[0].get_clim() for axes in figure.axes[:2]} == {(-limit, limit)}


def test_curves_have_bands_of_one_standard_error() -> None:
    # of a lone mode with an error of 0.001 waves: the slope of the MTF by it, from a difference, times that
    def drawn(waves: float) -> list[Curves]:
        return curves(wavefronts=(with_modes((8,), [waves]),), focus=None)

    less, best, more = (drawn(waves)[0] for waves in (0.0799, 0.08, 0.0801))
    rise = np.abs(more.mtf["x"].value - less.mtf["x"].value)
    widest, step = int(np.argmax(rise)), 1e-3 / 2e-4
    axes = mtf_chart(some_results(), best, CHANNEL_INKS["R"]).axes[0]
    band = np.asarray(axes.collections[0].get_paths()[0].vertices)
    edges = band[np.isclose(band[:, 0], best.mtf["x"].frequency_per_mm[widest]), 1]
    std = rise[widest] * step
    np.testing.assert_allclose(
        [edges.min(), edges.max()],
        best.mtf["x"].value[widest] + [-std, std],
        atol=0.01 * std,
    )
    assert len(energy_chart([best], CHANNEL_INKS).axes[0].collections) == 1


def test_channels_through_focus_differ_by_more_than_their_colour() -> None:
    each, inks = curves(), {"R": CHANNEL_INKS["R"], "B": CHANNEL_INKS["B"]}
    for figure in (strehl_chart(each, inks), modulation_chart(each, inks)):
        lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 2]  # type: ignore[arg-type]
        of_colour = {str(line.get_color()): line.get_marker() for line in lines}
        assert of_colour == {ink.colour: ink.marker for ink in inks.values()}
        first = {str(line.get_color()): line.get_markevery()[0] for line in lines}  # type: ignore[index]
        assert len(set(first.values())) == 2  # nor do their markers cover one another


def test_the_depth_of_focus_of_a_perfect_lens_is_four_wavelengths_n_squared() -> None:
    flat: dict[str, Any] = {
        "noll": (4,),
        "waves": np.array([0.05]),
        "covariance": 1e-8 * np.eye(1),
        "f_number_std": 0.0028,
    }
    results = some_results(wavefronts=(a_wavefront(3000.0, "R", **flat),))
    one = curves_of(results, at_best_focus(results))
    cells = {row.cells[0]: row.cells[2] for row in depth_table(one, results).rows}
    # 4.12 lambda N², where sinc² falls to 0.8; and 0.1 % of the f-number twice
    value, _, error = cells["on the sensor"].partition(
        "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}"
    )
    assert float(value) == pytest.approx(4.12 * 0.65 * 2.8**2, rel=1e-3)
    assert float(error) == pytest.approx(2e-3 * float(value), rel=0.05)
    # on the object's side: times (r / f)², near enough
    near, far = (
        float(cells[key].split("\N{NO-BREAK SPACE}")[0])
        for key in ("Depth of focus from", "to")
    )
    assert far - near == pytest.approx(float(value) * 1e-3 * (2981 / 69.31) ** 2, rel=0.06)
    assert near < 2986.84 < far


def test_a_place_through_focus_has_the_error_of_best_focus_beside_its_own() -> None:
    (red, _) = curves()
    at = red.placed(Uncertain(0.0, 0.0), 0.42)
    assert at.value == pytest.approx(2986.84)
    assert at.std == pytest.approx(0.42)


def test_a_lens_focused_far_away_has_no_end_of_its_depth_of_focus() -> None:
    far = Focus(
        {"R": Uncertain(900_000.0, 900.0, "mm")},
        Uncertain(1.0, 0.1),
        identifiable=True,
        residual_waves={},
    )
    results = some_results(wavefronts=(a_wavefront(),), focus=far)
    # beyond f² over 2 lambda N², 450 m, infinity is within the depth of focus
    cells = {
        row.cells[0]: row.cells[2]
        for row in depth_table(curves_of(results, at_best_focus(results)), results).rows
    }
    assert cells["to"] == "beyond any range"


def test_without_best_focus_the_axis_is_the_way_of_the_sensor() -> None:
    (one, _) = curves(focus=None)
    assert not one.in_ranges
    assert one.place(0.1) == pytest.approx(8 * 2.8**2 * np.sqrt(12) * 0.1 * 0.45)
