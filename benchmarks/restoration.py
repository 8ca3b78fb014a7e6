"""How long a restoration takes, and what memory: 128 x 128 counts of a colour, and a tile of 24 megapixels in colour.

python -m benchmarks.restoration
"""

from __future__ import annotations

import math
import resource
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy import ndimage

from labkit.imaging.optics import Optics
from labkit.restoration.job import Colour, Exposure, Job
from labkit.restoration.tiles import memory_bytes, restore_job

PLACES = {"R": ((0, 0),), "G": ((0, 1), (1, 0)), "B": ((1, 1),)}
WAVELENGTHS_UM = {"R": 0.65, "G": 0.55, "B": 0.45}
MEGAPIXELS, TILE_PX, OVERLAP_PX, GUARD_PX = 24.0, 256, 32, 16


def job(side: int, colours: str, samples: int) -> Job:
    """A smooth random scene, defocused by a wave."""
    rng = np.random.default_rng(1)
    scene = ndimage.gaussian_filter(rng.normal(size=(side, side)), 4)
    counts = 3000 * np.exp(scene / scene.std() / 2)
    counts = counts + rng.normal(size=counts.shape) * np.sqrt(0.45 * counts)
    optics = Optics(
        wavelength_nm=650.0,
        reference_nm=450.0,
        f_number=2.87,
        pitch_um=4.78,
        active_um=4.78,
        noll=(4, 11),
    )
    lenses = [
        Colour(
            name,
            PLACES[name],
            replace(optics, wavelength_nm=1e3 * WAVELENGTHS_UM[name]),
            np.array([1.0, 0.03]),
            0.45,
            1.3,
        )
        for name in colours
    ]
    photograph = Exposure(counts, np.ones(counts.shape, bool), np.ones(counts.shape))
    return Job((photograph,), tuple(lenses), 2, samples, GUARD_PX, np.eye(len(lenses)))


def main() -> None:
    """Print the times."""
    for what, taken, tile in (
        ("128 x 128 counts of red, 6 samples a pixel", job(256, "R", 6), 256),
        (
            f"a tile of {TILE_PX} pixels in colour, 1 sample a pixel",
            job(TILE_PX + 2 * OVERLAP_PX, "RGB", 1),
            1024,
        ),
    ):
        began = perf_counter()
        restore_job(taken, 1e4, tile, OVERLAP_PX)
        seconds = perf_counter() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(
            f"{what}: {seconds:.1f} s, {memory_bytes(taken, tile, OVERLAP_PX) / 1e9:.2f} GB stated, {peak:.2f} GB at most"
        )
    count = math.ceil(MEGAPIXELS * 1e6 / TILE_PX**2)
    print(
        f"{MEGAPIXELS:g} megapixels are {count} such tiles: {count * seconds / 2 / 60:.0f} minutes on two cores"
    )


if __name__ == "__main__":
    main()
