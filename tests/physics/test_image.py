"""A photograph in memory, which labkit's model did not form."""

from __future__ import annotations

import numpy as np
import pytest

import labkit
from labkit.errors import DataError
from labkit.types import Floats

from .brute_force import CARPET, CORNERS, FRAME, OPTICS, WAVES, brute_force_mean

GAIN, READ_NOISE, SCALE, AMBIENT = 0.25, 2.0, 1500.0, 40.0


@pytest.fixture(scope="module")
def counts() -> Floats:
    mean = SCALE * brute_force_mean() + AMBIENT
    return np.random.default_rng(1).normal(mean, np.sqrt(GAIN * mean + READ_NOISE**2))


def test_a_photograph_in_memory_gives_its_wavefront(counts: Floats) -> None:
    w = labkit.fit_image(
        counts, CARPET, OPTICS, corners_px=CORNERS + 0.4, gain=GAIN, read_noise=READ_NOISE
    )
    assert np.all(np.abs(w.waves - WAVES) < 4 * w.std)
    assert w.f_number == pytest.approx(OPTICS.f_number, rel=1e-6)
    assert w.test is not None
    assert w.test.accepted
    assert (w.channel, w.range_mm) == ("M", None)
    # the frame is cut around the target; corners come in pixels of the photograph
    assert w.placement is not None
    assert np.abs(w.placement.corners_px[0] - CORNERS).max() < 0.05


def test_pixels_of_other_colours_and_masked_ones_do_not_count(counts: Floats) -> None:
    rows, columns = np.indices(FRAME)
    green = (rows + columns) % 2 == 1
    spoilt = np.where(green, counts, 0.0)
    spoilt[20:22] = 1e4
    mask = np.ones(FRAME, bool)
    mask[20:22] = False
    w = labkit.fit_image(
        spoilt,
        CARPET,
        OPTICS,
        cfa_pattern="RGGB",
        channel="G",
        mask=mask,
        corners_px=CORNERS,
        gain=GAIN,
    )
    assert np.all(np.abs(w.waves - WAVES) < 4 * w.std)


def test_several_photographs_are_fitted_together(counts: Floats) -> None:
    twice = np.stack([counts, counts])
    w = labkit.fit_image(
        twice, CARPET, OPTICS, corners_px=CORNERS, gain=GAIN, read_noise=READ_NOISE
    )
    assert len(w.poses) == 2
    assert np.all(np.abs(w.waves - WAVES) < 4 * np.sqrt(2) * w.std)  # the same noise twice


def test_what_is_no_photograph_is_refused(counts: Floats) -> None:
    with pytest.raises(ValueError, match=r"counts has shape \(54,\)"):
        labkit.fit_image(counts[:, 0], CARPET, OPTICS)
    with pytest.raises(ValueError, match="corners_px"):
        labkit.fit_image(counts, CARPET, OPTICS, corners_px=CORNERS[:3])
    with pytest.raises(DataError, match="black level removed"):
        labkit.fit_image(-counts, CARPET, OPTICS, corners_px=CORNERS)
    with pytest.raises(DataError, match="no usable pixel"):
        labkit.fit_image(
            counts, CARPET, OPTICS, corners_px=CORNERS, mask=np.zeros(FRAME, bool)
        )
