"""Pictures for setting a bench up: even greys, an aid to focus by, marks to align by. Grey values of a whole panel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.devices.protocols import PanelInfo

Grey = NDArray[np.uint8]

PATTERNS = ("white", "black", "grey", "focus", "alignment")

SECTORS = 72
LINE_WIDTHS_PX = (1, 2, 3, 4, 6, 8)
TICKS_MM = ((10, 40), (5, 26), (1, 14))
"""A ruler's ticks: every so many mm, so many pixels long."""


def pattern(name: str, panel: PanelInfo) -> Grey:
    """Return one of PATTERNS, (height, width) of the panel. Raises ValueError for another name."""
    match name:
        case "white":
            return np.full(panel.pixels, 255, dtype=np.uint8)
        case "black":
            return np.zeros(panel.pixels, dtype=np.uint8)
        case "grey":
            # half the light of white
            return np.full(
                panel.pixels, round(255 * 0.5 ** (1 / panel.gamma)), dtype=np.uint8
            )
        case "focus":
            return _focus(panel)
        case "alignment":
            return _alignment(panel)
    raise ValueError(f"no pattern is called {name!r}; there are {', '.join(PATTERNS)}")


def _focus(panel: PanelInfo) -> Grey:
    """Return a star of black and white sectors, surrounded by patches of upright and lying lines 1 to 8 pixels wide."""
    rows, cols = panel.pixels
    y, x = (
        np.mgrid[:rows, :cols] - np.array([(rows - 1) / 2, (cols - 1) / 2])[:, None, None]
    )
    sector = np.floor(np.arctan2(y, x) * SECTORS / (2 * np.pi)).astype(int)
    picture = np.where(
        (sector % 2 == 0) & (np.hypot(y, x) < 0.3 * min(rows, cols)), 255, 0
    ).astype(np.uint8)
    side = min(rows, cols) // 8
    pitch = min(cols // len(LINE_WIDTHS_PX), side * 2)
    for i, width in enumerate(LINE_WIDTHS_PX):
        left = (
            cols // 2 + round((i - len(LINE_WIDTHS_PX) / 2) * pitch) + (pitch - side) // 2
        )
        lines = (np.arange(side) // width % 2 == 0).astype(np.uint8) * 255
        picture[side // 4 : side // 4 + side, left : left + side] = lines[None, :]
        picture[rows - side // 4 - side : rows - side // 4, left : left + side] = lines[
            :, None
        ]
    return picture


def _alignment(panel: PanelInfo) -> Grey:
    """Return lit outermost pixels, a cross with millimetre ticks in the middle, and ArUco marks 0 to 3 in the corners.

    The marks are of OpenCV's DICT_4X4_50, in the order top left, top right, bottom right,
    bottom left.
    """
    rows, cols = panel.pixels
    picture = np.zeros(panel.pixels, dtype=np.uint8)
    picture[[0, -1], :] = picture[:, [0, -1]] = 255
    picture[(rows - 1) // 2 : rows // 2 + 1, :] = picture[
        :, (cols - 1) // 2 : cols // 2 + 1
    ] = 255
    for every_mm, length in TICKS_MM:
        for axis, view in ((0, picture), (1, picture.T)):
            middle = view.shape[0] / 2
            across = view.shape[1] // 2
            reach = int(middle * panel.pitch_mm / every_mm)
            for at in middle + np.arange(-reach, reach + 1) * every_mm / panel.pitch_mm:
                if 0 <= at < panel.pixels[axis]:
                    view[int(at), across - length : across + length] = 255
    _mark_corners(picture)
    return picture


def _mark_corners(picture: Grey) -> None:
    side = (
        min(picture.shape) // 8 // 8 * 8
    )  # whole pixels for the 6 cells of a mark and a white cell around
    if side == 0:
        return
    margin = side // 2
    cell = side // 8
    marks = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    places = (
        (margin, margin),
        (margin, -margin - side),
        (-margin - side, -margin - side),
        (-margin - side, margin),
    )
    for number, (top, left) in enumerate(places):
        place = picture[top:, left:][:side, :side]
        place[:] = 255
        place[cell:-cell, cell:-cell] = cv2.aruco.generateImageMarker(
            marks, number, 6 * cell
        )
