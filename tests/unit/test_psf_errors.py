"""The study's PSF errors: nothing but what a wavefront's own errors make of them."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.psf_errors import psf_chance, psf_errors
from benchmarks.random_sessions import draw
from labkit.drivers.simulated.optics import working_f_number
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.world import TrueLens, Truth, Visit
from labkit.results import Results, Wavefront
from labkit.types import Floats

NOLL = tuple(range(4, 12))
TRUE = np.array([0.3, 0.05, -0.08, 0.04, 0.1, -0.03, 0.02, 0.06])
LENS = TrueLens(wavelength_nm={"G": 540.0}, best_focus_mm={"G": 3000.0})
STD = 0.003
TRUTH = Truth(
    seed=1,
    best_focus_mm={"G": 3000.0},
    range_zero_mm=0.0,
    focal_length_mm=LENS.focal_length_mm,
    f_number=LENS.f_number,
    pupil_magnification=LENS.pupil_magnification,
    lateral_colour={},
    modes_waves={"G": dict(zip(NOLL[1:], TRUE[1:].tolist(), strict=True))},
    counts_per_electron=0.4,
    read_noise_counts=1.0,
    visits=(Visit(3100.0, 3100.0, 0.0, {"G": float(TRUE[0])}, ()),),
)


def results(waves: Floats) -> Results:
    """A session that found these modes."""
    cone = working_f_number(
        LENS.f_number, 3000.0, LENS.focal_length_mm, LENS.pupil_magnification
    )
    wavefront = Wavefront(
        range_mm=3100.0,
        measured_range_mm=3100.0,
        channel="G",
        wavelength_nm=540.0,
        reference_wavelength_nm=450.0,
        f_number=cone,
        noll=NOLL,
        waves=waves,
        covariance=STD**2 * np.eye(len(NOLL)),
        poses=np.zeros((1, 8)),
        gain=0.4,
        read_noise=1.0,
        chi2_per_pixel=1.0,
    )
    plan = draw(1, 0).plan
    return Results(plan=plan, plan_sha256="", wavefronts=(wavefront,), focus=None)


def test_the_true_wavefront_has_the_benchs_psf() -> None:
    ((error, stated),) = psf_errors(results(TRUE), LENS, TRUTH)
    assert error < 4e-6  # 2e-6 as measured: the bench and results share no code
    assert stated == pytest.approx(0.039, rel=0.02)


def test_errors_of_modes_make_psf_errors_as_large_as_stated() -> None:
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(12):
        drawn = TRUE + STD * rng.standard_normal(TRUE.size)
        ((error, stated),) = psf_errors(results(drawn), LENS, TRUTH)
        ratios.append(error / stated)
    # 0.83 as measured: what moves a PSF aside counts as pose
    assert np.mean(ratios) == pytest.approx(0.85, abs=0.2)


def test_a_pupil_that_the_fit_lacks_is_in_the_error() -> None:
    made = replace(LENS, pupil=Pupil(blades=5))
    ((error, stated),) = psf_errors(results(TRUE), made, TRUTH)
    assert error == pytest.approx(0.2, rel=0.2)
    assert error > 4 * stated


@pytest.mark.parametrize(("stds", "least", "most"), [(0.0, 0.0, 0.05), (8.0, 0.95, 1.0)])
def test_the_chance_of_a_psf_says_how_large_its_error_is(
    stds: float, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.psf_errors.DRAWS", 12)
    (wavefront,) = results(TRUE + stds * STD / TRUE.size**0.5).wavefronts
    assert least < psf_chance(wavefront, LENS, TRUTH, 1) < most
