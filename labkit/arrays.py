"""What an array handed to the mathematics must be, and one line that says so where it is not."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def real_array(
    name: str, value: ArrayLike, shape: Sequence[int | None] | None, unit: str
) -> NDArray[np.float64]:
    """The value as float64, of the given shape, where None stands for any length; None alone for any shape.

    Raises ValueError that names the argument, its shape and its unit for another shape, for what is no real number
    and for values that are not finite.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError(
            f"{name}: real numbers are needed ({unit}), not {array.dtype} of shape {array.shape}"
        )
    shape = array.shape if shape is None else shape
    wanted = (
        "("
        + ", ".join("any" if side is None else str(side) for side in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
    if array.ndim != len(shape) or any(
        side not in (None, have) for side, have in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"{name} has shape {array.shape}; {wanted} is needed ({unit})")
    if wrong := array.size - np.count_nonzero(np.isfinite(array)):
        raise ValueError(
            f"{name}, shape {array.shape}: {wrong} of {array.size} values are not finite ({unit})"
        )
    return array.astype(np.float64)


def mask_array(name: str, value: ArrayLike, shape: Sequence[int]) -> NDArray[np.bool_]:
    """The value as a mask of the given shape. Raises ValueError for another shape and for what is not boolean."""
    array = np.asarray(value)
    if array.dtype != np.bool_:
        raise ValueError(
            f"{name}: a boolean mask of shape {tuple(shape)} is needed, not {array.dtype} of shape {array.shape}"
        )
    if array.shape != tuple(shape):
        raise ValueError(
            f"{name} has shape {array.shape}; a mask of shape {tuple(shape)} is needed"
        )
    return array


def symmetric(name: str, value: ArrayLike, size: int, unit: str) -> NDArray[np.float64]:
    """The value as a symmetric matrix (size, size) of float64. Raises ValueError as `real_array` does, and for any other."""
    matrix = real_array(name, value, (size, size), unit)
    if not np.allclose(matrix, matrix.T, rtol=1e-8):
        raise ValueError(f"{name}, shape {matrix.shape}: it is not symmetric ({unit})")
    return matrix


def positive(name: str, value: float, unit: str) -> float:
    """The value, a finite number above 0. Raises ValueError that names it and its unit for any other."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value:g}: a number above 0 is needed ({unit})")
    return value
