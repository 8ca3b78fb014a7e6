"""Find a single target by the ArUco marks beyond its corners, in copies of a photograph from coarse to fine."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from labkit.finder.picture import Picture, normalised
from labkit.finder.registration import OWN_CORNERS, homography, mapped, mean_side
from labkit.target.grid import DICTIONARY, TargetGrid
from labkit.types import Floats

COARSEST_PX, MOST_OF_A_COPY = 750, 30e6
"""Longest side of the smallest copy, and size of the largest one, in which a search takes half a second. None is finer than the
photograph."""

LEAST_MARK_PX = 10
"""Side of the smallest mark looked for, in samples of a copy."""

WRONG_BITS = 2
"""Bits of 16 that may be misread: the four marks differ in 5, and registration verifies each place."""

SAMPLES_OF_A_MODULE, BLURRED_SHARE = 8, 0.3
"""Samples across a module from which a mark is read, and the share on each side that counts for nothing. Of 120 marked carpets
in drawn rooms, with blurs of 0.1 to 0.6 modules, 118 are found; with OpenCV's usual 4 and 0.13, 115."""

SAME_MIDDLE = 0.1
"""Largest distance of the places that the marks of one target predict, in sides of the target."""


def marks_px(marked: TargetGrid, corners: Floats) -> Floats:
    """Return the corners (marks, 4, 2) in pixels of the marks of a target at corners (4, 2)."""
    by = homography(OWN_CORNERS * marked.tile.size_mm, corners)
    return np.stack([mapped(by, at_mm) for at_mm in _marks_mm(marked)])


def _marks_mm(marked: TargetGrid) -> Floats:
    """Return the corners (marks, 4, 2) of the marks on the plane of the target, from its middle."""
    return marked.mark_centres_mm()[:, None] + OWN_CORNERS * marked.mark_mm


def places_by_marks(picture: Picture, marked: TargetGrid) -> Iterator[list[Floats]]:
    """Yield likely corners (4, 2) of a target by its marks, copy by copy of a photograph.

    Parameters
    ----------
    picture : the photograph
    marked : the target, alone, with marks
    """
    finest = min(
        1.0, 2.0 ** np.floor(0.5 * np.log2(MOST_OF_A_COPY / np.prod(picture.shape)))
    )
    halvings = max(0, round(np.log2(finest * max(picture.shape) / COARSEST_PX)))
    for halving in range(halvings, -1, -1):
        yield _places(picture, marked, finest / 2.0**halving)


def _places(picture: Picture, marked: TargetGrid, scale: float) -> list[Floats]:
    """Return likely corners of the target in pixels of the photograph, those that most marks agree on first."""
    own_mm = OWN_CORNERS * marked.tile.size_mm
    marks_mm = _marks_mm(marked)
    groups: list[tuple[Floats, list[Floats], list[Floats]]] = []
    for number, seen in _marks(picture, marked, scale):
        at_mm = marks_mm[number]
        place = mapped(_through(at_mm, seen), own_mm)
        for middle, all_mm, all_seen in groups:
            away = np.linalg.norm(place.mean(axis=0) - middle)
            if away < SAME_MIDDLE * mean_side(place):
                all_mm.append(at_mm)
                all_seen.append(seen)
                break
        else:
            groups.append((place.mean(axis=0), [at_mm], [seen]))
    groups.sort(key=lambda group: -len(group[1]))
    return [
        mapped(_through(np.concatenate(mm), np.concatenate(px)), own_mm)
        for _, mm, px in groups
    ]


def _through(points: Floats, at: Floats) -> Floats:
    """Return the map of (x, y), see `homography`, that carries corners of marks (n, 2) to places (n, 2), by least squares.

    It is affine for a single mark, which says little of the perspective.
    """
    if len(points) == len(OWN_CORNERS):
        x_y = np.column_stack((points[:, ::-1], np.ones(len(points))))
        return np.vstack((np.linalg.lstsq(x_y, at[:, ::-1])[0].T, (0.0, 0.0, 1.0)))
    return np.asarray(cv2.findHomography(points[:, ::-1], at[:, ::-1])[0], dtype=np.float64)


def _marks(
    picture: Picture, marked: TargetGrid, scale: float
) -> Iterator[tuple[int, Floats]]:
    """Yield the number of each mark read in a copy, and its corners (4, 2) in pixels of the photograph."""
    copy = picture.scaled(scale)
    # the root makes a dark display beside a bright window stand out
    grey = np.rint(255 * np.sqrt(np.clip(normalised(copy, copy), 0, 1))).astype(np.uint8)
    parameters = cv2.aruco.DetectorParameters()
    parameters.perspectiveRemovePixelPerCell = SAMPLES_OF_A_MODULE
    parameters.perspectiveRemoveIgnoredMarginPerCell = BLURRED_SHARE
    parameters.errorCorrectionRate = 1.0
    parameters.minMarkerPerimeterRate = 4 * LEAST_MARK_PX / max(copy.shape)
    own = cv2.aruco.Dictionary(
        DICTIONARY.bytesList[list(marked.mark_numbers)], DICTIONARY.markerSize, WRONG_BITS
    )
    detector = cv2.aruco.ArucoDetector(own, parameters)
    quads, numbers, _ = detector.detectMarkers(grey if marked.surround else 255 - grey)
    per_sample = np.array(picture.shape) / copy.shape
    for number, quad in zip([] if numbers is None else numbers.ravel(), quads, strict=True):
        yield int(number), (quad[0][:, ::-1] + 0.5) * per_sample - 0.5
