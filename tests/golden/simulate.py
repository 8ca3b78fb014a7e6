"""A session whose truth is known, formed by brute force: `python -m tests.golden.simulate FOLDER [SEED [engraved]]`.

It shares nothing with labkit: modes written out as polynomials, a PSF from a pupil of its own, the carpet averaged over
samples nine to a pixel, laid over without wrap-around, a pixel as a sum of samples, Poisson and read noise. It writes
frames.csv, plan.toml, the photographs as DNG, truth.json and psf.npz.

The sensor stands still behind a lens with two pupils: the cone is that from the exit pupil to the sensor, the picture is
drawn by chief rays. `engraved`: the plan then has another focal length and f-number than the lens, and a tape that is off.

Axes as on the sensor: rows down, columns right; pupil x right, y down; a path that grows to the right throws light right.
"""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import laplace

from tests.dng import write_dng

Floats = NDArray[np.float64]

FOCAL_MM, F_NUMBER, MAGNIFICATION = 60.0, 4.0, 1.08
REFERENCE_NM = 450.0
FRAME = 144  # pixels along a side
PITCH_UM = 5.0
FINER, ACTIVE = (
    9,
    8,
)  # samples to a pixel, and those of them that are sensitive, along a side
SPACING_UM = PITCH_UM / FINER
REACH = (
    110 * FINER
)  # of the PSF, samples: no used pixel is further from a corner of the target along a side
PERIOD = 5832  # samples after which the sampled pupil's field repeats
ORDER, SIZE_MM = 4, 13.0
RANGES_MM = (1450.0, 1600.0)
COLOURS = {"R": 630.0, "G": 535.0, "B": 455.0}  # nm
BEST_FOCUS_MM = {"R": 1531.0, "G": 1524.0, "B": 1538.0}
SENSITIVITY = {"R": 0.8, "G": 1.0, "B": 0.7}
WHITE_ELECTRONS, AMBIENT = 28_000.0, 0.01
GAIN, READ_NOISE_COUNTS, BLACK, WHITE = 0.5, 1.2, 600, 16383
RESPONSE_STD = 0.005  # of the pixels' sensitivities
PLAN = f"""\
[lens]
focal_length_mm = {{focal_mm}}
f_number = {{f_number}}

[sensor]
pixel_pitch_um = {PITCH_UM}
fill_factor = {(ACTIVE / FINER) ** 2:.12f}

[target]
kind = "sierpinski"
order = {ORDER}
size_mm = {SIZE_MM}

[fit]
zernike_noll = [4, 15]
""" + "".join(
    f'\n[[channel]]\nname = "{name}"\nwavelength_nm = {nm}\n'
    for name, nm in COLOURS.items()
)


def modes(x: Floats, y: Floats) -> dict[int, Floats]:
    """Noll's modes 4 to 15, unit RMS over the disc, as he tabulates them (1976), in Cartesian form."""
    s = x * x + y * y
    return {
        4: sqrt(3) * (2 * s - 1),
        5: sqrt(6) * 2 * x * y,
        6: sqrt(6) * (x * x - y * y),
        7: sqrt(8) * (3 * s - 2) * y,
        8: sqrt(8) * (3 * s - 2) * x,
        9: sqrt(8) * (3 * x * x - y * y) * y,
        10: sqrt(8) * (x * x - 3 * y * y) * x,
        11: sqrt(5) * (6 * s * s - 6 * s + 1),
        12: sqrt(10) * (4 * s - 3) * (x * x - y * y),
        13: sqrt(10) * (4 * s - 3) * 2 * x * y,
        14: sqrt(10) * (x**4 - 6 * x * x * y * y + y**4),
        15: sqrt(10) * 4 * x * y * (x * x - y * y),
    }


