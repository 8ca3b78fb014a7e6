"""The window that a PSF needs, against what such PSFs leave beyond it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal.windows

from labkit.imaging.window import (
    FADING,
    STRAYED,
    WIDEST_WINDOW,
    fading,
    rim_rays_airy,
    window_for,
)
from labkit.optics.psf import Pupil
from labkit.types import Floats

SAMPLES = 2.02  # of lambda N


def random_wavefront(seed: int) -> tuple[tuple[int, ...], Floats]:
    """Of 11 to 24 modes above defocus, 0.2 to 0.6 waves in them and up to 1.5 of defocus."""
    rng = np.random.default_rng(seed)
    noll = tuple(range(4, rng.choice([16, 23, 29])))
    waves = rng.normal(size=len(noll))
    waves *= rng.uniform(0.2, 0.6) / np.linalg.norm(waves)
    waves[0] = rng.uniform(-1.5, 1.5)
    return noll, waves


@pytest.mark.parametrize("seed", range(8))
def test_beyond_the_window_is_as_much_light_as_it_says(seed: int) -> None:
    noll, waves = random_wavefront(seed)
    pupil = Pupil(0.5, 0.5, 4.0, 0.5 * 4 / SAMPLES, 1000, noll)
    departure = pupil.psf(waves) - pupil.psf(np.zeros(len(noll)))
    away = np.abs(np.arange(-500, 500)) / SAMPLES
    beyond = departure[np.maximum(away[:, None], away) > window_for(noll, waves) / 2].sum()
    assert 0.5 * STRAYED < beyond < 1.4 * STRAYED


def test_rays_from_the_rim_of_a_defocused_lens_arrive_on_the_geometric_disc() -> None:
    # defocus of W waves RMS is sqrt(3) W (2 rho^2 - 1): slope 4 sqrt(3) W at the rim, and rays go twice as far in lambda N
    np.testing.assert_allclose(
        rim_rays_airy((4, 11), np.array([0.7, 0.0])), 8 * np.sqrt(3) * 0.7, rtol=1e-4
    )


def test_no_window_is_wider_than_memory_allows() -> None:
    assert window_for((4,), np.array([50.0])) == WIDEST_WINDOW


@pytest.mark.parametrize("size", [48, 121])
def test_a_window_fades_out_as_tukeys(size: int) -> None:
    np.testing.assert_allclose(
        fading(size), scipy.signal.windows.tukey(size, FADING), atol=1e-15
    )
