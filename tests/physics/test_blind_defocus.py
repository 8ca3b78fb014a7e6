"""The defocus of photographs of unknown scenes, and their noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labkit.experiments.picture_camera import PictureCamera
from labkit.restoration.blind import Defocus, fitted_defocus, moved
from labkit.restoration.job import Exposure, Job
from labkit.restoration.noise import own_noise
from tests.physics.restoration_samples import GAIN, NOLL, WAVES, exposed, job, world

PX, TORUS = 64, 112
SIDE = 2 * TORUS


@cache
def leaves(seed: int) -> np.ndarray:
    """Discs before discs, their radii as often small as large: the usual model of scenes (A. Lee et al., 2001)."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    scene = np.full((SIDE, SIDE), 0.5)
    for radius in np.sort(40 * rng.uniform(0.03, 1, 1500) ** 3)[::-1]:
        row, column = rng.uniform(0, SIDE, 2)
        scene[np.hypot(rows - row, columns - column) < max(radius, 1.5)] = rng.uniform(
            0.1, 1
        )
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


def test_the_defocus_of_a_photograph_is_found() -> None:
    taken, defocus = found(1, 1.0)
    assert defocus.determined
    assert abs(defocus.waves - 1.0) < 2 * defocus.std < 0.7  # 1.05 ± 0.25 measured
    assert taken.colours[0].waves[0] == pytest.approx(defocus.waves)


def test_a_photograph_in_focus_is_left_there() -> None:
    taken, defocus = found(1, 0.0)
    assert not defocus.determined
    assert taken.colours[0].waves[0] == pytest.approx(0)


def test_a_photographs_noise_is_found_beside_its_scene() -> None:
    rng = np.random.default_rng(0)
    mean = np.add.outer(np.linspace(50, 9000, 512), np.zeros(768))
    counts = GAIN * rng.poisson(mean / GAIN) + rng.normal(0, 3.0, mean.shape)
    shot = Exposure(counts, np.ones(counts.shape, bool), np.ones(counts.shape))
    noise = own_noise(shot, replace(job(counts).colours[0], places=((0, 1), (1, 0))), 2)
    assert noise is not None
    assert noise[0] == pytest.approx(
        GAIN, rel=0.09
    )  # 4.5 % off: the darkest of a group's squares are its quietest


def test_too_small_a_photograph_tells_no_noise() -> None:
    counts = np.full((32, 32), 100.0)
    assert own_noise(job(counts).photographs[0], job(counts).colours[0], 2) is None
