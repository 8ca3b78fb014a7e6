"""Small photographs of known scenes, for restoration's tests; formed by `labkit.experiments.picture_camera`."""

from __future__ import annotations

from functools import cache

import numpy as np

from labkit.experiments.camera import Camera
from labkit.experiments.picture_camera import PictureCamera
from labkit.imaging.optics import Optics
from labkit.restoration.job import Colour, Exposure, Job
from labkit.types import Floats

NOLL = (4, 5, 6, 7)
WAVES = np.array([0.35, 0.05, -0.04, 0.06])
GAIN, READ_NOISE, WHITE = 0.45, 1.2, 4000.0
OPTICS = Optics(
    wavelength_nm=650.0,
    reference_nm=650.0,
    f_number=5.6,
    pitch_um=4.78,
    active_um=4.78,
    noll=NOLL,
)
FRAME, TORUS = 48, 80


@cache
def world() -> PictureCamera:
    """Blocks and a gradient, some of them black."""
    rng = np.random.default_rng(3)
    blocks = np.kron(rng.uniform(0, 1, (20, 20)) ** 2, np.ones((8, 8)))
    scene = np.where(blocks > 0.2, blocks, 0.0)
    camera = Camera(OPTICS.wavelength_um, OPTICS.f_number, OPTICS.pitch_um, TORUS, FRAME, 4)
    return PictureCamera(scene, 2, camera, WAVES, NOLL)


def exposed(mean: Floats, seed: int = 1) -> Floats:
    """Counts of a mean relative to white."""
    rng = np.random.default_rng(seed)
    counts = GAIN * rng.poisson(WHITE * mean.clip(0) / GAIN)
    return np.asarray(counts + rng.normal(0, READ_NOISE, mean.shape))


def job(
    *frames: Floats,
    samples: int = 2,
    places: tuple[tuple[int, int], ...] = ((0, 0),),
    guard_px: int = 10,
) -> Job:
    """One colour's planes of a Bayer mosaic."""
    colour = Colour("G", places, OPTICS, WAVES, GAIN, READ_NOISE**2)
    shots = [
        Exposure(counts, np.ones(counts.shape, bool), np.ones(counts.shape))
        for counts in frames
    ]
    return Job(tuple(shots), (colour,), 2, samples, guard_px, np.eye(1))
