"""What the mathematics is handed wrongly it names: argument, shape, unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.estimation.climb import NoisePrior, Problem, State, maximize
from labkit.estimation.identifiability import bound_of
from labkit.estimation.likelihood import Detector, FrameData, low_orders, predict
from labkit.estimation.residuals import judge
from labkit.experiments.methods.bounds import (
    bias_sensitivity,
    uniform_bound,
)
from labkit.experiments.methods.optimum_tests import (
    SignificanceTest,
    bootstrap,
    bootstrapped,
    rao_score,
)
from labkit.experiments.methods.psf_basis import PsfBasis, shipped_psf_basis
from labkit.experiments.methods.shaded_aperture import disc_area
from labkit.experiments.methods.strehl_candidates import (
    highest_on_shell,
    is_trivial,
    rotated,
    strehl,
    strehl_candidates,
)
from labkit.finder.find_target import find_target
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.lens import (
    ThinLens,
    circle_of_confusion_mm,
    defocus_waves,
    ground_sample_mm,
)
from labkit.optics.psf import Pupil, diffraction_mtf, smooth_disc
from labkit.optics.zernike import zernike
from labkit.target.target import CellTarget
from labkit.targets.slanted_edge import SlantedEdge

OPTICS = Optics(
    wavelength_nm=550.0,
    reference_nm=450.0,
    f_number=8.0,
    pitch_um=4.8,
    active_um=4.8,
    noll=(4, 6),
)
PUPIL = Pupil(0.55, 0.45, 8.0, 2.2, 32, (4, 6))
CELLS = CellTarget(np.eye(3), (2.0, 2.0))
EDGE = SlantedEdge(2.0, 5.0)
LENS = ThinLens(70.0, 2.8)
POSE = Pose.from_corners(np.array([[2.0, 2], [2, 9], [9, 9], [9, 2]]), (2.0, 2.0))
MODEL = ForwardModel.build(OPTICS, CELLS, (12, 14), POSE, window_airy=16.0)
DRAWING = MODEL.draw([POSE])
NOISE = NoisePrior(0.5, 0.01, 4.0, 0.02)
ONE, USED = np.ones((12, 14)), np.ones((12, 14), bool)
FRAME = FrameData(ONE, USED, ONE, 0 * ONE)
PROBLEM = Problem(MODEL, (FRAME,), NOISE)
STATE = State(np.zeros(2), (POSE,), np.array([100.0]), np.zeros(1), NOISE.centre)
GOOD = {1: np.ones(3), 2: np.eye(3)}

ARRAYS: dict[str, tuple[str, Any, Callable[[Any], object]]] = {
    # what is called: the argument, a good value of it, the call
    "zernike rho": ("rho", np.ones(3), lambda v: zernike(4, v, np.ones(3))),
    "zernike theta": ("theta", np.ones(3), lambda v: zernike(4, np.ones(3), v)),
    "disc_area": ("offsets", np.arange(-2.0, 3), lambda v: disc_area(v, 1.5)),
    "smooth_disc": ("offsets", np.arange(-4.0, 5), lambda v: smooth_disc(v, 2.5)),
    "psf": ("waves", np.ones(2), PUPIL.psf),
    "psf_jacobian": ("waves", np.ones(2), PUPIL.psf_jacobian),
    "pose": ("v", POSE.v, lambda v: Pose(v, (1.0, 1.0))),
    "corners": (
        "corners_px",
        POSE.corners_px(),
        lambda v: Pose.from_corners(v, (2.0, 2.0)),
    ),
    "means waves": ("waves", np.zeros(2), lambda v: MODEL.means(v, DRAWING, [USED])),
    "evaluate waves": ("waves", np.zeros(2), lambda v: MODEL.evaluate(v, DRAWING, [USED])),
    "cells y": ("y_mm", np.ones(3), lambda v: CELLS.sample(v, np.ones(2), 1.0)),
    "cells x": ("x_mm", np.ones(3), lambda v: CELLS.sample(np.ones(2), v, 1.0)),
    "edge y": ("y_mm", np.ones(3), lambda v: EDGE.sample(v, np.ones(2), 1.0)),
    "counts": ("counts", ONE, lambda v: FrameData(v, USED, ONE, ONE)),
    "illumination": ("illumination", ONE, lambda v: FrameData(ONE, USED, v, ONE)),
    "relative_std": ("relative_std", ONE, lambda v: FrameData(ONE, USED, ONE, v)),
    "departures": (
        "departures",
        low_orders(12, 14),
        lambda v: FrameData(ONE, USED, ONE, ONE, v),
    ),
    "state waves": ("waves", np.zeros(2), lambda v: replace(STATE, waves=v)),
    "state scales": ("scales", np.ones(1), lambda v: replace(STATE, scales=v)),
    "state ambients": ("ambients", np.ones(1), lambda v: replace(STATE, ambients=v)),
    "state noise": ("log_noise", np.ones(2), lambda v: replace(STATE, log_noise=v)),
    "bound_of": ("information", np.eye(3), lambda v: bound_of(v, "abc")),
    "uniform_bound": ("covariance", np.eye(3), lambda v: uniform_bound(v, 0, np.ones(1))),
    "uniform_bound norm": (
        "norm",
        np.eye(3),
        lambda v: uniform_bound(np.eye(3), 0, np.ones(1), v),
    ),
    "multipliers": ("multipliers", np.ones(3), lambda v: uniform_bound(np.eye(3), 0, v)),
    "bias_sensitivity": ("covariance", np.eye(3), lambda v: bias_sensitivity(v, 0)),
    "rao gradient": ("gradient", np.ones(3), lambda v: rao_score(v, np.eye(3))),
    "rao information": ("information", np.eye(3), lambda v: rao_score(np.ones(3), v)),
    "PSF basis": ("directions", np.ones((2, 3, 3)), PsfBasis),
    "bootstrapped": (
        "drawn",
        np.ones(3),
        lambda v: bootstrapped(SignificanceTest("any", 1.0, 1.0), v),
    ),
    "rotated": ("waves", np.ones(12), lambda v: rotated(v, 0.1)),
    "strehl": ("waves", np.ones(12), strehl),
    "highest_on_shell": ("start", np.ones(12), lambda v: highest_on_shell(v, 0.1)),
    "is_trivial": ("other", np.ones(12), lambda v: is_trivial(np.ones(12), v, 0.01)),
    "strehl_candidates": ("waves", np.ones(12), strehl_candidates),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_a_good_array_is_taken(case: str) -> None:
    _, good, call = ARRAYS[case]
    before = np.array(good)
    call(good)
    np.testing.assert_array_equal(good, before)  # and is left as it was


@pytest.mark.parametrize("flaw", ["shape", "dtype", "NaN"])
@pytest.mark.parametrize("case", ARRAYS)
def test_a_wrong_array_is_named_with_its_shape_and_unit(case: str, flaw: str) -> None:
    name, good, call = ARRAYS[case]
    bad = {
        "shape": np.ones((2, *good.shape, 2)),
        "dtype": np.full(good.shape, "a lot"),
        "NaN": np.full(good.shape, np.nan),
    }[flaw]
    if case == "zernike rho" and flaw == "shape":
        name = "theta"  # it is the other that no longer fits
    shown = good.shape if case == "zernike rho" and flaw == "shape" else bad.shape
    with pytest.raises(ValueError, match=rf"^{name}\b.*\(.+\)$") as caught:
        call(bad)
    assert str(shown) in str(caught.value)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda: NoisePrior(0.0, 0.01, 4.0, 0.02),
            r"gain = 0: a number above 0 is needed \(counts per electron\)",
        ),
        (
            lambda: NoisePrior(1.0, 0.01, np.nan, 0.02),
            r"read_variance = nan: .* \(counts\^2\)",
        ),
        (
            lambda: Optics(
                wavelength_nm=550.0,
                reference_nm=450.0,
                f_number=-8.0,
                pitch_um=4.8,
                active_um=4.8,
                noll=(4,),
            ),
            "f_number = -8",
        ),
        (
            lambda: Optics(
                wavelength_nm=np.nan,
                reference_nm=450.0,
                f_number=8.0,
                pitch_um=4.8,
                active_um=4.8,
                noll=(4,),
            ),
            r"wavelength_nm = nan: .* \(nm\)",
        ),
        (lambda: Pupil(0.55, 0.45, np.inf, 2.2, 32, (4,)), "f_number = inf"),
        (lambda: disc_area(np.zeros(1), 0.0), r"radius = 0: .* \(samples\)"),
        (lambda: diffraction_mtf(np.array([np.nan])), "frequency, shape"),
        (
            lambda: defocus_waves(LENS, np.array([np.nan, 500.0]), 500.0, 450.0),
            r"range_mm, shape \(2,\): 1 of 2",
        ),
        (lambda: defocus_waves(LENS, 600.0, 500.0, 0.0), "reference_nm = 0"),
        (
            lambda: circle_of_confusion_mm(LENS, 60.0, 500.0),
            "range must exceed the focal length, 70 mm",
        ),
        (lambda: ground_sample_mm(LENS, np.nan, 4.8), "range_mm"),
        (
            lambda: Pose.from_corners(np.zeros((4, 2)), (2.0, 2.0)),
            "no three may lie on a line",
        ),
        (lambda: FrameData(ONE, ONE, ONE, ONE), "used: a boolean mask of shape"),  # type: ignore[arg-type]
        (lambda: FrameData(ONE, ~USED, ONE, ONE), "no pixel of the frame is used"),
        (
            lambda: FrameData(ONE[0], USED, ONE, ONE),
            r"counts has shape \(14,\); \(rows, columns\) is needed \(counts\)",
        ),
        (
            lambda: MODEL.means(np.zeros(2), DRAWING, [USED[:5]]),
            r"used has shape \(5, 14\)",
        ),
        (
            lambda: MODEL.evaluate(np.zeros(2), MODEL.draw([POSE, POSE]), [USED]),
            "2 poses and 1 masks",
        ),
        (
            lambda: maximize(PROBLEM, replace(STATE, waves=np.zeros(3))),
            r"waves has shape \(3,\); \(2,\) is needed",
        ),
        (
            lambda: predict(np.ones(5), FRAME, Detector(1, 0, 1, 1)),
            r"relative has shape \(5,\); \(168,\) is needed",
        ),
        (lambda: judge(PROBLEM, STATE, []), "0 images .* for 1 frames"),
        (
            lambda: bootstrap(
                PROBLEM, STATE, lambda p, s: [0.0], np.random.default_rng(), 0
            ),
            "draws = 0",
        ),
        (lambda: PsfBasis(np.ones((1, 4, 4))), "an odd side is needed"),
        (lambda: shipped_psf_basis(17), "degrees = 17: 1 to 16"),
        (lambda: highest_on_shell(np.zeros(12), 0.1), "length of start = 0"),
        (lambda: find_target(np.ones(5), CELLS), r"image has shape \(5,\)"),
        (
            lambda: find_target(np.full((5, 5), "a"), CELLS),
            "image: real numbers are needed",
        ),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(
    call: Callable[[], object], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        call()


def test_what_is_not_used_may_be_anything() -> None:
    hole = np.where(np.arange(14) < 3, np.nan, ONE)
    frame = FrameData(hole, np.isfinite(hole), hole, hole)
    assert frame.used.sum() == np.isfinite(hole).sum() < hole.size
