"""Results made by hand, for tests: a lens focused near 2987 mm, two ranges, two colours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labkit.findings.findings import Finding, found
from labkit.optics.field import FieldFrame
from labkit.optics.rim import Circle, Diaphragm, FieldRim, Rim, Vignetting
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.results import (
    Focus,
    Lens,
    OptimumTest,
    Placement,
    Residuals,
    Results,
    Wavefront,
)
from labkit.results.entries import MadeFrom
from labkit.results.geometry import Distortion, ImageGeometry, LateralColour
from labkit.results.model import (
    CommonNumbers,
    OtherOptimum,
    PartTried,
    ResidualSpectrum,
    StatedNumber,
)
from labkit.uncertain import Uncertain
from tests.field_samples import a_field
from tests.plans import PORTRAIT, plan_text

PLAN = Plan.parse(
    plan_text(
        PORTRAIT,
        {
            "channel": [
                {"name": "R", "wavelength_nm": 650.0},
                {"name": "B", "wavelength_nm": 450.0},
            ]
        },
    ),
    Path(),
)
STD = np.array([0.0011, 0.0012, 0.0013])
ACCEPTED = OptimumTest("embedding", accepted=True, p_value=0.37, starts=3)
REJECTED = OptimumTest("residuals", accepted=False, p_value=0.0, starts=3, explains=False)
FOCUS = Focus(
    {"R": Uncertain(2986.84, 0.42, "mm"), "B": Uncertain(2987.31, 0.37, "mm")},
    Uncertain(0.981, 0.038),
    identifiable=False,
    residual_waves={"R": (0.0011, -0.0022), "B": (0.0013, -0.0024)},
    covariance=np.eye(3),
    residual_std_waves={"R": (0.0005, 0.0006), "B": (0.0007, 0.0008)},
)
LENS = Lens(
    Uncertain(69.31, 0.12, "mm"),
    Uncertain(2.874, 0.011),
    FOCUS.pupil_magnification,
    Uncertain(-5.8, 4.0, "mm"),
    {"R": Uncertain(621.2, 2.1, "nm"), "B": Uncertain(459.4, 1.7, "nm")},
)
BUDGET = {
    "best_focus_mm.R": {"photons": 0.3, "calibration": 0.1, "geometry": 0.2, "model": 0.2},
    "focal_length_mm": {"photons": 0.0, "calibration": 0.0, "geometry": 0.12, "model": 0.0},
}


def a_wavefront(
    range_mm: float | None = 3000.0,
    channel: str = "R",
    defocus: float = 0.0751,
    **changed: Any,
) -> Wavefront:
    """Defocus, oblique astigmatism and horizontal coma, with residuals of pure noise."""
    fields: dict[str, Any] = {
        "range_mm": range_mm,
        "measured_range_mm": range_mm,
        "channel": channel,
        "wavelength_nm": 650.0 if channel == "R" else 450.0,
        "reference_wavelength_nm": 450.0,
        "f_number": 2.8,
        "f_number_std": 0.008,
        "lambda_n": Uncertain(1.82 if channel == "R" else 1.26, 0.006, "um"),
        "blur": Uncertain(300 * defocus, 0.05, "um"),
        "noll": (4, 5, 8),
        "waves": np.array([defocus, 0.03, -0.04]),
        "covariance": np.diag(STD**2),
        "poses": np.array([[0.01, 0, 0, 0, 0, 0, 0, 0], [0.02, 0, 0, 0, 0, 0, 0, 0]]),
        "gain": 0.4567,
        "read_noise": 1.23,
        "chi2_per_pixel": 1.018,
        "test": ACCEPTED,
        "seconds": 4.2,
        "frames": tuple(f"target_{range_mm}_{channel}_{k}.dng" for k in range(2)),
        "placement": Placement(
            (10, 20), (24, 30), np.array([[[12, 22], [12, 40], [30, 40], [30, 22.0]]] * 2)
        ),
        "residuals": noise(),
    }
    return Wavefront(**fields | changed)


def noise() -> Residuals:
    """Two frames of one plane, a pixel of the first left out."""
    shape = 2, 1, 24, 30
    data = np.random.default_rng(1).normal(1000.0, 20.0, shape)
    data[0, 0, 3, 4] = np.nan
    return Residuals(data, np.full(shape, 1000.0), np.full(shape, 20.0))


def some_results(**changed: Any) -> Results:
    """Two ranges of two channels; not exact: nothing here is fitted."""
    fields: dict[str, Any] = {
        "plan": PLAN,
        "plan_sha256": "ab" * 32,
        "wavefronts": tuple(
            a_wavefront(r, c, d)
            for r, d in ((3000.0, 0.0751), (3200.0, 1.1432))
            for c in ("R", "B")
        ),
        "focus": FOCUS,
        "lens": LENS,
        "budget": BUDGET,
        "findings": (found("no-dark-frames"),),
    }
    return Results(**fields | changed)


def noted(*texts: str) -> tuple[Finding, ...]:
    """Warnings that are nothing but words."""
    return tuple(Finding("note", None, {}, text) for text in texts)


BROAD = Spectrum((0.98, 1.0, 1.02), (0.25, 0.5, 0.25))


CUT = Rim(
    cuts=(Diaphragm(7, 0.1, 0.3), Circle(0.4, 1.2, 0.5)),
    uneven=(0.01, 0.0, 0.0, 0.0),
    obstructed=0.04,
)
"""A pupil that lacks nothing that pupils may have."""


COMMON = CommonNumbers(
    ("waves.R.5", "f_number"),
    np.array([0.03, 2.874]),
    np.array([[1.44e-6, 1e-6], [1e-6, 1.21e-4]]),
    {"f-number": StatedNumber(2.8, 0.084, np.array([0.0001, 0.002]))},
)


GEOMETRY = ImageGeometry(
    Distortion(
        Uncertain(9e-4, 1e-6, "/mm²"),
        Uncertain(-2e-6, 1e-7, "/mm⁴"),
        (np.array([255.0, 384.5]), np.diag([0.09, 0.04])),
        0.006,
    ),
    {"B": LateralColour(Uncertain(1.8e-4, 2e-6), np.array([0.02, -0.01]), np.eye(2) / 1e4)},
)


def full_results() -> Results:
    """Results that hold everything that results can hold."""
    others = (OtherOptimum(np.array([0.0751, 0.03, -0.04]), 120.0),)
    left = ResidualSpectrum(
        np.array([0.1, 0.4]), np.array([1.2, 1.0]), np.array([1.5, 1.1])
    )
    test = replace(ACCEPTED, undetermined=("mode 4",), others=others)
    return some_results(
        wavefronts=(
            a_wavefront(
                test=test,
                missing=("low_pass_filter",),
                spectrum=BROAD,
                residual_spectrum=left,
                rim=CUT,
                tile=(0, 1),
                pulls=np.array([0.5, -1.25, 2.0]),
            ),
            a_wavefront(
                channel="B",
                defocus=0.09,
                test=test,
                spectrum=BROAD,
                rim=CUT,
                tile=(0, 1),
                pulls=np.array([-0.5, 0.0, 1.0]),
            ),
        ),
        plan=PLAN.replace(
            channel=[
                {"name": "R", "wavelength_nm": 650.0},
                {"name": "B", "wavelength_nm": 450.0, "light": "led-panel"},
            ]
        ),
        common=COMMON,
        field=a_field(
            frame=FieldFrame((512, 768), PLAN.sensor.pixel_pitch_um),
            scale_std=(0.003,),
            rim=FieldRim(Rim(obstructed=0.1), Vignetting(0.5, 0.01, 0.0, 1.1), (0.02, 0.0)),
        ),
        geometry=GEOMETRY,
        joint={"focal_length_mm": 0.1},
        made_from=MadeFrom("0" * 64, "1" * 64, ranges_mm=(3000.0,), patience_s=120.0),
        model_parts={
            "low_pass_filter.spread_px": Uncertain(0.55, 0.01, "px"),
            "blades_7.turn_deg": Uncertain(5.7, 0.4, "deg"),
            "blades_7.roundness": Uncertain(0.3, 0.02),
            "uneven_rim.cosine_2": Uncertain(0.01, 0.001),
            "uneven_rim.sine_2": Uncertain(0.0, 0.001),
            "cats_eye.shift": Uncertain(0.4, 0.001),
            "cats_eye.radius": Uncertain(1.2, 0.001),
            "cats_eye.direction_deg": Uncertain(28.6, 0.1, "deg"),
        },
        parts_tried=(PartTried("low_pass_filter", 120.0, adopted=True),),
        widest_light_nm={"G": 20.0},
    )


def written(folder: Path, **changed: Any) -> Path:
    """A session's results folder with some results in it."""
    place = folder / "session" / "results" / "latest"
    some_results(**changed).write(place)
    return place
