"""Grids of carpets as a camera sees them, drawn without labkit: cells by Kronecker products, warped by OpenCV."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from scipy import ndimage

from labkit.types import Floats

FINE = 4
"""Samples along a side of a pixel."""

Place = tuple[int, int]


def kron_carpet(order: int) -> Floats:
    """The cells of a carpet: a removed middle is white, all others are the next smaller carpet."""
    ring, middle = np.ones((3, 3)), np.zeros((3, 3))
    ring[1, 1], middle[1, 1] = 0.0, 1.0
    carpet = np.zeros((1, 1))
    for _ in range(order):
        carpet = np.kron(ring, carpet) + np.kron(middle, np.ones_like(carpet))
    return carpet


def kron_sheet(
    grid: Place, *, order: int = 3, gap: int = 14, without: Iterable[Place] = ()
) -> Floats:
    """Carpets of 3**order cells, `gap` black cells apart and around, some left out."""
    side = 3**order
    rows, cols = (count * (side + gap) + gap for count in grid)
    sheet = np.zeros((rows, cols))
    for row, col in np.ndindex(*grid):
        if (row, col) not in without:
            top, left = gap + row * (side + gap), gap + col * (side + gap)
            sheet[top : top + side, left : left + side] = kron_carpet(order)
    return sheet


def mark_sheet(grid: Place, *, side: int = 27, gap: int = 14, module: int = 1) -> Floats:
    """OpenCV's marks 0, 1, ... row by row in the middle of each four carpets, in exchanged colours, black elsewhere."""
    sheet = np.zeros([count * (side + gap) + gap for count in grid])
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    rows, cols = (max(1, count - 1) for count in grid)
    for number in range(rows * cols):
        mark = 255 - known.generateImageMarker(number, 6, borderBits=1)
        drawn = np.kron(mark / 255.0, np.ones((module, module)))
        top, left = (
            round(
                (index + 1) * (side + gap) + gap / 2 - len(drawn) / 2
                if count > 1
                else gap + side / 2 - len(drawn) / 2
            )
            for index, count in zip(divmod(number, cols), grid, strict=True)
        )
        sheet[top : top + len(drawn), left : left + len(drawn)] = drawn
    return sheet


def camera(
    shape: Place,
    scale: float,
    *,
    roll_deg: float = 0.0,
    tilt: Place | tuple[float, float] = (0.0, 0.0),
    shift_px: tuple[float, float] = (0.0, 0.0),
    sheet: tuple[int, ...] = (0, 0),
) -> Floats:
    """The 3×3 map of (x, y) in a sheet's cells to pixels.

    scale: pixels a cell; tilt: relative change of the size from the sheet's middle to its end, along rows and columns;
    shift_px: of the sheet's middle from the picture's (row, column).
    """
    turn = np.deg2rad(roll_deg)
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    middle = np.array([sheet[1], sheet[0]]) / 2 - 0.5
    centre = np.array([shape[1], shape[0]]) / 2 - 0.5 + np.array(shift_px)[::-1]
    to_middle = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1.0]])
    seen = np.array(
        [[c, -s, 0], [s, c, 0], [tilt[1] / middle[0], tilt[0] / middle[1], 1.0]]
    )
    to_picture = np.array([[1, 0, centre[0]], [0, 1, centre[1]], [0, 0, 1.0]])
    return np.asarray(to_picture @ seen @ to_middle)


def picture(
    sheet: Floats, view: Floats, shape: Place, *, blur_px: float = 1.0, noise: float = 0.01
) -> Floats:
    """What the camera of a `view` sees of a sheet's cells: averaged over pixels, blurred, noisy."""
    finer = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    warped = cv2.warpPerspective(
        sheet, finer @ view, (shape[1] * FINE, shape[0] * FINE), flags=cv2.INTER_NEAREST
    )
    means = warped.reshape(shape[0], FINE, shape[1], FINE).mean(axis=(1, 3))
    blurred = ndimage.gaussian_filter(means, blur_px)
    rng = np.random.default_rng(31)
    return np.asarray(blurred + noise * rng.standard_normal(shape))


def corners_px(place: Place, view: Floats, *, side: int = 27, gap: int = 14) -> Floats:
    """True corners (row, column) of a carpet in the picture, in the order of labkit's."""
    top, left = (gap + index * (side + gap) - 0.5 for index in place)
    corners = np.array(
        [
            [left, top],
            [left + side, top],
            [left + side, top + side],
            [left, top + side],
        ]
    )
    return np.asarray(cv2.perspectiveTransform(corners[None], view)[0][:, ::-1])
