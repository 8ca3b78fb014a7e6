"""Check the arrays that callers pass to the mathematics, with one clear line for each fault."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def real_array(
    name: str, value: ArrayLike, shape: Sequence[int | None] | None, unit: str
) -> NDArray[np.float64]:
    """Return the value as float64 of the given shape.

    None in a shape stands for any length, None alone for any shape. Raises ValueError with
    the argument's name, shape and unit for another shape, and for values that are not real
    and finite.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError(
            f"{name}: real numbers are needed ({unit}), not {array.dtype} of shape {array.shape}"
        )
    if shape is not None and not _fits(array.shape, shape):
        sides = ", ".join("any" if side is None else str(side) for side in shape)
        wanted = f"({sides},)" if len(shape) == 1 else f"({sides})"
        raise ValueError(f"{name} has shape {array.shape}; {wanted} is needed ({unit})")
    if wrong := array.size - np.count_nonzero(np.isfinite(array)):
        raise ValueError(
            f"{name}, shape {array.shape}: {wrong} of {array.size} values are not finite ({unit})"
        )
    return array.astype(np.float64)


def _fits(shape: Sequence[int], wanted: Sequence[int | None]) -> bool:
    """Return whether a shape is a wanted one, in which None stands for any length."""
    return len(shape) == len(wanted) and all(
        side in (None, have) for side, have in zip(wanted, shape, strict=True)
    )


def mask_array(name: str, value: ArrayLike, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Return the value as a mask of the given shape.

    Raises ValueError for another shape and for values that are not boolean.
    """
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
    """Return the value as a symmetric matrix (size, size) of float64.

    Raises ValueError as `real_array` does, and for a matrix that is not symmetric.
    """
    matrix = real_array(name, value, (size, size), unit)
    if not np.allclose(matrix, matrix.T, rtol=1e-8):
        raise ValueError(f"{name}, shape {matrix.shape}: it is not symmetric ({unit})")
    return matrix


def positive(name: str, value: float, unit: str) -> float:
    """Return the value, a finite number above 0.

    Raises ValueError with the argument's name and unit for any other value.
    """
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value:g}: a number above 0 is needed ({unit})")
    return value
