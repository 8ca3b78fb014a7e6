"""The numbers behind the report's figures, against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from scipy import special

from labkit.report.charts import residual_quantiles
from labkit.report.pictures import RESIDUAL_LIMIT, fit_picture
from labkit.report.quantities import fixed, plus_minus
from labkit.report.style import NAMED, channel_inks
from labkit.results import Residuals


def test_quantiles_of_normal_residuals_keep_to_their_band() -> None:
    rng = np.random.default_rng(3)
    model, sigma = np.full((1, 1, 100, 100), 500.0), np.full((1, 1, 100, 100), 7.0)
    normal, low, high, observed = residual_quantiles(Residuals(rng.normal(model, sigma), model, sigma))
    assert np.all((low < normal) & (normal < high))
    # neighbouring order statistics go together, so a stray one takes some with it: allow 5 % for 1 %
    assert np.mean((observed < low) | (observed > high)) <= 0.05
    assert normal[-1] == pytest.approx(special.ndtri(1 - 0.625 / 10000.25), abs=1e-9)


def test_masked_pixels_leave_the_quantiles() -> None:
    model = np.ones((1, 1, 2, 2))
    data = np.array([[[[1.5, np.nan], [0.5, 1.0]]]])
    *_, observed = residual_quantiles(Residuals(data, model, model))
    assert observed.tolist() == [-0.5, 0.0, 0.5]


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
        (3024.04, 0.4231, "3024.04\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.42"),
        (-0.12345, 0.000996, "−0.1235\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.0010"),
        (2054.3, 123.4, "2054\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}123"),
        (0.25, float("nan"), "0.2500"),
        (float("nan"), float("nan"), "—"),
    ],
)
def test_a_number_has_two_digits_of_its_error(value: float, std: float, text: str) -> None:
    assert plus_minus(value, std) == text


def test_nothing_is_minus_zero() -> None:
    assert fixed(-0.0001, 2) == "0.00"


def test_the_template_and_its_style_are_where_the_package_data_says() -> None:
    templates = Path(__file__).parents[2] / "labkit" / "report" / "templates"
    assert {p.name for p in templates.iterdir()} == {"report.html.j2", "report.css"}