def defocus_waves(
    range_mm: float,
    best_mm: float,
    focal_mm: float = FOCAL_MM,
    f: float = F_NUMBER,
    mp: float = MAGNIFICATION,
) -> float:
    """Difference of two spheres over the exit pupil, thesis (4.40) with its sign corrected; positive beyond best focus."""
    half = mp * focal_mm / f / 2
    image, focus = (q * focal_mm / (q - focal_mm) for q in (range_mm, best_mm))
    offset = (mp - 1) * focal_mm
    path = (
        image
        - focus
        + sqrt((focus + offset) ** 2 - half**2)
        - sqrt((image + offset) ** 2 - half**2)
    )
    return path / sqrt(12) / (REFERENCE_NM * 1e-6)


def point_spread(waves: dict[int, float], wavelength_nm: float, f_number: float) -> Floats:
    """(2 REACH + 1, same) light in each sample of the image of a point: the share of all the light that passes the lens."""
    radius = (
        PERIOD * SPACING_UM / (2 * wavelength_nm * 1e-3 * f_number)
    )  # of the pupil, in samples of it
    half, many = int(radius) + 2, 6
    fine = (
        (np.arange((2 * half + 1) * many) - ((2 * half + 1) * many - 1) / 2) / many / radius
    ).astype(np.float32)
    disc = (
        (np.hypot(fine[:, None], fine) < 1)
        .reshape(2 * half + 1, many, 2 * half + 1, many)
        .mean(axis=(1, 3))
    )
    disc -= (
        laplace(disc) / 24
    )  # means over the pupil's samples dim its rings far out: put right to the fourth order
    y, x = np.meshgrid(*[np.arange(-half, half + 1) / radius] * 2, indexing="ij")
    shapes = modes(x, y)
    path = sum(amount * shapes[j] for j, amount in waves.items())
    pupil = disc * np.exp(2j * np.pi * REFERENCE_NM / wavelength_nm * path)
    window = np.arange(-REACH, REACH + 1)
    rows = scipy.fft.fft(pupil, PERIOD, axis=0, workers=2)[window]
    light = np.abs(scipy.fft.fft(rows, PERIOD, axis=1, workers=2)[:, window]) ** 2
    return np.asarray(
        light / (PERIOD**2 * disc.sum())
    )  # the disc's area is all the light, its grey rim's squares are less


def carpet() -> Floats:
    """(3**ORDER, same) cells: the removed middle squares white, the rest black."""
    cells = np.zeros((1, 1))
    for _ in range(ORDER):
        cells = np.block([[cells] * 3, [cells, np.ones_like(cells), cells], [cells] * 3])
    return cells


@dataclass(frozen=True, slots=True)
class Stated:
    """What the plan says of the lens; tape_mm: by how much a true range is longer than the one stated."""

    focal_mm: float = FOCAL_MM
    f_number: float = F_NUMBER
    tape_mm: float = 0.0


ENGRAVED = Stated(59.2, 4.1, 3.0)


def sensor_mm(best_mm: float) -> float:
    """How far behind the exit pupil, itself (1 - mp) f behind the rear principal plane, a sensor sees a range sharp."""
    return best_mm * FOCAL_MM / (best_mm - FOCAL_MM) - (1 - MAGNIFICATION) * FOCAL_MM


def cone(colour: str) -> float:
    """f-number of the light that meets at the sensor: distance of the exit pupil over its diameter."""
    return sensor_mm(BEST_FOCUS_MM[colour]) / (MAGNIFICATION * FOCAL_MM / F_NUMBER)


