"""The numbers behind the report's figures, against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from scipy import special

from labkit.report.charts import half_contrast, mtf, residual_quantiles
from labkit.report.pictures import RESIDUAL_LIMIT, fit_picture, peak_ratio
from labkit.report.quantities import fixed, plus_minus
from labkit.report.reading import Residuals, Wavefront
from labkit.report.style import NAMED, channel_inks

WAVELENGTH_UM, F_NUMBER, SPACING_UM = 0.55, 2.8, 0.6


def airy(size: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Unit-sum Airy pattern [2 J1(v) / v]², v = pi r / (lambda N)."""
    axis = (np.arange(size) - size // 2) * SPACING_UM
    v = np.pi * np.hypot(axis[:, None], axis[None, :]) / (WAVELENGTH_UM * F_NUMBER)
    v[size // 2, size // 2] = 1e-9
    pattern = (2 * special.j1(v) / v) ** 2
    return np.asarray(pattern / pattern.sum())


def a_fit(psf: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Wavefront:
    some = np.array([0.1])
    return Wavefront(
        3000.0, "G", 1e3 * WAVELENGTH_UM, (4,), some, some, None, some, 1.0, 1.0, 1.0, None, 1.0, (), psf, None
    )


def test_mtf_of_an_airy_pattern_is_that_of_a_perfect_lens() -> None:
    size = 801
    frequency, along_x, along_y = mtf(airy(size), SPACING_UM)
    nu = np.minimum(frequency * WAVELENGTH_UM * 1e-3 * F_NUMBER, 1.0)
    perfect = 2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2))
    # the window misses at most 0.2 lambda N / r of the energy
    tolerance = 2 * 0.2 * WAVELENGTH_UM * F_NUMBER / (size // 2 * SPACING_UM)
    np.testing.assert_allclose(along_x, perfect, atol=tolerance)
    np.testing.assert_allclose(along_y, perfect, atol=tolerance)


def test_mtf_along_x_is_that_of_a_blur_along_columns() -> None:
    psf = np.zeros((65, 65))
    psf[32, 30:35] = 0.2
    _, along_x, along_y = mtf(psf, SPACING_UM)
    assert along_x.min() < 0.1
    np.testing.assert_allclose(along_y, 1.0)


def test_half_contrast_of_a_gaussian_is_at_its_closed_form() -> None:
    sigma_um = 3.0
    axis = (np.arange(161) - 80) * SPACING_UM
    psf = np.exp(-(axis[:, None] ** 2 + axis[None, :] ** 2) / (2 * sigma_um**2))
    frequency, along_x, _ = mtf(psf, SPACING_UM)
    # exp(-2 (pi sigma f)²) = 1/2; the frequencies are 1.6 cycles/mm apart, and the curve is smooth between them
    expected = np.sqrt(np.log(2) / 2) / (np.pi * sigma_um * 1e-3)
    assert half_contrast(frequency, along_x) == pytest.approx(expected, abs=0.1)


def test_a_curve_that_never_falls_to_half_has_no_half_contrast() -> None:
    assert np.isnan(half_contrast(np.arange(3.0), np.ones(3)))


def test_the_peak_of_a_perfect_psf_is_one() -> None:
    size = 801
    # within the energy that the window misses
    tolerance = 0.2 * WAVELENGTH_UM * F_NUMBER / (size // 2 * SPACING_UM)
    assert peak_ratio(a_fit(airy(size)), F_NUMBER, SPACING_UM) == pytest.approx(1.0, abs=2 * tolerance)


def test_quantiles_of_normal_residuals_keep_to_their_band() -> None:
    rng = np.random.default_rng(3)
    model, sigma = np.full((1, 1, 100, 100), 500.0), np.full((1, 1, 100, 100), 7.0)
    normal, low, high, seen = residual_quantiles(Residuals(rng.normal(model, sigma), model, sigma))
    assert np.all((low < normal) & (normal < high))
    # neighbouring order statistics go together, so a stray one takes some with it: allow 5 % for 1 %
    assert np.mean((seen < low) | (seen > high)) <= 0.05
    assert normal[-1] == pytest.approx(special.ndtri(1 - 0.625 / 10000.25), abs=1e-9)


def test_masked_pixels_leave_the_quantiles() -> None:
    model = np.ones((1, 1, 2, 2))
    data = np.array([[[[1.5, np.nan], [0.5, 1.0]]]])
    *_, seen = residual_quantiles(Residuals(data, model, model))
    assert seen.tolist() == [-0.5, 0.0, 0.5]


def test_chip_and_model_share_a_scale_and_the_residual_has_its_own() -> None:
    rng = np.random.default_rng(4)
    model = np.linspace(100, 900, 400).reshape(1, 1, 20, 20)
    figure = fit_picture(Residuals(model + rng.normal(0, 5, model.shape), model, np.full(model.shape, 5.0)))
    raw, fitted, rest = (axes.images[0] for axes in figure.axes[:3])
    assert raw.get_clim() == fitted.get_clim()
    assert rest.get_clim() == (-RESIDUAL_LIMIT, RESIDUAL_LIMIT)


def test_a_channel_keeps_its_colour_whatever_others_there_are() -> None:
    assert channel_inks(["B", "IR", "R"])["R"] == channel_inks(["R"])["R"] == NAMED["R"]
    assert channel_inks(["M", "IR"])["M"] != channel_inks(["M", "IR"])["IR"]


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (3024.04, 0.4231, "3024.04 ± 0.42"),
        (-0.12345, 0.000996, "−0.1235 ± 0.0010"),
        (2054.3, 123.4, "2054 ± 123"),
        (0.25, float("nan"), "0.2500"),
        (float("nan"), float("nan"), "—"),
    ],
)
def test_a_number_has_two_digits_of_its_error(value: float, std: float, text: str) -> None:
    assert plus_minus(value, std) == text


def test_nothing_is_minus_zero() -> None:
    assert fixed(-0.0001, 2) == "0.00"


def test_rms_and_its_error_follow_the_covariance() -> None:
    waves, std = np.array([0.5, 0.03, 0.04]), np.array([0.01, 0.02, 0.02])
    covariance = np.diag(std**2)
    covariance[1, 2] = covariance[2, 1] = -(0.02**2) * 0.5
    fit = Wavefront(
        None, "G", 550.0, (4, 5, 6), waves, std, covariance, waves, 1.0, 1.0, 1.0, None, 1.0, (), None, None
    )
    rng = np.random.default_rng(5)
    draws = rng.multivariate_normal(waves[1:], covariance[1:, 1:] * 1e-4, 20000)
    rms = fit.rms(without=(4,))
    assert rms.value == pytest.approx(0.05)
    # a hundredth of the error makes it linear; the std of 20000 draws has 0.5 % relative error; allow four of them
    assert rms.std == pytest.approx(100 * np.std(np.hypot(*draws.T)), rel=0.02)


def test_the_template_and_its_style_are_where_the_package_data_says() -> None:
    templates = Path(__file__).parents[2] / "labkit" / "report" / "templates"
    assert {p.name for p in templates.iterdir()} == {"report.html.j2", "report.css"}
