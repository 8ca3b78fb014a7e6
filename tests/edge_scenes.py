"""A scene of edges as a file, by a camera that shares nothing with the model, and a session's results of its lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

from labkit.experiments.edge_camera import EdgeCamera
from labkit.plan import Plan
from labkit.results import Focus, OptimumTest, Results, Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.plans import plan_text

NOLL = (4, 5, 6, 7, 8, 11)
MODES = np.array([0.03, -0.04, 0.02, 0.03, 0.05])
FOCUS_MM, FOCAL_MM, F_NUMBER, NM = 2000.0, 50.0, 8.0, 550.0
WORKING_F_NUMBER = F_NUMBER * (1 + FOCAL_MM / (FOCUS_MM - FOCAL_MM))
SIDE = 40  # of an edge's square, pixels
GAIN, READ, BLACK = 0.5, 2.0, 500
TABLES = {
    "lens": {"focal_length_mm": FOCAL_MM, "f_number": F_NUMBER},
    "sensor": {
        "pixel_pitch_um": 4.78,
        "cfa_pattern": "mono",
        "black_level": BLACK,
        "white_level": 16383,
    },
    "channel": [{"name": "M", "wavelength_nm": NM}],
    "target": {"kind": "sierpinski", "order": 4, "size_mm": 15.6},
    "fit": {"zernike_noll": [4, 11]},
}
PLAN = plan_text(TABLES)


def true_defocus(range_mm: float) -> float:
    """Waves RMS by the parabola of a small aperture: A^2 / 8 of the difference of 1 / range, mm."""
    path_mm = (FOCAL_MM / F_NUMBER) ** 2 / 8 * (1 / FOCUS_MM - 1 / range_mm)
    return float(path_mm / np.sqrt(12) / (NM * 1e-6))


def square(range_mm: float, angle: float) -> Floats:
    """(SIDE, SIDE) mean counts of an edge."""
    camera = EdgeCamera(NM * 1e-3, WORKING_F_NUMBER, 4.78, frame=SIDE, finer=4, reach_px=40)
    waves = np.concatenate([[true_defocus(range_mm)], MODES])
    return camera.mean(angle, 0.6, (1000.0, 6000.0), waves, NOLL)


def write_scene(path: Path, squares: list[Floats], seed: int = 1) -> Path:
    """Squares side by side, noisy, as a 16-bit TIFF."""
    rng, mean = np.random.default_rng(seed), np.hstack(squares)
    counts = GAIN * rng.poisson(mean / GAIN) + rng.normal(0, READ, mean.shape) + BLACK
    tifffile.imwrite(path, np.clip(np.rint(counts), 0, 65535).astype(np.uint16))
    return path


def box(place: int) -> tuple[int, int, int, int]:
    """Of one square."""
    return 2, place * SIDE + 2, SIDE - 2, (place + 1) * SIDE - 2


def lens_results(**lens: float) -> Results:
    """What a session found of the lens: its modes to 0.002 waves, best focus to 0.5 mm. lens: what its plan has otherwise."""
    plan = Plan.parse(plan_text(TABLES, {"lens": lens}), Path())
    waves = np.concatenate([[true_defocus(2500.0)], MODES])
    wavefront = Wavefront(
        range_mm=2500.0,
        measured_range_mm=2500.0,
        channel="M",
        wavelength_nm=NM,
        reference_wavelength_nm=NM,
        f_number=WORKING_F_NUMBER,
        noll=NOLL,
        waves=waves,
        covariance=0.002**2 * np.eye(len(NOLL)),
        poses=np.zeros((1, 8)),
        gain=GAIN,
        read_noise=READ,
        chi2_per_pixel=1.0,
        test=OptimumTest("residuals", accepted=True, p_value=0.5),
    )
    focus = Focus(
        {"M": Uncertain(FOCUS_MM, 0.5, "mm")},
        Uncertain(1.0, 0.05),
        identifiable=True,
        residual_waves={"M": (0.0,)},
    )
    return Results(plan, "", (wavefront,), focus)