@dataclass(frozen=True, slots=True)
class Stand:
    """Range of the target, tilts about the sensor's rows and columns, roll (degrees), shift (pixels, right and down)."""

    range_mm: float
    tilts_deg: tuple[float, float]
    roll_deg: float
    shift_px: tuple[float, float]

    def radiance(self, row: Floats, column: Floats) -> Floats:
        """What pixel coordinates see: chief rays, from the entrance pupil's centre, cut with the target's plane."""
        a, b, c = np.radians([*self.tilts_deg, self.roll_deg])
        roll = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        turn = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        across, down, normal = (tilt @ turn @ roll).T
        sharp_mm = sum(BEST_FOCUS_MM.values()) / len(
            BEST_FOCUS_MM
        )  # the sensor stands at one place for all colours
        millimetre = (
            PITCH_UM * 1e-3 * MAGNIFICATION / sensor_mm(sharp_mm)
        )  # of ray for a pixel, at unit depth
        x = (column - (FRAME - 1) / 2 - self.shift_px[0]) * millimetre
        y = (row - (FRAME - 1) / 2 - self.shift_px[1]) * millimetre
        centre = self.range_mm - FOCAL_MM + FOCAL_MM / MAGNIFICATION
        depth = centre * normal[2] / (normal[0] * x + normal[1] * y + normal[2])
        point = (x * depth, y * depth, depth - centre)
        cells = carpet()
        where = [
            sum(p * e for p, e in zip(point, axis, strict=True)) / SIZE_MM + 0.5
            for axis in (down, across)
        ]
        i, j = (np.floor(at * len(cells)).astype(int) for at in where)
        inside = (i >= 0) & (i < len(cells)) & (j >= 0) & (j < len(cells))
        return np.where(inside, cells[np.where(inside, i, 0), np.where(inside, j, 0)], 0.0)


STANDS = (
    Stand(1450.0, (2.0, -3.0), 1.7, (0.37, -1.21)),
    Stand(1600.0, (-2.5, 1.5), -2.3, (-0.83, 0.46)),
)


def scene(stand: Stand) -> Floats:
    """Radiance averaged over each sample's square; where an edge passes, over 89 points, no two in line."""
    corner = (np.arange(FRAME * FINER + 1) - FRAME * FINER / 2) / FINER + (FRAME - 1) / 2
    at = stand.radiance(corner[:, None], corner)
    quads = np.array([at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]])
    mean: Floats = quads.mean(axis=0)
    i, j = np.nonzero(np.ptp(quads, axis=0))
    k = np.arange(89)
    down, right = (
        (k + 0.5) / 89 / FINER,
        (k * 55 % 89 + 0.5) / 89 / FINER,
    )  # a Fibonacci lattice
    mean[i, j] = stand.radiance(corner[i, None] + down, corner[j, None] + right).mean(
        axis=1
    )
    return mean


def pictures(stand: Stand, psfs: dict[str, Floats]) -> dict[str, Floats]:
    """(FRAME, FRAME) radiance that each colour's pixels would see."""
    fine = scene(stand)
    size = scipy.fft.next_fast_len(len(fine) + 2 * REACH, True)
    spectrum = scipy.fft.rfft2(fine, (size, size), workers=2)
    made = {}
    for colour, psf in psfs.items():
        whole = scipy.fft.irfft2(
            spectrum * scipy.fft.rfft2(psf, (size, size), workers=2),
            (size, size),
            workers=2,
        )
        seen = whole[REACH:, REACH:][: FRAME * FINER, : FRAME * FINER].reshape(
            FRAME, FINER, FRAME, FINER
        )
        made[colour] = seen[:, :ACTIVE, :, :ACTIVE].mean(axis=(1, 3))
    return made


def mosaic(colours: dict[str, Floats]) -> Floats:
    """An RGGB frame of the colours' radiances, each by its sensitivity: electrons."""
    frame = np.empty((FRAME, FRAME))
    for (r, c), colour in zip(((0, 0), (0, 1), (1, 0), (1, 1)), "RGGB", strict=True):
        frame[r::2, c::2] = (
            WHITE_ELECTRONS * SENSITIVITY[colour] * colours[colour][r::2, c::2]
        )
    return frame


def light() -> Floats:
    """Illumination over the frame: it falls off from a centre, as that of a lens and a backlight."""
    row, column = np.meshgrid(*[np.arange(FRAME) / FRAME] * 2, indexing="ij")
    return np.asarray(
        1 - 0.25 * ((row - 0.45) ** 2 + (column - 0.58) ** 2) + 0.03 * (row - 0.5)
    )


