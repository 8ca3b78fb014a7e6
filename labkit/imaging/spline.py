"""Evaluate a quintic spline over a raster on a homography's grid: the core of drawing a target.

The code is compiled, in single precision: scipy's `map_coordinates` gives the same to 6e-7
of white in eight times the time.
"""

import math

import cv2
import numpy as np
from numba import njit

from labkit.imaging.warp import BEND_POWERS
from labkit.types import Floats, Floats32

# M. Unser, Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16, 1999
POLES = (
    math.sqrt(135 / 2 - math.sqrt(17745 / 4)) + math.sqrt(105 / 4) - 13 / 2,
    math.sqrt(135 / 2 + math.sqrt(17745 / 4)) - math.sqrt(105 / 4) - 13 / 2,
)
POLE_REACH = 45  # samples, after which the larger pole has fallen below 1e-16

NOT_BENT = np.zeros((2, 0, 0))

COLUMNS_AT_ONCE = 512  # columns that are filtered together

FAST = {"contract", "reassoc", "nsz"}


def coefficients(raster: Floats) -> Floats:
    """Return the (rows, columns) coefficients of the spline through a raster's samples, mirrored at its
    borders.
    """
    spline = along_rows(raster)
    filter_columns(spline)
    return spline


def along_rows(raster: Floats) -> Floats:
    """Return (rows, columns) samples along rows as coefficients; rows are independent, so a raster may come in
    parts.
    """
    spline = np.asarray(
        cv2.transpose(np.asarray(raster, dtype=float)), dtype=float
    )  # numpy's takes longer than the filter
    _filter_columns(spline)
    return np.asarray(cv2.transpose(spline), dtype=float)


def filter_columns(spline: Floats | Floats32) -> None:
    """Turn samples along columns into coefficients, in place, computed in double precision."""
    for first in range(0, spline.shape[1], COLUMNS_AT_ONCE):
        some = np.array(spline[:, first : first + COLUMNS_AT_ONCE], dtype=float, order="C")
        _filter_columns(some)
        spline[:, first : first + COLUMNS_AT_ONCE] = some


def read(
    spline: Floats | Floats32,
    onto: Floats,
    shape: tuple[int, int],
    bend: Floats | None = None,
) -> Floats32:
    """Return (rows, columns) of a shape, [i, j] the spline's value at the raster's place `onto` (3, 3) @ (i, j,
    1).

    The value is 0 near and beyond the raster's borders, where the spline lacks six samples.
    spline: from `coefficients`, in either precision. bend: (2, 4, 4) coefficients of
    polynomials in powers of the place's row and column, which are subtracted from the place.
    """
    values = np.zeros(shape, np.float32)
    bent = NOT_BENT if bend is None else np.ascontiguousarray(bend, dtype=float)
    _read(spline, np.ascontiguousarray(onto, dtype=float), bent, values)
    return values


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _read(spline: Floats | Floats32, onto: Floats, bend: Floats, values: Floats32) -> None:
    """Compute places, then weights, then sums, row by row; the compiler vectorises each loop."""
    rows, columns = spline.shape
    many = values.shape[1]
    at_y, at_x = np.empty(many), np.empty(many)
    row, column = np.empty(many, np.int32), np.empty(many, np.int32)
    below = np.empty(many, np.float32)
    right = np.empty(many, np.float32)
    down, across = np.empty((6, many), np.float32), np.empty((6, many), np.float32)
    for i in range(values.shape[0]):
        _place(onto, i, bend, at_y, at_x)
        for j in range(many):
            y, x = at_y[j], at_x[j]
            inside = (y >= 2) & (y < rows - 3) & (x >= 2) & (x < columns - 3)
            whole_y, whole_x = np.floor(y), np.floor(x)
            below[j], right[j] = y - whole_y, x - whole_x
            row[j] = np.int32(whole_y) - 2 if inside else -1
            column[j] = np.int32(whole_x) - 2 if inside else -1
        _weigh(below, down)
        _weigh(right, across)
        for j in range(many):
            top, left = row[j], column[j]
            if top < 0:
                continue
            a = b = c = d = e = f = np.float32(0)
            for k in range(6):
                line, weight = spline[top + k], down[k, j]
                a += weight * line[left]
                b += weight * line[left + 1]
                c += weight * line[left + 2]
                d += weight * line[left + 3]
                e += weight * line[left + 4]
                f += weight * line[left + 5]
            one, two, three = a * across[0, j], b * across[1, j], c * across[2, j]
            values[i, j] = (
                one + two + three + d * across[3, j] + e * across[4, j] + f * across[5, j]
            )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _place(onto: Floats, i: int, bend: Floats, at_y: Floats, at_x: Floats) -> None:
    """Compute the raster's places of a row of values."""
    for j in range(at_y.size):
        w = 1 / (onto[2, 0] * i + onto[2, 1] * j + onto[2, 2])
        at_y[j] = (onto[0, 0] * i + onto[0, 1] * j + onto[0, 2]) * w
        at_x[j] = (onto[1, 0] * i + onto[1, 1] * j + onto[1, 2]) * w
    if bend.size:
        _bend(at_y, at_x, bend)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _bend(at_y: Floats, at_x: Floats, bend: Floats) -> None:
    """Subtract polynomials in the places from the places, by Horner's rule."""
    for j in range(at_y.size):
        y, x = at_y[j], at_x[j]
        down = across = 0.0
        for a in range(BEND_POWERS - 1, -1, -1):
            by_row = by_column = 0.0
            for b in range(BEND_POWERS - 1, -1, -1):
                by_row = by_row * x + bend[0, a, b]
                by_column = by_column * x + bend[1, a, b]
            down = down * y + by_row
            across = across * y + by_column
        at_y[j] -= down
        at_x[j] -= across


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _weigh(places: Floats32, weights: Floats32) -> None:
    """Compute weights (6, n) of the six samples around each of n places (0..1) past the third: the quintic
    B-spline.
    """
    one = np.float32(1)
    two = np.float32(2)
    half = np.float32(1 / 2)
    quarter = np.float32(1 / 4)
    least = np.float32(1 / 120)
    slope = np.float32(1 / 24)
    middle = np.float32(11 / 20)
    last = np.float32(1 / 12)
    for j in range(places.size):
        t = places[j]
        s = one - t
        weights[0, j] = least * s**5
        weights[1, j] = least + slope * s * (one + s * (two + s * (two + s * (one - s))))
        weights[2, j] = middle - t**2 * (half - t**2 * (quarter - last * t))
        weights[3, j] = middle - s**2 * (half - s**2 * (quarter - last * s))
        weights[4, j] = least + slope * t * (one + t * (two + t * (two + t * (one - t))))
        weights[5, j] = least * t**5


@njit(cache=True, nogil=True, error_model="numpy")
def _filter_columns(samples: Floats) -> None:
    """Turn samples along axis 0 into coefficients of the spline through them, in place."""
    rows, columns = samples.shape
    for z in POLES:
        first = np.zeros(columns)
        for i in range(min(rows, POLE_REACH)):
            first += z**i * samples[i]
        samples *= (1 - z) * (1 - 1 / z)
        samples[0] = first * ((1 - z) * (1 - 1 / z))
        for i in range(1, rows):
            for j in range(columns):
                samples[i, j] += z * samples[i - 1, j]
        for j in range(columns):
            samples[rows - 1, j] = (
                z / (z**2 - 1) * (samples[rows - 1, j] + z * samples[rows - 2, j])
            )
        for i in range(rows - 2, -1, -1):
            for j in range(columns):
                samples[i, j] = z * (samples[i + 1, j] - samples[i, j])
