"""Photon transfer against simulated electrons: estimates err by their own standard errors."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.calibration.photon_transfer import (
    NoiseEstimate,
    Scatter,
    photon_transfer,
    scatter_of,
)
from labkit.types import Floats

GAIN, READ_NOISE = 0.45, 1.1


def expose(
    mean_e: Floats, frames: int, rng: np.random.Generator, brightness: float = 0.0
) -> Floats:
    """(frames, m) whole counts: Poisson electrons, Gaussian read noise, black level 100 taken off again."""
    light = 1 + brightness * rng.standard_normal((frames, 1))
    counts = GAIN * rng.poisson(mean_e * light) + READ_NOISE * rng.standard_normal(
        (frames, mean_e.size)
    )
    return np.rint(counts + 100) - 100


def flats_and_darks(
    rng: np.random.Generator, frames: int = 2
) -> tuple[list[Scatter], list[Scatter]]:
    pattern = 1 + 0.01 * rng.standard_normal(
        3000
    )  # fixed response, which must not count as noise
    lit = [
        scatter_of(expose(level * pattern, frames, rng, 0.01), lit=True)
        for level in (2000.0, 8000.0, 20000.0)
    ]
    return lit, [scatter_of(expose(np.zeros(3000), frames, rng), lit=False)]


def z_scores(trials: int, frames: int, with_darks: bool = True) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(5)
    gains, noises = [], []
    for _ in range(trials):
        lit, dark = flats_and_darks(rng, frames)
        found = photon_transfer(lit, dark if with_darks else ())
        assert found.gain is not None
        assert found.gain_std is not None
        gains.append((found.gain - GAIN) / found.gain_std)
        if found.read_noise is not None and found.read_noise_std is not None:
            noises.append((found.read_noise - READ_NOISE) / found.read_noise_std)
    return np.array(gains), np.array(noises)


def assert_unit_normal(z: Floats) -> None:
    # four standard errors of the mean and of the standard deviation of so many unit normals
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert abs(z.std() - 1) < 4 / np.sqrt(2 * z.size)


@pytest.mark.slow
@pytest.mark.parametrize("frames", [2, 5])
def test_gain_and_read_noise_err_by_their_standard_errors(frames: int) -> None:
    for z in z_scores(200, frames):
        assert_unit_normal(z)


@pytest.mark.slow
def test_the_gain_errs_by_its_standard_error_without_darks_too() -> None:
    gains, noises = z_scores(150, 2, with_darks=False)
    assert_unit_normal(gains)
    assert noises.size == 0  # bright flats alone do not tell the read noise


def test_flats_of_little_light_tell_the_read_noise_without_darks() -> None:
    rng = np.random.default_rng(6)
    found = photon_transfer(
        [scatter_of(expose(np.full(20000, e), 4, rng), lit=True) for e in (5.0, 20.0, 80.0)]
    )
    assert found.read_noise is not None
    assert found.read_noise_std is not None
    assert abs(found.read_noise - READ_NOISE) < 4 * found.read_noise_std


def test_darks_alone_tell_the_read_noise_and_no_gain() -> None:
    rng = np.random.default_rng(7)
    found = photon_transfer([], [scatter_of(expose(np.zeros(40000), 4, rng), lit=False)])
    assert (found.gain, found.gain_std) == (None, None)
    assert found.read_noise is not None
    assert found.read_noise_std is not None
    assert found.read_noise_std == pytest.approx(
        READ_NOISE / np.sqrt(2 * 3 * 40000), rel=0.1
    )
    assert abs(found.read_noise - READ_NOISE) < 4 * found.read_noise_std


def test_one_level_of_light_tells_the_gain_as_if_there_were_no_read_noise() -> None:
    rng = np.random.default_rng(8)
    found = photon_transfer([scatter_of(expose(np.full(20000, 20000.0), 4, rng), lit=True)])
    assert found.gain == pytest.approx(GAIN, rel=0.03)
    assert found.gain_std == pytest.approx(
        0.03 * GAIN, rel=0.2
    )  # what the prior leaves open


def test_particles_and_telegraph_noise_do_not_move_the_estimate() -> None:
    rng = np.random.default_rng(9)
    lit, dark = flats_and_darks(rng, 4)
    clean = photon_transfer(lit, dark)
    for group in (*lit, *dark):
        np.multiply(
            group.variance,
            1e4,
            out=group.variance,
            where=rng.random(group.variance.size) < 1e-3,
        )
    spoilt = photon_transfer(lit, dark)
    assert clean.gain is not None
    assert clean.read_noise is not None
    assert spoilt.gain == pytest.approx(clean.gain, rel=5e-3)
    assert spoilt.read_noise == pytest.approx(clean.read_noise, rel=2e-2)


def test_nothing_is_known_from_nothing() -> None:
    assert photon_transfer([]) == NoiseEstimate(None, None, None, None)
    with pytest.raises(ValueError, match="two frames or more"):
        scatter_of(np.zeros((1, 5)), lit=True)
