"""ArUco marks between the targets of a grid: each names its place in the grid, and its direction.

The marks are of OpenCV's dictionary of 4 × 4 bits (Garrido-Jurado et al., Pattern Recognition 47, 2280 (2014)) with a rim of
one module. On a dark surround they are inverted: rim light, bits exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from labkit.types import Bools, Floats

MARK_MODULES = 6
"""Modules along a side of a mark: four bits and the rim."""

MOST_MARKS = 1000
"""Number of marks in the dictionary."""

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read a square of modules: a mark's number, its quarter turns to the left, and whether it is mirrored."""

    number: int
    turns: int
    mirrored: bool


def mark_cells(number: int, *, on_dark: bool) -> Floats:
    """Return the modules (6, 6) of a mark: 1 is light, 0 dark."""
    drawn = DICTIONARY.generateImageMarker(number, MARK_MODULES, borderBits=1) > 0
    return np.asarray(drawn != on_dark, dtype=np.float64)


def read_marks(light: Bools, *, on_dark: bool) -> list[Reading]:
    """Return how a square of modules (6, 6) can be read, as a mark and as one in a mirror; empty if it is none."""
    bits = light != on_dark
    if bits[[0, -1]].any() or bits[:, [0, -1]].any():
        return []
    readings = []
    for mirrored in (False, True):
        inner = bits[1:-1, ::-1][:, 1:-1] if mirrored else bits[1:-1, 1:-1]
        known, number, turns = DICTIONARY.identify(
            np.ascontiguousarray(inner, dtype=np.uint8), 0.0
        )
        if known:
            readings.append(Reading(int(number), int(turns), mirrored))
    return readings
