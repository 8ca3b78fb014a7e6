"""Cells of CSV files that labkit writes: never a formula, and numbers stay numbers."""

from __future__ import annotations

import csv
import io
from math import inf, nan

import numpy as np
import pytest

from labkit.storage.spreadsheet import csv_text


def cells(*row: str | float | None) -> list[str]:
    (read,) = csv.reader(io.StringIO(csv_text([row]), newline=""))
    return read


@pytest.mark.parametrize(
    "sign", ["=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20"]
)
@pytest.mark.parametrize(
    "before", ["", " ", "  ", "\t", "\r", "\n", "\r\n", "\x0b", "\xa0", "\0"]
)
def test_a_text_is_no_formula_whatever_is_before_its_sign(before: str, sign: str) -> None:
    text = f"{before}{sign}cmd|' /C calc'!A0"
    assert cells(text) == [f"'{text}"]


@pytest.mark.parametrize(
    "text", ["-0.5", "+1.5e-07", "-3", "12", "1e5", "G", "a=b", "", " a"]
)
def test_numbers_stay_numbers_and_texts_texts(text: str) -> None:
    assert cells(text, "") == [text, ""]


def test_numbers_have_nine_digits_and_none_that_is_not_finite_is_written() -> None:
    row = (-1 / 3, np.float64(2.0), -7, nan, -inf, None)
    assert cells(*row) == ["-0.333333333", "2", "-7", "", "", ""]


@pytest.mark.parametrize("text", ["-1+1", "+1,5", "-1e5x", "--1", "-", "=1"])
def test_what_begins_like_a_number_is_a_formula_all_the_same(text: str) -> None:
    assert cells(text, "") == [f"'{text}", ""]
