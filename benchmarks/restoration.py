"""A photograph of some megapixels in three colours restored by `labkit.restore`: time, memory, RMSE, coverage of its errors.

python -m benchmarks.restoration [MEGAPIXELS [SAMPLES]]

The photograph repeats one natural scene, which is periodic, so that its truth is known everywhere.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from time import perf_counter
from typing import Any

import numpy as np
import tifffile

import labkit
from labkit.experiments import restoration as study
from labkit.experiments.camera import Camera
from labkit.experiments.conditions import NOLL
from labkit.experiments.picture_camera import PictureCamera
from labkit.plan import Plan
from labkit.results import Results, Wavefront
from labkit.types import Floats

MEGAPIXELS, SAMPLES, WORKERS, MEMORY_GB = 24.0, 1, 2, 3.0
TORUS_PX, BLACK = 256, 600
WATCHED_EVERY_S = 0.2
RANGE_MM = 3200.0
CHANNEL = """
[[channel]]
name = "{name}"
wavelength_nm = {nm}
"""
PLAN = f"""
[lens]
focal_length_mm = 70.0
f_number = {study.SCENE_F_NUMBER}
[sensor]
pixel_pitch_um = {study.SCENE_PITCH_UM}
cfa_pattern = "RGGB"
black_level = {BLACK}
white_level = 16383
[target]
kind = "sierpinski"
order = 3
size_mm = 10.0
[fit]
zernike_noll = [4, 15]
reference_wavelength_nm = {1e3 * study.REFERENCE_UM}
"""


def session(folder: Path) -> Path:
    """The study's lens as a session's results."""
    lights = study.LIGHTS.items()
    channels = [CHANNEL.format(name=n, nm=1e3 * li.wavelength_um) for n, li in lights]
    fits = [
        Wavefront(
            range_mm=RANGE_MM,
            measured_range_mm=RANGE_MM,
            channel=name,
            wavelength_nm=1e3 * light.wavelength_um,
            reference_wavelength_nm=1e3 * study.REFERENCE_UM,
            f_number=study.SCENE_F_NUMBER,
            noll=NOLL,
            waves=light.waves(),
            covariance=1e-8 * np.eye(len(NOLL)),
            poses=np.zeros((1, 8)),
            gain=study.SCENE_GAIN,
            read_noise=study.SCENE_READ_NOISE,
            chi2_per_pixel=1.0,
        )
        for name, light in lights
    ]
    plan = Plan.parse(PLAN + "".join(channels))
    Results(plan, "", tuple(fits), None, None).write(folder / "results" / "latest")
    return folder


def worlds() -> dict[str, PictureCamera]:
    """scikit-image's astronaut, mirrored so that it repeats itself, in each colour."""
    from skimage import data

    astronaut: Any = data.astronaut
    radiance = (astronaut()[::2, ::2] / 255.0) ** 2.2
    radiance = np.concatenate([radiance, radiance[::-1]])
    radiance = np.concatenate([radiance, radiance[:, ::-1]], axis=1)
    camera = Camera(0.55, study.SCENE_F_NUMBER, study.SCENE_PITCH_UM, TORUS_PX, TORUS_PX, 8)
    return {
        name: PictureCamera(
            radiance[..., k],
            2,
            replace(camera, wavelength_um=light.wavelength_um),
            light.waves() * study.REFERENCE_UM / light.wavelength_um,
            NOLL,
        )
        for k, (name, light) in enumerate(study.LIGHTS.items())
    }


def photograph(path: Path, scene: dict[str, PictureCamera], megapixels: float) -> None:
    """Write a raw photograph of 2 by 3."""
    mosaic = np.zeros((TORUS_PX, TORUS_PX))
    for name, world in scene.items():
        mean = world.mean()
        for row, column in study.LIGHTS[name].places:
            mosaic[row::2, column::2] = mean[row::2, column::2]
    rows, columns = (2 * round(np.sqrt(megapixels * 1e6 * r) / 2) for r in (2 / 3, 3 / 2))
    whole = np.take(np.arange(TORUS_PX), range(columns), mode="wrap")
    rng = np.random.default_rng(1)
    counts = np.empty((rows, columns), np.uint16)
    for row in range(rows):
        mean = study.SCENE_WHITE * mosaic[row % TORUS_PX, whole].clip(0)
        shot = study.SCENE_GAIN * rng.poisson(mean / study.SCENE_GAIN)
        noisy = shot + rng.normal(BLACK, study.SCENE_READ_NOISE, columns)
        counts[row] = np.rint(noisy).clip(0, 16383)
    tifffile.imwrite(path, counts)


def compared(folder: Path, truth: Floats) -> tuple[list[float], list[float]]:
    """Return RMSE in % of white, and the share within one standard error, of each colour."""
    scene = tifffile.memmap(folder / "restored.tif", mode="r")
    std = tifffile.memmap(folder / "std.tif", mode="r")
    squares = np.zeros(3)
    within = np.zeros(3)
    columns = np.arange(scene.shape[1]) % truth.shape[1]
    for row, (restored, error) in enumerate(zip(scene, std, strict=True)):
        apart = restored - truth[row % len(truth)][columns]
        squares += np.sum(apart**2, axis=0)
        within += np.sum(np.abs(apart) < error, axis=0)
    count = scene.shape[0] * scene.shape[1]
    rmse = 100 * np.sqrt(squares / count) / study.SCENE_WHITE
    return rmse.round(3).tolist(), (within / count).round(3).tolist()


def processor_seconds() -> float:
    """Processor time of this process and of those that have ended."""
    usage = [
        resource.getrusage(k) for k in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return sum(u.ru_utime + u.ru_stime for u in usage)


@contextmanager
def watched() -> Iterator[list[float]]:
    """Yield a list of one number, the largest memory of this process and its workers so far, GB."""
    peak = [0.0]
    ended = Event()

    def watch() -> None:
        while not ended.wait(WATCHED_EVERY_S):
            total = 0.0
            for process in ("self", *(child.pid for child in active_children())):
                with suppress(OSError):
                    pages = Path(f"/proc/{process}/statm").read_text().split()[1]
                    total += int(pages) * resource.getpagesize() / 1e9
            peak[0] = max(peak[0], total)

    thread = Thread(target=watch)
    thread.start()
    try:
        yield peak
    finally:
        ended.set()
        thread.join()


def main() -> None:
    """Print the figures as JSON."""
    given = [float(text) for text in sys.argv[1:]]
    megapixels = given[0] if given else MEGAPIXELS
    samples = given[1] if len(given) > 1 else SAMPLES
    with TemporaryDirectory() as name:
        folder = Path(name)
        scene = worlds()
        photograph(folder / "a.tif", scene, megapixels)
        psf = session(folder / "session")
        before = processor_seconds()
        began = perf_counter()
        with watched() as peak:
            (made,) = labkit.restore(
                folder / "a.tif",
                psf,
                folder / "out",
                samples=int(samples),
                workers=WORKERS,
                memory_gb=MEMORY_GB,
            )
        seconds = perf_counter() - began
        used = processor_seconds() - before
        truths = [study.SCENE_WHITE * world.truth(int(samples)) for world in scene.values()]
        rmse, within = compared(made.folder, np.stack(truths, axis=-1))
        figures = {
            "megapixels": megapixels,
            "samples": int(samples),
            "tiles": made.about["tiles"],
            "minutes": round(seconds / 60, 2),
            "processor_minutes": round(used / 60, 2),
            "gigabytes_of_all_processes": round(peak[0], 2),
            "rmse_percent_of_white": rmse,
            "within_one_std": within,
        }
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
