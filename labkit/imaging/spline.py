"""A quintic spline over a raster, read on a grid that a homography lays over it: what drawing a target comes to.

Compiled, for there is nothing to vectorise by: scipy's `map_coordinates` gives the same to 1e-11 in seven times the time.
"""

import math

import cv2
import numpy as np
from numba import njit

from labkit.types import Floats, Floats32

# M. Unser, Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16, 1999
POLES = (
    math.sqrt(135 / 2 - math.sqrt(17745 / 4)) + math.sqrt(105 / 4) - 13 / 2,
    math.sqrt(135 / 2 + math.sqrt(17745 / 4)) - math.sqrt(105 / 4) - 13 / 2,
)
REACH = 45  # samples, after which the larger pole has fallen below 1e-16

AT_ONCE = 512  # columns that are filtered together


def coefficients(raster: Floats) -> Floats:
    """(rows, columns) of the spline through a raster's samples, mirrored at its borders."""
    spline = along_rows(raster)
    filter_columns(spline)
    return spline


def along_rows(raster: Floats) -> Floats:
    """(rows, columns) samples along rows become coefficients; each row stands for itself, so a raster may come in parts."""
    spline = np.asarray(
        cv2.transpose(np.asarray(raster, dtype=float)), dtype=float
    )  # numpy's takes longer than the filter
    _filter_columns(spline)
    return np.asarray(cv2.transpose(spline), dtype=float)


def filter_columns(spline: Floats | Floats32) -> None:
    """Samples along columns become coefficients, in place; in double precision, whatever they are kept in."""
    for first in range(0, spline.shape[1], AT_ONCE):
        some = np.array(spline[:, first : first + AT_ONCE], dtype=float, order="C")
        _filter_columns(some)
        spline[:, first : first + AT_ONCE] = some


def read(spline: Floats | Floats32, onto: Floats, shape: tuple[int, int]) -> Floats:
    """(rows, columns) of a shape, [i, j] the spline's value at the raster's place `onto` (3, 3) @ (i, j, 1); 0 near and beyond
    its borders, where the spline has no six samples.

    spline: from `coefficients`, in either precision; sums are in double.
    """
    values = np.zeros(shape)
    _read(spline, np.ascontiguousarray(onto, dtype=float), values)
    return values


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _read(spline: Floats | Floats32, onto: Floats, values: Floats) -> None:
    rows, columns = spline.shape
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            w = 1 / (onto[2, 0] * i + onto[2, 1] * j + onto[2, 2])
            y = (onto[0, 0] * i + onto[0, 1] * j + onto[0, 2]) * w
            x = (onto[1, 0] * i + onto[1, 1] * j + onto[1, 2]) * w
            if not (2 <= y < rows - 3 and 2 <= x < columns - 3):
                continue
            row, column = math.floor(y) - 2, math.floor(x) - 2
            down, across = _weights(y - row - 2), _weights(x - column - 2)
            total = 0.0
            for k in range(6):
                line = spline[row + k]
                total += down[k] * (
                    across[0] * line[column]
                    + across[1] * line[column + 1]
                    + across[2] * line[column + 2]
                    + across[3] * line[column + 3]
                    + across[4] * line[column + 4]
                    + across[5] * line[column + 5]
                )
            values[i, j] = total


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _weights(t: float) -> tuple[float, float, float, float, float, float]:
    """Of the six samples around a place, t (0..1) past the third: the quintic B-spline's pieces."""
    s = 1 - t
    return (
        s**5 / 120,
        (1 + 5 * s * (1 + s * (2 + s * (2 + s * (1 - s))))) / 120,
        (66 - t**2 * (60 - t**2 * (30 - 10 * t))) / 120,
        (66 - s**2 * (60 - s**2 * (30 - 10 * s))) / 120,
        (1 + 5 * t * (1 + t * (2 + t * (2 + t * (1 - t))))) / 120,
        t**5 / 120,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _filter_columns(samples: Floats) -> None:
    """Samples along axis 0 become coefficients of the spline through them, in place."""
    rows, columns = samples.shape
    for z in POLES:
        first = np.zeros(columns)
        for i in range(min(rows, REACH)):
            first += z**i * samples[i]
        samples *= (1 - z) * (1 - 1 / z)
        samples[0] = first * ((1 - z) * (1 - 1 / z))
        for i in range(1, rows):
            for j in range(columns):
                samples[i, j] += z * samples[i - 1, j]
        for j in range(columns):
            samples[rows - 1, j] = z / (z**2 - 1) * (samples[rows - 1, j] + z * samples[rows - 2, j])
        for i in range(rows - 2, -1, -1):
            for j in range(columns):
                samples[i, j] = z * (samples[i + 1, j] - samples[i, j])
