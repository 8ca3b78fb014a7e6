"""A real photograph restored through another camera's lens: no more ringing than Richardson and Lucy's method leaves as sharp.

Skipped where the photograph is not at hand.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy import ndimage

from labkit.cli import run
from labkit.plan import Plan
from labkit.results import Results, Wavefront
from tests.plans import plan_text
from tests.system.test_real_edges import NIKON, REAL

PHOTOGRAPH = REAL / "DSC_1339_768x512_rggb.raw"
CROP, SAMPLES = (128, 256, 384, 512), 3
EDGE = (
    (271.6, 466.3),
    (240.3, 491.3),
)  # of a petal before the dark: from there to there, pixels
BESIDE_PX = 3.5


def session(folder: Path, defocus: float) -> Path:
    """A lens like the demo's, as far out of focus as its target was."""
    noll = (4, 5, 6, 7, 8, 11)
    wavefront = Wavefront(
        range_mm=3000.0,
        measured_range_mm=3000.0,
        channel="G",
        wavelength_nm=550.0,
        reference_wavelength_nm=450.0,
        f_number=2.863,
        noll=noll,
        waves=np.array([defocus, -0.008, 0.014, 0.024, 0.030, -0.028]),
        covariance=1e-8 * np.eye(len(noll)),
        poses=np.zeros((1, 8)),
        gain=0.45,
        read_noise=1.16,
        chi2_per_pixel=1.0,
    )
    Results(Plan.parse(plan_text(NIKON)), "", (wavefront,), None, None).write(
        folder / "results" / "latest"
    )
    return folder


def restored(folder: Path, psf: Path, *more: str) -> tuple[np.ndarray, dict[str, Any]]:
    asked = [
        "--psf",
        str(psf),
        "--force",
        "--crop",
        ",".join(map(str, CROP)),
        "--samples",
        str(SAMPLES),
        "--quiet",
    ]
    assert run(["restore", str(PHOTOGRAPH), *asked, *more, "--out", str(folder)]) == 0
    return tifffile.imread(folder / "restored.tif")[..., 0], json.loads(
        (folder / "restore.json").read_text()
    )


def edge(scene: np.ndarray) -> tuple[float, float]:
    """Width from 10 to 90 %, pixels, and what is below or above the two sides beside it, of the step."""
    begin, end = (SAMPLES * (np.array(place) - CROP[:2]) for place in EDGE)
    along = (end - begin) / np.hypot(*(end - begin))
    off = np.arange(-6 * SAMPLES, 6 * SAMPLES + 0.01, 0.2)
    places = [begin + share * (end - begin) for share in np.linspace(0, 1, 60)]
    lines = [
        ndimage.map_coordinates(
            scene, [p[0] - along[1] * off, p[1] + along[0] * off], order=1, mode="nearest"
        )
        for p in places
    ]
    profile, at = np.mean(lines, axis=0), off / SAMPLES
    profile = profile if profile[-1] > profile[0] else profile[::-1]
    low, high = profile[at < -BESIDE_PX].mean(), profile[at > BESIDE_PX].mean()
    rise = (profile - low) / (high - low)
    middle = np.argmin(np.abs(rise - 0.5) + 9 * (np.abs(at) > 2))
    first = np.flatnonzero(rise[:middle] < 0.1)[-1]
    last = middle + np.flatnonzero(rise[middle:] > 0.9)[0]
    near = rise[np.abs(at) < BESIDE_PX]
    return float(at[last] - at[first]), float(max(-near.min(), 0) + max(near.max() - 1, 0))


@pytest.mark.skipif(not REAL.is_dir(), reason="needs ../shared/real")
@pytest.mark.slow
def test_a_photograph_rings_no_more_than_richardsons_and_lucys_scene_as_sharp(
    tmp_path: Path,
) -> None:
    scene, about = restored(
        tmp_path / "ours", session(tmp_path / "lens", -0.62), "--fit-defocus"
    )
    assert about["defocus_waves"] == {
        "G": 0.0
    }  # 0.03 ± 0.25 is not told; 0.8 by cross-validation
    sharp = restored(
        tmp_path / "other", session(tmp_path / "sharp", 0.0), "--method", "richardson-lucy"
    )[0]
    others = [
        edge(ndimage.gaussian_filter(sharp, sigma)) for sigma in np.arange(0, 6, 0.25)
    ]
    width, ringing = edge(scene)
    widths, rings = np.array(others).T
    assert widths[0] < width < widths[-1]
    assert ringing < np.interp(
        width, widths, rings
    )  # 0.5 % and 0.7 % of the step measured, at 3.4 pixels
