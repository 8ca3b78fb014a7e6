"""Second derivatives of a PSF, against Taylor's remainder, finite differences and the Strehl ratio."""

import numpy as np
import pytest

from labkit.experiments.methods.psf_hessian import psf_hessian
from labkit.optics.psf import Pupil

MODES = tuple(range(4, 16))


def test_a_psf_leaves_a_remainder_of_third_order_after_its_first_two_derivatives() -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 1.0, 96, (2, *MODES))
    rng = np.random.default_rng(2)
    waves = rng.normal(0, 0.1, 13)
    way = rng.normal(size=13)
    psf, slopes = pupil.psf_jacobian(waves)
    bend = sum(
        ((1 if i == j else 2) * way[i] * way[j]) * second
        for i, j, second in psf_hessian(pupil, waves)
    )

    def remainder(h: float) -> float:
        series = psf + h * np.tensordot(way, slopes, 1) + h**2 / 2 * bend
        return float(np.abs(pupil.psf(waves + h * way) - series).max())

    # half the step leaves an eighth, but for the fourth order
    assert remainder(4e-4) / remainder(2e-4) == pytest.approx(8, rel=0.02)


def test_each_second_derivative_of_a_psf_is_the_slope_of_a_slope() -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 1.0, 64, (4, 5, 8))
    waves = np.array([0.2, -0.1, 0.05])
    seconds = {(i, j): second for i, j, second in psf_hessian(pupil, waves)}
    assert list(seconds) == [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    for (i, j), second in seconds.items():
        step = 1e-4 * np.eye(3)[j]
        difference = (
            pupil.psf_jacobian(waves + step)[1][i] - pupil.psf_jacobian(waves - step)[1][i]
        ) / 2e-4
        # of the fourth derivative a share of (2 pi 1e-4 Z)^2 / 6, Z up to 3 at the rim
        assert np.abs(second - difference).max() < 2e-6 * np.abs(second).max()


def test_without_wavefront_the_psfs_curvature_in_defocus_is_the_strehl_ratios() -> None:
    pupil = Pupil(0.45, 0.45, 4.0, 0.72, 600, (4,))
    _, _, second = next(psf_hessian(pupil, np.zeros(1)))
    centre = (300, 300)
    # sinc(sqrt(12) a)^2 = 1 - (2 pi)^2 a^2 + ...; a pupil 240 samples across counts its rim to 1e-3
    assert second[centre] / pupil.psf(np.zeros(1))[centre] == pytest.approx(
        -2 * (2 * np.pi) ** 2, rel=2e-3
    )
