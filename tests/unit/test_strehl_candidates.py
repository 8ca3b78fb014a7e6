"""Perturbations that change a PSF least: against SciPy's own climbs, finite differences and the rotation of a pupil."""

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, approx_fprime, minimize

from labkit.experiments.methods.strehl_candidates import (
    CANDIDATE_NOLL,
    is_trivial,
    rotated,
    shipped_perturbations,
    strehl,
    strehl_candidates,
)
from labkit.optics.psf import Pupil
from labkit.optics.zernike import zernike
from labkit.types import Floats

WAVES = np.random.default_rng(2).normal(scale=0.05, size=12)


def lowered(waves: Floats) -> float:
    return -strehl(waves)[0]


def test_the_strehl_ratio_is_the_peak_of_the_psf() -> None:
    pupil = Pupil(0.55, 0.55, 8.0, 1.0, 1200, CANDIDATE_NOLL)
    ratio = pupil.psf(WAVES)[600, 600] / pupil.psf(0 * WAVES)[600, 600]
    assert strehl(WAVES)[0] == pytest.approx(ratio, abs=1.5e-9)
    # small wavefronts have 1 - (2 pi rms)^2
    assert strehl(0.05 * WAVES)[0] == pytest.approx(
        1 - (2 * np.pi * 0.05) ** 2 * WAVES @ WAVES, abs=1e-5
    )


def test_its_gradient_is_a_finite_difference() -> None:
    slope = approx_fprime(WAVES, lowered, 1e-7)
    np.testing.assert_allclose(strehl(WAVES)[1], -slope, atol=1e-5)


def test_rotation_turns_the_modes() -> None:
    rho, theta = np.array([0.3, 0.7, 0.9]), np.array([0.1, 2.0, -1.3])
    turned = sum(
        w * zernike(j, rho, theta - 0.4) for w, j in zip(WAVES, CANDIDATE_NOLL, strict=True)
    )
    same = sum(
        w * zernike(j, rho, theta)
        for w, j in zip(rotated(WAVES, 0.4), CANDIDATE_NOLL, strict=True)
    )
    np.testing.assert_allclose(turned, same, atol=1e-12)


def test_shipped_ones_are_maxima_of_their_shells_and_not_each_other() -> None:
    shells, found = shipped_perturbations()
    assert set(np.round(shells, 2)) == set(np.round(np.arange(0.02, 0.201, 0.02), 2))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), shells, rtol=1e-6)
    for rms, waves in zip(shells, found, strict=True):
        on_shell = NonlinearConstraint(lambda w: w @ w, rms**2, rms**2)
        best = minimize(lowered, waves, constraints=[on_shell], method="SLSQP")
        assert -best.fun == pytest.approx(strehl(waves)[0], abs=1e-5)
    for k, one in enumerate(found):
        same_shell = [
            o for s, o in zip(shells[:k], found[:k], strict=True) if s == shells[k]
        ]
        assert not any(is_trivial(one, other, 0.1 * shells[k]) for other in same_shell)


def test_they_beat_other_directions_by_far() -> None:
    shells, found = shipped_perturbations()
    rng = np.random.default_rng(3)
    random = rng.normal(size=(300, 12))
    at_random = max(strehl(0.2 * w / np.linalg.norm(w))[0] for w in random)
    assert strehl(found[np.isclose(shells, 0.2)][0])[0] > at_random


def test_candidates_lie_on_the_shell_around_a_wavefront() -> None:
    around = strehl_candidates(WAVES)
    np.testing.assert_allclose(np.linalg.norm(around - WAVES, axis=1), 0.2, rtol=1e-6)
    with pytest.raises(ValueError, match=r"waves has shape \(3,\); \(12,\) is needed"):
        strehl_candidates(np.zeros(3))


def test_a_psf_changes_less_along_them_than_along_others() -> None:
    pupil = Pupil(0.55, 0.55, 8.0, 1.0, 256, CANDIDATE_NOLL)
    rng = np.random.default_rng(4)
    waves, others = rng.normal(size=12), rng.normal(size=(100, 12))
    waves *= 0.25 / np.linalg.norm(waves)
    others *= 0.2 / np.linalg.norm(others, axis=1, keepdims=True)
    psf = pupil.psf(waves)

    def change(around: Floats) -> float:
        return float(np.median([np.abs(pupil.psf(w) - psf).max() for w in around]))

    assert change(strehl_candidates(waves)) < 0.9 * change(waves + others)
