"""Charts as files, by a camera that shares nothing with the model, whose wavefront varies over the field in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft

from labkit.experiments.edge_camera import EdgeCamera
from labkit.types import Floats
from tests.edge_scenes import F_NUMBER, FOCAL_MM, NM, TABLES
from tests.plans import plan_text

PITCH_UM = 4.78
PATCH = 144  # pixels along a side of a part of the frame with one wavefront
FINER = 4
REACH = 80  # pixels of the PSF's window
NOLL = (4, 5, 6, 7, 8, 11)
DARK, BRIGHT = 1000.0, 6000.0
PLAN = plan_text(TABLES)

Waves = Callable[[float, float], Floats]
"""Modes (6,), waves RMS, at (y, x) mm from the frame's centre."""

Scene = Callable[[Floats, Floats], Floats]
"""Distances to the nearest edge, px, positive in the bright, at rows and columns."""


def chart(
    parts: tuple[int, int], waves: Waves, working_f_number: float, scene: Scene
) -> Floats:
    """Mean counts of a frame of patches, each with the wavefront at its middle."""
    camera = EdgeCamera(NM * 1e-3, working_f_number, PITCH_UM, finer=FINER, reach_px=REACH)
    at = (np.arange((PATCH + 2 * REACH) * FINER) + 0.5) / FINER - REACH - 0.5
    rows = []
    for r in range(parts[0]):
        row = []
        for c in range(parts[1]):
            lit = scene(*np.meshgrid(at + r * PATCH, at + c * PATCH, indexing="ij"))
            psf = camera.psf(waves(*height(parts, (r, c))), NOLL)
            row.append(_seen((0.5 + FINER * lit).clip(0, 1), psf))
        rows.append(np.hstack(row))
    return np.vstack(rows)


def squares(y: Floats, x: Floats) -> Floats:
    """Dark squares turned by 5°, one in the middle of each patch, on a bright ground."""
    u, v = _turned((y + 0.5) % PATCH - PATCH / 2, (x + 0.5) % PATCH - PATCH / 2)
    return np.asarray(np.maximum(np.abs(u), np.abs(v)) - 0.3 * PATCH)


def checkerboard(y: Floats, x: Floats) -> Floats:
    """A checkerboard turned by 5°, of squares as wide as a patch."""
    u, v = _turned(y, x)
    away = [PATCH / 2 - np.abs(each % PATCH - PATCH / 2) for each in (u, v)]
    bright = (np.floor(u / PATCH) + np.floor(v / PATCH)) % 2 == 0
    return np.asarray(np.minimum(*away) * np.where(bright, 1, -1))


def _turned(y: Floats, x: Floats) -> tuple[Floats, Floats]:
    turn = np.radians(5.0)
    return x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)


def height(parts: tuple[int, int], part: tuple[int, int]) -> tuple[float, float]:
    """(y, x) of the middle of a patch from the frame's centre, mm."""
    y, x = (
        (k + 0.5 - n / 2) * PATCH * PITCH_UM * 1e-3
        for k, n in zip(part, parts, strict=True)
    )
    return y, x


def _seen(lit: Floats, psf: Floats) -> Floats:
    """(PATCH, PATCH) mean counts of a scene on fine samples."""
    grown = scipy.fft.next_fast_len(len(lit) + len(psf) - 1, real=True)
    size = (grown, grown)
    spectrum = scipy.fft.rfft2(lit - 0.5, size) * scipy.fft.rfft2(psf, size)
    inside = slice(2 * REACH * FINER, (2 * REACH + PATCH) * FINER)
    seen = scipy.fft.irfft2(spectrum, size)[inside, inside]
    pixels = seen.reshape(PATCH, FINER, PATCH, FINER).mean(axis=(1, 3)) + 0.5
    return np.asarray(DARK + (BRIGHT - DARK) * pixels)


def working_f_number(focus_mm: float) -> float:
    """Of the lens focused at a range."""
    return F_NUMBER * (1 + FOCAL_MM / (focus_mm - FOCAL_MM))


def true_mtf(
    waves: Floats, working_f_number: float, azimuth: float, per_mm: Floats
) -> Floats:
    """MTF (n,) of lens and pixel along an azimuth, radians from x towards y, by the sum over the PSF's samples."""
    camera = EdgeCamera(NM * 1e-3, working_f_number, PITCH_UM, finer=FINER, reach_px=REACH)
    psf = camera.psf(waves, NOLL)
    at_mm = (np.arange(len(psf)) - len(psf) // 2) * PITCH_UM * 1e-3 / FINER
    columns, rows = per_mm * np.cos(azimuth), per_mm * np.sin(azimuth)
    down = np.exp(-2j * np.pi * np.outer(rows, at_mm))
    across = np.exp(-2j * np.pi * np.outer(columns, at_mm))
    lens = np.einsum("fy,yx,fx->f", down, psf, across)
    pitch_mm = PITCH_UM * 1e-3
    return np.asarray(np.abs(lens * np.sinc(columns * pitch_mm) * np.sinc(rows * pitch_mm)))
