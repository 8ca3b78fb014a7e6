"""The defocus of photographs of unknown scenes, their noise, and what ringing a wrong one would leave."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labkit.experiments.picture_camera import PictureCamera
from labkit.restoration.blind import Defocus, fitted_defocus, moved
from labkit.restoration.job import Job, Photograph
from labkit.restoration.noise import own_noise
from tests.physics.restoration_samples import GAIN, NOLL, WAVES, exposed, job, world


PX, TORUS = 96, 144
SIDE = 2 * TORUS


@cache
def leaves(seed: int) -> np.ndarray:
    """Discs before discs, their radii as often small as large: the usual model of scenes (A. Lee et al., 2001)."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    scene = np.full((SIDE, SIDE), 0.5)
    for radius in np.sort(40 * rng.uniform(0.03, 1, 1500) ** 3)[::-1]:
        row, column = rng.uniform(0, SIDE, 2)
        scene[np.hypot(rows - row, columns - column) < max(radius, 1.5)] = rng.uniform(0.1, 1)
    return scene


def photographed(seed: int, waves: float) -> Job:
    """A job whose lens is supposed to have 0.1 waves of defocus."""
    wavefront = np.array([waves, *WAVES[1:]])
    camera = replace(world().camera, pixels=TORUS, frame=PX)
    counts = exposed(PictureCamera(leaves(seed), 2, camera, wavefront, NOLL).mean())
    return moved(job(counts, places=((0, 1), (1, 0)), guard_px=20), 0.1 - WAVES[0])


@cache
def found(seed: int, waves: float) -> tuple[Job, Defocus]:
    return fitted_defocus(photographed(seed, waves))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("waves", [0.5, 0.9])
def test_the_defocus_of_a_photograph_is_found(seed: int, waves: float) -> None:
    taken, defocus = found(seed, waves)
    assert defocus.told
    assert abs(defocus.waves - waves) < 2 * defocus.std
    assert taken.colours[0].waves[0] == pytest.approx(defocus.waves)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_photograph_in_focus_is_left_there(seed: int) -> None:
    taken, defocus = found(seed, 0.0)
    assert not defocus.told
    assert taken.colours[0].waves[0] == pytest.approx(0)


def test_a_photographs_noise_is_found_beside_its_scene() -> None:
    rng = np.random.default_rng(0)
    mean = np.kron(200 + 4000 * leaves(1), np.ones((4, 4)))
    counts = GAIN * rng.poisson(mean / GAIN) + rng.normal(0, 10.0, mean.shape)
    shot = Photograph(counts, np.ones(counts.shape, bool), np.ones(counts.shape))
    noise = own_noise(shot, replace(job(counts).colours[0], places=((0, 1), (1, 0))), 2)
    assert noise is not None
    level = 2000.0
    # 0.?? measured
    assert noise[0] * level + noise[1] == pytest.approx(GAIN * level + 100, rel=0.1)
