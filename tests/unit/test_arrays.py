"""One line names the argument, its shape and its unit."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from labkit.arrays import mask_array, real_array


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ([1.0, 2.0], r"waves has shape \(2,\); \(3,\) is needed \(waves RMS\)"),
        ([[1.0, 2.0, 3.0]], r"waves has shape \(1, 3\); \(3,\) is needed \(waves RMS\)"),
        (
            [1.0, np.nan, np.inf],
            r"waves, shape \(3,\): 2 of 3 values are not finite \(waves RMS\)",
        ),
        (
            [1j, 0, 0],
            r"waves: real numbers are needed \(waves RMS\), not complex128 of shape \(3,\)",
        ),
        (
            ["a", "b", "c"],
            r"waves: real numbers are needed \(waves RMS\), not <U1 of shape \(3,\)",
        ),
    ],
)
def test_a_wrong_array_is_named_with_its_shape_and_unit(
    value: ArrayLike, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        real_array("waves", value, (3,), "waves RMS")


def test_any_length_is_taken_where_none_is_asked_for() -> None:
    array = real_array("image", np.ones((2, 3), np.uint8), (2, None), "counts")
    assert array.shape == (2, 3)
    assert array.dtype == np.float64


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (
            np.ones((2, 3)),
            r"known: a boolean mask of shape \(2, 3\) is needed, not float64 of shape \(2, 3\)",
        ),
        (np.ones(3, bool), r"known has shape \(3,\); a mask of shape \(2, 3\) is needed"),
    ],
)
def test_a_mask_is_boolean_and_of_the_datas_shape(value: ArrayLike, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        mask_array("known", value, (2, 3))
