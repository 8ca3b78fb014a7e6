"""What is left of the data by frequency: noise is flat, what repeats stands where it repeats."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.estimation.likelihood import Detector, FrameData
from labkit.estimation.residuals import (
    RADIAL_BINS,
    residual_frequencies,
    residual_spectrum,
)
from labkit.types import Bools, Floats

SHAPE = (96, 120)
DETECTOR = Detector(scale=1000.0, ambient=20.0, gain=0.5, read_variance=9.0)
RELATIVE = np.full(SHAPE, 0.7)


def frame(used: Bools, rest: Floats) -> FrameData:
    """Counts whose residuals are some standard deviations."""
    mean = 1000 * RELATIVE + 20
    one = np.ones(SHAPE)
    return FrameData(mean + rest * np.sqrt(0.5 * mean + 9), used, one, 0 * one)


def spectrum(used: Bools, *rest: Floats) -> Floats:
    frames = [frame(used, each) for each in rest]
    return residual_spectrum(frames, [RELATIVE[used]] * len(rest), [DETECTOR] * len(rest))


def test_noise_leaves_the_same_at_all_frequencies() -> None:
    rng = np.random.default_rng(1)
    power = spectrum(np.ones(SHAPE, bool), *rng.normal(size=(4, *SHAPE)))
    assert np.mean(power) == pytest.approx(1, abs=0.02)
    assert np.abs(power - 1).max() < 0.12


def test_a_wave_stands_at_its_frequency() -> None:
    used = np.ones(SHAPE, bool)
    rows, columns = np.indices(SHAPE)
    power = spectrum(used, np.cos(2 * np.pi * (0.175 * columns + 0.125 * rows)))
    frequencies = residual_frequencies([frame(used, 0 * RELATIVE)])
    assert frequencies[np.argmax(power)] == pytest.approx(
        np.hypot(0.175, 0.125), abs=0.5 / RADIAL_BINS / 2
    )
    assert np.delete(power, np.argmax(power)).max() < 0.01 * power.max()


def test_a_bayer_plane_is_flat_up_to_its_own_nyquist_frequency() -> None:
    used = np.zeros(SHAPE, bool)
    used[::2, 1::2] = True
    rng = np.random.default_rng(2)
    power = spectrum(used, *rng.normal(size=(8, *SHAPE)))
    assert residual_frequencies([frame(used, 0 * RELATIVE)])[-1] == pytest.approx(
        0.25 * (1 - 0.5 / RADIAL_BINS)
    )
    assert np.abs(power - 1).max() < 0.2
