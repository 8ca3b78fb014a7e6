"""The numbers behind the report's figures, against closed forms."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import special

from labkit.figure_style import CHANNEL_INKS, channel_inks
from labkit.report.charts import normal_quantiles
from labkit.report.pictures import chip_image
from labkit.report.table import estimated, fixed, plus_minus, when
from labkit.results import Residuals


def test_quantiles_of_normal_residuals_keep_to_their_band() -> None:
    rng = np.random.default_rng(3)
    model, sigma = np.full((1, 1, 100, 100), 500.0), np.full((1, 1, 100, 100), 7.0)
    residuals = Residuals(rng.normal(model, sigma), model, sigma)
    normal, low, high, observed = normal_quantiles(residuals.normalised)
    assert np.all((low < normal) & (normal < high))
    # neighbouring order statistics go together, so a stray one takes some with it: allow 5 % for 1 %
    assert np.mean((observed < low) | (observed > high)) <= 0.05
    assert normal[-1] == pytest.approx(special.ndtri(1 - 0.625 / 10000.25), abs=1e-9)


def test_masked_pixels_leave_the_quantiles() -> None:
    model = np.ones((1, 1, 2, 2))
    data = np.array([[[[1.5, np.nan], [0.5, 1.0]]]])
    *_, observed = normal_quantiles(Residuals(data, model, model).normalised)
    assert observed.tolist() == [-0.5, 0.0, 0.5]


def test_chip_and_model_share_a_scale_and_the_residual_has_its_own() -> None:
    model = np.linspace(100, 900, 400).reshape(1, 1, 20, 20)
    data = model.copy()
    data[0, 0, 3, 4], data[0, 0, 5, 5] = (
        np.nan,
        model[0, 0, 5, 5] + 20.0,
    )  # four standard deviations
    content, low, high = chip_image(Residuals(data, model, np.full(model.shape, 5.0)))
    image = np.asarray(Image.open(BytesIO(content)).convert("RGB"), int)
    assert image.shape == (20, 3 * 20 + 2 * 3, 3)
    raw, fitted, rest = image[:, :20], image[:, 23:43], image[:, 46:]
    assert (low, high) == pytest.approx((100, 900), abs=2)
    assert np.array_equal(raw[0], fitted[0])
    assert tuple(raw[3, 4]) == tuple(rest[3, 4]) == (143, 206, 170)  # green: left out
    assert tuple(rest[5, 5]) == (103, 0, 31)  # the red end of the scale
    assert np.ptp(rest[0, 0]) < 3  # white in its middle


def test_a_channel_keeps_its_colour_whatever_others_there_are() -> None:
    assert (
        channel_inks(["B", "IR", "R"])["R"] == channel_inks(["R"])["R"] == CHANNEL_INKS["R"]
    )
    assert channel_inks(["M", "IR"])["M"] != channel_inks(["M", "IR"])["IR"]


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (3024.04, 0.4231, "3024.04\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.42"),
        (-0.12345, 0.000996, "−0.1235\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.0010"),
        (2054.3, 123.4, "2054\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}123"),
        (0.25, float("nan"), "0.2500\N{NO-BREAK SPACE}(error\N{NO-BREAK SPACE}unknown)"),
        (0.25, float("inf"), "not determined"),
        (0.5, 3e-12, "0.500000000\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}3.0e-12"),
    ],
)
def test_a_number_has_two_digits_of_its_error(value: float, std: float, text: str) -> None:
    assert plus_minus(value, std) == text


@pytest.mark.parametrize(
    ("std", "text"),
    [(0.04, "75.23 ± 0.04"), (0.4, "75.2 ± 0.4"), (0.0004, "75.23000 ± 0.00040")],
)
def test_an_error_is_never_printed_as_zero(std: float, text: str) -> None:
    places = 2 if std == 0.04 else 1
    assert plus_minus(75.23, std, places).replace("\N{NO-BREAK SPACE}", " ") == text


def test_a_dash_stands_where_nothing_was_estimated() -> None:
    assert estimated(None) == "—"


@pytest.mark.parametrize(
    ("iso", "text"),
    [
        ("2026-11-22T06:28:31+00:00", "22 November 2026, 06:28 UTC"),
        ("2026-01-02T23:05:00+05:30", "2 January 2026, 23:05 UTC+05:30"),
        ("2026-11-22T09:08:07", "22 November 2026, 09:08"),
        ("some day", "some day"),
    ],
)
def test_a_moment_is_written_as_a_reader_does(iso: str, text: str) -> None:
    assert when(iso) == text


def test_nothing_is_minus_zero() -> None:
    assert fixed(-0.0001, 2) == "0.00"


def test_the_template_and_its_style_are_where_the_package_data_says() -> None:
    templates = Path(__file__).parents[2] / "labkit" / "report" / "templates"
    assert {p.name for p in templates.iterdir()} == {
        "field.html.j2",
        "figures.html.j2",
        "report.html.j2",
        "report.css",
        "report.js",
    }
