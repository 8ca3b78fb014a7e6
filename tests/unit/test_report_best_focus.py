"""What the report gives of a lens at best focus, against closed forms."""

import numpy as np
import pytest

from labkit.report.best_focus import BestFocus, at_best_focus, nyquist_per_mm
from labkit.report.focus_charts import energy_chart, opd_picture, perfect_energy
from labkit.report.mtf_charts import focus_mtf_chart
from labkit.results import Wavefront
from tests.results_samples import PLAN, a_wavefront, some_results


def with_modes(noll: tuple[int, ...], waves: list[float]) -> Wavefront:
    return a_wavefront(noll=noll, waves=np.array(waves), covariance=1e-6 * np.eye(len(noll)))


def test_coma_at_best_focus_has_the_span_and_the_angle_of_its_closed_form() -> None:
    best = BestFocus.of(with_modes((4, 7, 8), [0.8, 0.0, -0.04]))
    # a sqrt(8) (3 r³ - 2 r) cos(theta): greatest at the rim, where a negative one is to the left
    assert best.peak_to_valley.value == pytest.approx(2 * np.sqrt(8) * 0.04, rel=1e-3)
    assert best.peak_to_valley.std == pytest.approx(2 * np.sqrt(8) * 1e-3, rel=1e-3)
    assert best.coma is not None
    assert best.coma.magnitude.value == pytest.approx(0.04)
    assert abs(best.coma.angle_deg.value) == pytest.approx(180.0)
    assert best.trefoil is None


def test_defocus_does_not_enter_what_is_given_at_best_focus() -> None:
    best = BestFocus.of(with_modes((4,), [0.8]))
    assert best.strehl.value == pytest.approx(1.0)
    assert best.photographed.strehl.value < 0.3
    assert best.mtf50["x"].value == pytest.approx(0.40397 / (650e-6 * 2.8), rel=1e-4)  # of Goodman's perfect MTF


def test_each_channel_is_taken_where_it_is_nearest_to_focus() -> None:
    wavefronts = tuple(a_wavefront(r, "R", d) for r, d in ((2800.0, -0.9), (3000.0, -0.1), (3200.0, 0.4)))
    (best,) = at_best_focus(some_results(wavefronts=wavefronts))
    assert best.photographed.range_mm == 3000.0


@pytest.mark.parametrize(
    ("channel", "pattern", "plane"), [("R", None, 52.3), ("G", "RGGB", 52.3), ("R", "mono", 104.6)]
)
def test_a_colour_of_a_filter_array_has_half_the_sampling(channel: str, pattern: str | None, plane: float) -> None:
    sensor = PLAN.sensor.model_copy(update={"cfa_pattern": pattern})
    results = some_results(plan=PLAN.model_copy(update={"sensor": sensor}))
    assert nyquist_per_mm(results, channel) == pytest.approx((104.6, plane), abs=0.05)  # 500 / 4.78 µm


def test_a_perfect_lens_has_84_percent_within_its_first_dark_ring() -> None:
    # Born and Wolf, table 8.2
    radii = np.array([0.0, 1.2197, 2.2331, 3.2383]) * 1.82
    np.testing.assert_allclose(perfect_energy(radii, 1.82), [0.0, 0.838, 0.910, 0.938], atol=5e-4)


def test_maps_share_one_scale_that_is_even_about_zero() -> None:
    strong, weak = (BestFocus.of(with_modes((8,), [waves])) for waves in (0.04, 0.01))
    figure = opd_picture([strong, weak], 450.0)
    limits = {axes.images[0].get_clim() for axes in figure.axes[:2]}
    ((low, high),) = limits
    assert low == -high
    assert high == pytest.approx(np.sqrt(8) * 0.04, rel=0.02)  # on the rim; samples end a little within it


def test_curves_have_bands_of_one_standard_error() -> None:
    # of a lone mode with an error of 0.001 waves: the slope of the MTF by it, from a difference, times that
    less, best, more = (BestFocus.of(with_modes((8,), [waves])) for waves in (0.0799, 0.08, 0.0801))
    results = some_results(wavefronts=(best.photographed,))
    drawn = [focus_mtf_chart(results, [each]).axes[0] for each in (less, best, more)]
    below, value, above = (np.asarray(axes.lines[2].get_ydata(), float) for axes in drawn)  # after both of Nyquist's
    widest = int(np.argmax(np.abs(above - below)))
    std = 1e-3 * abs(above - below)[widest] / 2e-4
    band = np.asarray(drawn[1].collections[0].get_paths()[0].vertices)
    edges = band[np.isclose(band[:, 0], np.asarray(drawn[1].lines[2].get_xdata())[widest]), 1]
    np.testing.assert_allclose([edges.min(), edges.max()], [value[widest] - std, value[widest] + std], atol=0.01 * std)
    assert len(energy_chart(results, [best]).axes[0].collections) == 1
