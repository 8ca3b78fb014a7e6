"""The one sharpness number, against the closed form of a blurred edge. Blur circles: tests/system/test_preflight.py."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from labkit.finder.sharpness import sharpest_edge_px
from labkit.photographs.photograph import Photograph

BAYER, MONO = ("RG", "GB"), ("M",)


def square(
    sigma_px: float,
    pattern: tuple[str, ...],
    side: int = 200,
    noise: float = 40,
    white: float = 8000,
) -> Photograph:
    """A white square beside the middle of a large dark frame, its edges blurred by a Gaussian."""
    light = np.zeros((1200, 1800))
    light[300 : 300 + side, 1100 : 1100 + side] = white
    light = ndimage.gaussian_filter(light, sigma_px) if sigma_px else light
    counts: NDArray[np.float64] = (
        light + 512 + np.random.default_rng(3).normal(0, noise, light.shape)
    )
    return Photograph(
        counts.clip(0).astype(np.uint16), np.full((2, 2), 512.0), 16000, pattern
    )


@pytest.mark.parametrize("pattern", [BAYER, MONO])
@pytest.mark.parametrize("sigma_px", [3.0, 6.0])
@pytest.mark.parametrize("side", [100, 600])
def test_a_blurred_edge_rises_over_its_closed_form(
    side: int, sigma_px: float, pattern: tuple[str, ...]
) -> None:
    # a Gaussian edge's contrast over its slope is sigma √(2 π); own filters (0.7 pixels, Sobel's 0.7, the colour's 0.7)
    # widen it by up to 8 % at 3 pixels, noise steepens the steepest of many slopes
    assert sharpest_edge_px(square(sigma_px, pattern, side)) == pytest.approx(
        sigma_px * np.sqrt(2 * np.pi), rel=0.1
    )


def test_what_the_docstring_says_of_the_best() -> None:
    assert sharpest_edge_px(square(0, MONO)) == pytest.approx(2.6, abs=0.05)
    assert sharpest_edge_px(square(0, BAYER)) == pytest.approx(3.2, abs=0.05)


def test_exposure_does_not_count() -> None:
    bright, dim = (
        sharpest_edge_px(square(2, BAYER, white=white, noise=0)) for white in (8000, 2000)
    )
    assert dim == pytest.approx(bright, rel=0.01)


def test_a_flat_has_no_edge() -> None:
    flat = Photograph(
        np.full((400, 600), 9000, np.uint16), np.full((2, 2), 512.0), 16000, BAYER
    )
    assert sharpest_edge_px(flat) is None


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (40, 3)])
def test_a_tiny_photograph_is_no_trouble(shape: tuple[int, int]) -> None:
    counts = np.random.default_rng(1).integers(600, 9000, shape).astype(np.uint16)
    sharpness = sharpest_edge_px(Photograph(counts, np.full((2, 2), 512.0), 16000, BAYER))
    assert sharpness is None or sharpness > 0
