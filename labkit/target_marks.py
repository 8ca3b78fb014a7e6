"""ArUco marks between the targets of a grid: each names its place in the grid, and its direction.

The marks are of OpenCV's dictionary of 4 × 4 bits (Garrido-Jurado et al., Pattern Recognition 47, 2280 (2014)) with a rim of
one module. On a dark surround they are inverted: rim light, bits exchanged.
"""

from __future__ import annotations

import cv2
import numpy as np

from labkit.types import Floats

MARK_MODULES = 6
"""Modules along a side of a mark: four bits and the rim."""

MOST_MARKS = 1000
"""Number of marks in the dictionary."""

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)


def mark_cells(number: int, *, on_dark: bool) -> Floats:
    """Return the modules (6, 6) of a mark: 1 is light, 0 dark."""
    drawn = DICTIONARY.generateImageMarker(number, MARK_MODULES, borderBits=1) > 0
    return np.asarray(drawn != on_dark, dtype=np.float64)
