"""Whether residuals are what a simulator left by drawing its target with so many points a pixel:
`python -m tests.golden.drawing RESULTS PSF.npz RANGE CHANNEL [POINTS...]`, of a session's results and the true PSFs.

A target drawn by points has edges that stand up to half a point off. Two drawings, one of them much finer, pass through the
same optics; only their difference is compared with what labkit's model leaves.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.fft

from .simulate import carpet

Floats = npt.NDArray[np.float64]

MARGIN = 16  # pixels about the frame
SAMPLES = 12  # a pixel, of the true PSFs; each is a mean of points
FINEST = 96  # points a pixel of what stands for the target itself
PLANES = {"R": ((0, 0),), "G": ((0, 1), (1, 0)), "B": ((1, 1),)}
"""First row and column of a colour's Bayer planes."""


def drawn(corners: Floats, side: int, points: int, order: int) -> Floats:
    """The carpet over the frame and a margin, SAMPLES a pixel. corners: (4, 2) rows and columns, clockwise."""
    cells = np.pad(carpet(order), 1)  # dark around
    unit, laws = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float), list[list[float]]()
    for (x, y), (down, right) in zip(unit, corners, strict=True):
        laws += [[x, y, 1, 0, 0, 0, -x * right, -y * right], [0, 0, 0, x, y, 1, -x * down, -y * down]]
    back = np.linalg.inv(np.append(np.linalg.solve(laws, corners[:, ::-1].ravel()), 1).reshape(3, 3))
    at = (np.arange((side + 2 * MARGIN) * points) + 0.5) / points - 0.5 - MARGIN
    each, rows = points // SAMPLES, list[Floats]()
    for first in range(0, at.size, points):
        x, y = np.meshgrid(at, at[first : first + points])
        across, down, scale = (row[0] * x + row[1] * y + row[2] for row in back)
        j, i = (
            np.clip(np.floor(along / scale * 3**order).astype(int) + 1, 0, 3**order + 1) for along in (across, down)
        )
        rows.append(cells[i, j].reshape(SAMPLES, each, -1, each).mean((1, 3)))
    return np.concatenate(rows)


def photographed(image: Floats, points: int, psf: Floats, spread_px: float) -> Floats:
    """(side, side) through the optics, a low-pass filter and a pixel."""
    kernel, reach = np.zeros(image.shape), np.arange(len(psf)) - len(psf) // 2
    kernel[np.ix_(reach, reach)] = psf / psf.sum()
    light = scipy.fft.rfft2(image) * scipy.fft.rfft2(kernel)
    for axis, frequency in enumerate((scipy.fft.fftfreq, scipy.fft.rfftfreq)):
        f = frequency(len(image), 1 / SAMPLES)
        points_mean = np.sinc(f / SAMPLES) / np.sinc(f / points)
        along = np.cos(np.pi * spread_px * f) * np.sinc(f) / points_mean * np.exp(1j * np.pi * f * (1 - 1 / SAMPLES))
        light *= np.expand_dims(along, 1 - axis)
    return np.asarray(scipy.fft.irfft2(light, image.shape))[::SAMPLES, ::SAMPLES][MARGIN:-MARGIN, MARGIN:-MARGIN]


def main(folder: Path, psfs: Path, range_mm: str, channel: str, *points: str) -> None:
    """Print by how much of each drawing's error the residuals hold, and how much of what two frames have in common it is."""
    results, left = json.loads((folder / "results.json").read_text()), np.load(folder / "residuals.npz")
    (fit,) = (w for w in results["wavefronts"] if (f"{w['range_mm']:g}", w["channel"]) == (range_mm, channel))
    key, side = f"{range_mm}_{channel}", fit["shape_px"][0]
    spread = results["model_parts"].get("low_pass_filter.spread_px", {"value": 0.0})["value"]
    order = results["plan"]["target"]["order"]
    data, model, sigma = (left[f"{of}_{key}"] for of in ("data", "model", "sigma"))
    z, corners, psf = (data - model) / sigma, np.array(fit["corners_px"][0]), np.load(psfs)[key].astype(float)

    def picture(of: int) -> Floats:
        seen = photographed(drawn(corners, side, of, order), of, psf, spread)
        return np.array([seen[row::2, column::2] for row, column in PLANES[channel]])

    target, used = picture(FINEST), np.isfinite(z).all(axis=0)
    common = 2 * float(np.sum(z[0][used] * z[1][used]))
    for count in map(int, points or ("60",)):
        error = ((picture(count) - target) * np.nanmax(model) / sigma[0])[used]
        square, along = float(error @ error), float(error @ z.mean(axis=0)[used])
        print(
            f"{key}, {count} points a pixel: {np.sqrt(square / error.size):.2f} of the noise, of which residuals hold "
            f"{along / square:.2f} ± {(2 * square) ** -0.5:.2f}: chi2 {2 * along**2 / square:.0f} of {common:.0f} in common"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
