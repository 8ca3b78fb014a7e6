"""A value and its standard error: what is printed, and what JSON keeps."""

from __future__ import annotations

import json
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labkit.uncertain import Uncertain


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (Uncertain(3024.0, 0.4, "mm"), "3024.00 ± 0.40 mm"),
        (
            Uncertain(-0.12345, 0.000996),
            "-0.1235 ± 0.0010",
        ),  # an error of 0.000996 is 0.0010, not 0.00100
        (Uncertain(2054.3, 123.4), "2054 ± 123"),
        (Uncertain(-1e-9, 0.1), "0.00 ± 0.10"),
        (Uncertain(3e9, 1.2e4, "Hz"), "(3.000000 ± 0.000012)e+09 Hz"),
        (Uncertain(-3e-9, 1.2e-12), "(-3.0000 ± 0.0012)e-09"),
        (Uncertain(0.25), "0.25 ± unknown"),
        (Uncertain(0.25, math.inf, "mm"), "0.25 ± inf mm"),
        (Uncertain(1.5, 0.0), "1.5 ± 0"),
        (Uncertain(math.nan), "not determined"),
    ],
)
def test_it_prints_two_digits_of_the_error(number: Uncertain, text: str) -> None:
    assert str(number) == text


@given(st.floats(-1e12, 1e12), st.floats(1e-12, 1e12), st.sampled_from(["", "mm"]))
def test_what_is_printed_is_the_value_to_a_twentieth_of_its_error(
    value: float, std: float, unit: str
) -> None:
    text = str(Uncertain(value, std, unit))
    shown, error, power = re.fullmatch(
        r"\(?(\S+) ± ([\d.]+)(?:\)e(\S+))?(?: mm)?", text
    ).groups()  # type: ignore[union-attr]
    factor = 10.0 ** int(power or 0)
    # fifteen places at most: an error in a billion billionth is shown as none
    slack = 1e-15 * max(abs(value), std)
    assert abs(float(error) * factor - std) <= 0.051 * std + slack
    assert abs(float(shown) * factor - value) <= 0.051 * std + slack


def test_a_format_of_numbers_holds_for_both_and_of_texts_for_the_whole() -> None:
    number = Uncertain(0.5, 0.0123, "waves")
    assert f"{number:+.3f}" == "+0.500 ± 0.012 waves"
    assert f"{number:>25}" == "    0.500 ± 0.012 waves".rjust(25)


def test_a_notebook_shows_powers_and_escapes_units() -> None:
    assert (
        Uncertain(-3e-9, 1e-12, "<b>")._repr_html_()
        == "(−3.0000 ± 0.0010) × 10<sup>−9</sup> &lt;b&gt;"
    )


@given(st.floats(), st.floats(min_value=0) | st.just(math.nan))
def test_json_has_null_for_what_is_not_finite(value: float, std: float) -> None:
    kept = json.loads(json.dumps(Uncertain(value, std).as_json(), allow_nan=False))
    expected = {"value": value, "std": std}
    assert kept == {name: x if math.isfinite(x) else None for name, x in expected.items()}