def draw_waves(rng: np.random.Generator) -> dict[str, dict[int, float]]:
    """Modes 5 to 15 of each colour: a lens's, with a small part of each colour's."""
    common = rng.normal(0, 0.025, 11)
    return {
        c: dict(zip(range(5, 16), common + rng.normal(0, 0.003, 11), strict=True))
        for c in COLOURS
    }


@lru_cache(maxsize=len(STANDS))
def seen(
    stand: Stand, seed: int
) -> tuple[dict[str, dict[int, float]], dict[str, Floats], Floats]:
    """By colour modes and PSF, 156 um wide, which is within the window that labkit writes; the target's electrons."""
    lens = draw_waves(np.random.default_rng(seed))
    waves = {
        c: {4: defocus_waves(stand.range_mm, BEST_FOCUS_MM[c])} | lens[c] for c in COLOURS
    }
    psfs = {c: point_spread(waves[c], COLOURS[c], cone(c)) for c in COLOURS}
    electrons = mosaic(
        {c: picture + AMBIENT for c, picture in pictures(stand, psfs).items()}
    )
    middle = slice(REACH - 140, REACH + 141)
    return waves, {c: psf[middle, middle].copy() for c, psf in psfs.items()}, electrons


def true_lens(stated: Stated) -> dict[str, Any]:
    """The lens, best focus on the scale that the plan's ranges have."""
    best = {colour: best_mm - stated.tape_mm for colour, best_mm in BEST_FOCUS_MM.items()}
    lens = {
        "focal_length_mm": FOCAL_MM,
        "f_number": F_NUMBER,
        "mp": MAGNIFICATION,
        "range_zero_mm": stated.tape_mm,
    }
    return lens | {"best_focus_mm": best}


def write_session(folder: Path, seed: int, stated: Stated = Stated()) -> None:
    """Everything that a lab would have, and the truth beside it, into an empty folder."""
    rng = np.random.default_rng(seed)
    draw_waves(rng)  # as `seen` does
    response = rng.normal(1, RESPONSE_STD, (FRAME, FRAME)) * light()
    rows: list[tuple[str, str, str]] = []
    truth: list[dict[str, Any]] = []
    stored: dict[str, Floats] = {"spacing_um": np.array(SPACING_UM)}

    def shoot(kind: str, count: int, range_mm: str, electrons: Floats) -> None:
        for k in range(count):
            signal = GAIN * rng.poisson(electrons * response) + rng.normal(
                0, READ_NOISE_COUNTS, electrons.shape
            )
            counts = np.clip(np.rint(signal + BLACK), 0, WHITE).astype(np.uint16)
            name = f"{kind}_{range_mm or 'none'}_{k}.dng"
            write_dng(folder / name, counts, black=BLACK, white=WHITE)
            rows.append((name, kind, range_mm))

    one = np.ones((FRAME, FRAME))
    shoot("dark", 4, "", 0 * one)
    for stand in STANDS:
        waves, psfs, electrons = seen(stand, seed)
        range_mm = stand.range_mm - stated.tape_mm
        shoot("target", 2, f"{range_mm:g}", electrons)
        shoot("flat", 4, f"{range_mm:g}", 0.9 * mosaic(dict.fromkeys(COLOURS, one)))
        for colour in COLOURS:
            truth.append(
                {
                    "range_mm": range_mm,
                    "channel": colour,
                    "waves": list(waves[colour].values()),
                }
            )
            stored[f"{range_mm:g}_{colour}"] = psfs[colour]
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("file", "kind", "range_mm"), *rows])
    (folder / "plan.toml").write_text(
        PLAN.format(focal_mm=stated.focal_mm, f_number=stated.f_number), encoding="utf-8"
    )
    summary = true_lens(stated) | {"gain": GAIN, "read_noise": READ_NOISE_COUNTS}
    (folder / "truth.json").write_text(
        json.dumps(summary | {"wavefronts": truth}, indent=1), encoding="utf-8"
    )
    np.savez_compressed(folder / "psf.npz", allow_pickle=False, **stored)


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    given = ENGRAVED if "engraved" in sys.argv[3:] else Stated()
    write_session(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0, given)
