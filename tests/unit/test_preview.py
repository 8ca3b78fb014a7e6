"""Previews of photographs: what they show, and that they make no copy of a whole frame."""

from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.drivers.web.preview import summarise
from labkit.finder.preview import RED, Look, jpeg
from labkit.photographs.photograph import Photograph

CYAN_LIGHT = 200


def photograph(counts: NDArray[np.uint16]) -> Photograph:
    return Photograph(counts, np.full((2, 2), 100.0), 10100.0, ("RG", "GB"))


def test_a_large_frame_shows_light_lone_clipped_pixels_and_outline() -> None:
    # 10 pixels to a square of the preview's source: the frame is no multiple of it
    counts = np.full((4000, 10011), 2600, np.uint16)
    counts[2000:2200:20, 3000:3200:20] = 10100
    corners = np.array([[[3000.0, 8000], [3000, 9500], [3800, 9500], [3800, 8000]]])
    picture = cv2.imdecode(
        np.frombuffer(jpeg(photograph(counts), corners), np.uint8), cv2.IMREAD_COLOR
    )
    assert picture is not None
    scale = 10011 / 900
    assert picture.shape[:2] == (round(4000 / scale), 900)
    assert picture[20, 20] == pytest.approx(255 * 0.25 ** (1 / 2.2), abs=2)
    red = picture[round(2100 / scale), round(3100 / scale)].astype(int)
    assert red[2] - red[0] > 0.5 * (RED[2] - RED[0])
    # the outline's dark border is four pixels wide
    column = np.argmax(picture[round(3400 / scale), 600:].min(axis=1) < CYAN_LIGHT - 100)
    assert column + 600 == pytest.approx(8000 / scale, abs=4)


def test_a_preview_makes_no_copy_of_a_frame() -> None:
    frame = photograph(np.full((4000, 6000), 500, np.uint16))
    tracemalloc.start()
    summarise(1, Look("frame 1", None, frame))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # 24 MB of clipped pixels, one byte each, and their parts; measured 35 MB, of 48 MB of counts
    assert peak < 48e6
