"""Optical numbers of a fitted wavefront against closed forms, poppy, finite differences and drawn wavefronts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import astropy.units as u
import numpy as np
import poppy
import pytest
from astropy.io import fits
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import j0, j1

from labkit.optics.encircled_energy import (
    about_centroid,
    encircled_energy,
    radius_of_energy,
)
from labkit.optics.metrics import (
    astigmatism,
    coma,
    opd_map,
    peak_to_valley,
    psf,
    psf_difference,
    rms,
    trefoil,
)
from labkit.optics.mtf import azimuth_deg, mtf, mtf50, pixel_mtf, transfer_function
from labkit.optics.psf import Pupil, diffraction_mtf
from labkit.optics.strehl import strehl
from labkit.optics.wavefront import FittedWavefront, at_focus
from labkit.types import Floats

NOLL = tuple(range(4, 16))
MIXED = np.array(
    [0.2, 0.05, -0.04, 0.06, -0.03, 0.02, 0.03, 0.05, -0.01, 0.02, 0.01, -0.02]
)


def fitted(
    waves: Floats, covariance: Floats | None = None, noll: tuple[int, ...] = NOLL
) -> FittedWavefront:
    waves = np.asarray(waves, float)
    covariance = 1e-6 * np.eye(len(waves)) if covariance is None else covariance
    return FittedWavefront(noll[: len(waves)], waves, covariance, 600.0, 450.0, 2.8)


PERFECT = fitted(np.zeros(12))
CUTOFF = PERFECT.cutoff_per_mm
AIRY_UM = 0.6 * 2.8


def test_a_perfect_lens_has_the_closed_forms() -> None:
    nu, radius = np.linspace(0, 1.2, 25), np.array([0.0, 0.3, 1.0, 2.05, 30.0, 120.0])
    curve = mtf(PERFECT, nu * CUTOFF, 33.0)
    np.testing.assert_allclose(curve.value, diffraction_mtf(nu), atol=1e-13)
    v = np.pi * radius / AIRY_UM
    np.testing.assert_allclose(
        encircled_energy(PERFECT, radius).value, 1 - j0(v) ** 2 - j1(v) ** 2, atol=1e-12
    )
    half = brentq(lambda f: float(diffraction_mtf(np.array(f))) - 0.5, 0.1, 0.9)
    assert mtf50(PERFECT, "x").value == pytest.approx(half * CUTOFF, rel=1e-9)
    for share in (0.5, 0.9):
        at = brentq(lambda v, share=share: 1 - j0(v) ** 2 - j1(v) ** 2 - share, 0.5, 8)
        assert radius_of_energy(PERFECT, share).value == pytest.approx(
            at / np.pi * AIRY_UM, rel=1e-9
        )


@pytest.mark.parametrize("waves", [0.1, 0.5, 1.4])
def test_defocus_has_hopkins_mtf(waves: float) -> None:
    # H. H. Hopkins, Proc. R. Soc. Lond. A 231, 91 (1955): the phase across the overlap is linear in x
    phase = 2 * np.pi * 0.45 / 0.6 * waves * 2 * np.sqrt(3)
    for nu in (0.05, 0.3, 0.7):
        slope = phase * 4 * nu

        def chord(y: float, nu: float = nu, slope: float = slope) -> float:
            return float(2 * np.sin(slope * (np.sqrt(1 - y**2) - nu)) / slope / np.pi)

        top = np.sqrt(1 - nu**2)
        expected = abs(quad(chord, -top, top, limit=200)[0])
        assert mtf(fitted(np.array([waves])), nu * CUTOFF, "y").value == pytest.approx(
            expected, abs=1e-7
        )


def test_the_pupil_of_a_strong_wavefront_is_integrated_to_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waves = np.random.default_rng(6).normal(0, 0.04, 19)
    waves[0] = 1.0
    strong = FittedWavefront(
        tuple(range(4, 23)), waves, 1e-6 * np.eye(19), 600.0, 450.0, 2.8
    )
    frequency = np.linspace(0, CUTOFF, 12)
    curve = mtf(strong, frequency, 37.0)
    monkeypatch.setattr("labkit.optics.mtf.nodes_for", lambda wavefront: 150)
    finer = mtf(strong, frequency, 37.0)
    np.testing.assert_allclose(curve.value, finer.value, atol=2e-7)
    np.testing.assert_allclose(curve.std, finer.std, rtol=1e-5)


@pytest.fixture(scope="module")
def theirs() -> Floats:
    """poppy's PSF of MIXED, 0.6 um apart, 601 x 601; its axes are turned to ours as test_optics explains."""
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(
        poppy.ZernikeWFE(radius=1.0, coefficients=[0.0, 0, 0, *(MIXED * 450e-9)])
    )
    scale = np.degrees(0.6e-6 / (2.8 * 2.0)) * 3600
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=601, oversample=1)
    image: Floats = np.asarray(
        system.calc_psf(wavelength=600e-9)[0].data[::-1, ::-1], float
    )
    return np.asarray(image / image.sum())


def test_a_psf_is_poppys(theirs: Floats) -> None:
    ours = psf(fitted(MIXED), 0.6, 121)
    assert ours.value.sum() == pytest.approx(1, abs=1e-12)
    shown = theirs[240:361, 240:361] / theirs[240:361, 240:361].sum()
    assert np.abs(ours.value - shown).sum() < 3e-3  # 0.001 waves, thesis Appendix F


@pytest.mark.parametrize(("direction", "axis"), [("x", 0), ("y", 1)])
def test_mtfs_along_x_and_y_are_those_of_poppys_psf(
    direction: str, axis: int, theirs: Floats
) -> None:
    frequency = np.fft.rfftfreq(601, 0.6e-3)[5:200:15]
    transform = np.abs(np.fft.rfft(theirs.sum(axis=axis)))[5:200:15]
    # 0.2 % of the light lies beyond poppy's window, 107 lambda N; along x and y the curves differ by up to 0.13
    curve = mtf(fitted(MIXED), frequency, direction)  # type: ignore[arg-type]
    np.testing.assert_allclose(curve.value, transform, atol=4e-3)


def test_encircled_energy_is_that_of_poppys_psf(theirs: Floats) -> None:
    # coma throws the centroid 2 sqrt(8) lambda N away for each wave RMS, here in um; Noll 7 is along y, 8 along x
    away = np.sqrt(8) * 2 * 0.45 * 2.8 * MIXED[[NOLL.index(8), NOLL.index(7)]]
    header = fits.Header([("PIXELSCL", 0.6), ("OVERSAMP", 1)])
    share = poppy.measure_ee(
        fits.HDUList([fits.PrimaryHDU(theirs, header)]), center=tuple(300 + away / 0.6)
    )
    within = encircled_energy(fitted(MIXED), [6.0, 12.0, 24.0, 107 * AIRY_UM])
    # poppy counts whole pixels, 0.6 um wide, and nothing beyond its window
    np.testing.assert_allclose(
        within.value[:3] / within.value[3],
        [share(r) for r in (6.0, 12.0, 24.0)],
        atol=0.012,
    )


@pytest.mark.parametrize("mode", [2, 3])
def test_a_transfer_function_falls_in_phase_towards_the_light(mode: int) -> None:
    tilted = fitted(np.array([0.3]), noll=(mode,))
    # one wave RMS of tilt throws light 4 lambda N away, here in the longer wave: 0.3 * 4 * 0.45 um * 2.8
    for azimuth, away_um in (
        (0.0, 1.512 if mode == 2 else 0.0),
        (90.0, 1.512 if mode == 3 else 0.0),
    ):
        value = transfer_function(tilted, np.array([100.0]), azimuth)[0]
        assert np.angle(value[0]) == pytest.approx(-2 * np.pi * 0.1 * away_um, abs=1e-9)


def test_tangential_frequencies_point_along_the_radius_and_sagittal_across_it() -> None:
    assert azimuth_deg("tangential", (0.0, 5.0)) == azimuth_deg("x") == 0
    assert azimuth_deg("tangential", (5.0, 0.0)) == azimuth_deg("y") == 90
    assert azimuth_deg("sagittal", (3.0, 3.0)) == pytest.approx(-45)
    assert (azimuth_deg("tangential"), azimuth_deg("sagittal")) == (
        90,
        0,
    )  # on the axis: y and x
    # coma towards the field blurs along it: with m = 1 the tangential MTF is the lower
    comatic, field = fitted(np.array([0.15, 0.15]), noll=(7, 8)), (1.0, 1.0)
    assert (
        mtf(comatic, 150.0, "tangential", field).value
        < mtf(comatic, 150.0, "sagittal", field).value - 0.1
    )


def test_a_pixel_lets_the_transform_of_a_square_through() -> None:
    assert pixel_mtf(np.array([0.0, 50.0, 200.0]), 5.0, "x") == pytest.approx(
        [1, np.sin(np.pi / 4) / (np.pi / 4), 0], abs=1e-12
    )
    along = 50.0 / np.sqrt(2) * 5e-3
    assert pixel_mtf(50.0, 5.0, 45.0) == pytest.approx(
        (np.sin(np.pi * along) / (np.pi * along)) ** 2
    )


@pytest.mark.parametrize("waves", [0.02, 0.1, 0.2])
def test_the_strehl_ratio_of_defocus_is_a_squared_sinc(waves: float) -> None:
    # beyond a quarter of a wave the brightest place leaves the axis
    assert strehl(fitted(np.array([waves]))).value == pytest.approx(
        np.sinc(np.sqrt(12) * waves * 0.75) ** 2, abs=1e-10
    )


def test_small_aberrations_have_marechals_strehl_ratio() -> None:
    for seed in range(5):
        waves = np.random.default_rng(seed).normal(0, 0.01, 12)
        phase = 2 * np.pi * 0.75 * np.linalg.norm(waves)
        # what is left is of third order in the phase, and what the best tilt gains
        assert strehl(fitted(waves)).value == pytest.approx(
            np.exp(-(phase**2)), abs=float(phase**3)
        )


def test_the_strehl_ratio_is_the_highest_of_a_fine_psf_whatever_the_tilt() -> None:
    value = strehl(fitted(MIXED)).value
    fine = Pupil(0.6, 0.45, 2.8, AIRY_UM / 40, 9600, NOLL)
    at = AIRY_UM / 40 * np.arange(-60.0, 61.0)
    peak = fine.psf_at(MIXED, at)[0].max() / fine.psf_at(np.zeros(12), np.zeros(1))[0].max()
    # samples miss the peak by up to lambda N / 57: by (pi / 57)^2 / 4 = 8e-4 of it; the pupil's rim is counted to as much
    assert value == pytest.approx(peak, rel=2e-3)
    tilted = fitted(np.concatenate([[0.4, -0.3], MIXED]), 1e-6 * np.eye(14), (2, 3, *NOLL))
    assert strehl(tilted).value == pytest.approx(value, rel=1e-12)


def test_the_centroid_that_energy_is_encircled_about_stays_with_the_light() -> None:
    tilted = fitted(np.concatenate([[0.4, -0.3], MIXED]), 1e-6 * np.eye(14), (2, 3, *NOLL))
    assert encircled_energy(tilted, 3.0).value == pytest.approx(
        encircled_energy(fitted(MIXED), 3.0).value, abs=1e-12
    )
    centred, near = about_centroid(fitted(MIXED)), 1e-6 * CUTOFF
    for azimuth in (0.0, 90.0):  # the centroid is the slope of the phase at frequency 0
        phase = np.angle(transfer_function(centred, np.array([near]), azimuth)[0][0])
        assert abs(phase / (2 * np.pi * near)) < 1e-5 * AIRY_UM * 1e-3


def test_a_path_difference_map_is_poppys_and_has_the_rms() -> None:
    shown = opd_map(fitted(MIXED), 200)
    y, x = np.meshgrid(*2 * [(np.arange(200) - 99.5) / 100], indexing="ij")
    inside = np.hypot(x, y) <= 1
    theirs = (
        poppy.zernike.zernike1(j, rho=np.hypot(x, y), theta=np.arctan2(y, x)) for j in NOLL
    )
    expected = sum(
        (a * mode for a, mode in zip(MIXED, theirs, strict=True)), np.zeros_like(x)
    )
    np.testing.assert_array_equal(np.isnan(shown.value), ~inside)
    np.testing.assert_allclose(shown.value[inside], expected[inside], atol=1e-10)
    # squares along the rim count whole or not at all
    assert np.sqrt(np.nanmean(shown.value**2)) == pytest.approx(
        rms(fitted(MIXED)).value, rel=5e-3
    )
    assert np.nanmean(shown.std**2) == pytest.approx(
        12e-6, rel=0.02
    )  # unit RMS: the trace of the covariance


@pytest.mark.parametrize(
    ("mode", "factor"),
    [(4, np.sqrt(12)), (6, 2 * np.sqrt(6)), (8, 2 * np.sqrt(8)), (11, 1.5 * np.sqrt(5))],
)
def test_single_modes_have_their_peak_to_valley(mode: int, factor: float) -> None:
    wavefront = fitted(np.where(np.array(NOLL) == mode, 0.1, 0.0))
    assert peak_to_valley(wavefront).value == pytest.approx(0.1 * factor, rel=1e-3)
    assert peak_to_valley(wavefront, without=(mode,)).value == 0
    assert rms(wavefront).value == pytest.approx(0.1)


def test_modes_in_pairs_have_the_angle_of_their_greatest_path_difference() -> None:
    for of, n, turn in ((astigmatism, 2, 180), (coma, 1, 360), (trefoil, 3, 120)):
        directed = of(fitted(MIXED))
        modes = {2: (5, 6), 1: (7, 8), 3: (9, 10)}[n]
        alone = fitted(np.where(np.isin(NOLL, modes), MIXED, 0.0))
        theta = np.radians(np.arange(-180, 180, 0.5))
        path = alone.opd(np.cos(theta), np.sin(theta))
        highest = np.degrees(theta[path.argmax()])
        assert (
            directed.angle_deg.value - highest + turn / 2
        ) % turn - turn / 2 == pytest.approx(0, abs=0.3)
        assert directed.magnitude.value == pytest.approx(
            np.sqrt(np.mean(path**2) * 2 / (2 * (n + 1 if n > 1 else 4)))
        )


Number = Callable[[FittedWavefront], tuple[Floats | float, Floats | float]]

NUMBERS: dict[str, Number] = {
    "psf": lambda w: (lambda p: (p.value, p.std))(psf(w, 0.9, 15)),
    "mtf": lambda w: (lambda c: (c.value, c.std))(mtf(w, [20.0, 80.0, 200.0, 400.0], 20.0)),
    "mtf50": lambda w: (lambda n: (n.value, n.std))(mtf50(w, "y")),
    "strehl": lambda w: (lambda n: (n.value, n.std))(strehl(w)),
    "encircled_energy": lambda w: (lambda c: (c.value, c.std))(
        encircled_energy(w, [1.0, 4.0, 15.0])
    ),
    "radius_of_energy": lambda w: (lambda n: (n.value, n.std))(radius_of_energy(w, 0.7)),
    "opd_map": lambda w: (lambda m: (m.value[10:20, 10:20], m.std[10:20, 10:20]))(
        opd_map(w, 31)
    ),
    "rms": lambda w: (lambda n: (n.value, n.std))(rms(w)),
    "peak_to_valley": lambda w: (lambda n: (n.value, n.std))(peak_to_valley(w)),
    "coma": lambda w: (lambda n: (n.value, n.std))(coma(w).magnitude),
    "trefoil's angle": lambda w: (lambda n: (n.value, n.std))(trefoil(w).angle_deg),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_standard_errors_are_slopes_times_the_errors_of_the_modes(name: str) -> None:
    assert_errors_are_slopes(NUMBERS[name], fitted, MIXED)


def assert_errors_are_slopes(
    number: Number, fitted: Callable[..., FittedWavefront], waves: Floats
) -> None:
    """Of modes that err together, along one way. fitted: of waves and a covariance."""
    way, step = np.random.default_rng(7).normal(size=waves.size), 1e-4
    std = np.asarray(number(fitted(waves, np.outer(way, way) * 1e-10))[1])
    ends = [np.asarray(number(fitted(waves + sign * step * way))[0]) for sign in (1, -1)]
    slope = np.abs(ends[0] - ends[1]) / (2 * step)
    # the differences err by the third derivative; small slopes beside the largest are not compared digit by digit
    np.testing.assert_allclose(std / 1e-5, slope, rtol=2e-3, atol=2e-3 * slope.max())


@pytest.fixture(scope="module")
def covariance() -> Floats:
    root = np.random.default_rng(4).normal(size=(12, 12))
    return np.asarray(root @ root.T * 1e-6)


@pytest.mark.parametrize(
    ("name", "draws"),
    [
        ("mtf", 400),
        ("strehl", 150),
        ("rms", 1000),
        ("coma", 1000),
        ("trefoil's angle", 1000),
    ],
)
def test_standard_errors_are_the_spread_of_drawn_wavefronts(
    name: str, draws: int, covariance: Floats
) -> None:
    rng, number = np.random.default_rng(9), NUMBERS[name]
    drawn = np.array(
        [number(fitted(w))[0] for w in rng.multivariate_normal(MIXED, covariance, draws)]
    )
    # a standard deviation of n draws errs by 1/sqrt(2 n) of itself; allow three of them
    error = 3 / np.sqrt(2 * draws)
    np.testing.assert_allclose(
        np.asarray(number(fitted(MIXED, covariance))[1]), drawn.std(axis=0), rtol=error
    )


@pytest.mark.parametrize("waves", [np.zeros(12), MIXED])
def test_the_error_of_the_cone_enters_what_is_measured_in_lengths(waves: Floats) -> None:
    one = replace(fitted(waves, np.zeros((12, 12))), f_number_std=0.028)  # 1 %
    for number in (
        mtf50(one, "x"),
        radius_of_energy(one, 0.8),
    ):  # they scale with 1/N and N
        assert number.std == pytest.approx(0.01 * number.value, rel=1e-6)
    wider = replace(one, f_number=2.8 * 1.0001)
    modulation = mtf(one, [60.0, 150.0], "y"), mtf(wider, [60.0, 150.0], "y")
    energy = encircled_energy(one, [1.0, 4.0]), encircled_energy(wider, [1.0, 4.0])
    for before, after in (modulation, energy):
        np.testing.assert_allclose(
            before.std, 100 * np.abs(after.value - before.value), rtol=2e-3
        )


def test_mtf50_with_the_pixel_is_where_the_product_is_one_half() -> None:
    half = mtf50(fitted(MIXED), "x", active_um=5.0)
    curve, pixel = (
        mtf(fitted(MIXED), half.value, "x"),
        float(pixel_mtf(half.value, 5.0, "x")),
    )
    assert float(curve.value) * pixel == pytest.approx(0.5, abs=1e-9)
    moved = [
        mtf50(fitted(MIXED + 1e-5 * (np.arange(12) == mode)), "x", active_um=5.0).value
        for mode in range(12)
    ]
    slopes = (np.array(moved) - half.value) / 1e-5
    assert half.std == pytest.approx(1e-3 * float(np.linalg.norm(slopes)), rel=1e-2)


def test_images_of_very_different_cones_are_compared() -> None:
    wide = replace(PERFECT, f_number=1.0)
    there = psf_difference(PERFECT, wide)
    assert 1 < there < 2  # most of the light of f/1 is within the core of f/2.8
    assert there == psf_difference(wide, PERFECT)


def test_near_a_perfect_lens_errors_are_of_second_order_and_hold_the_bias(
    covariance: Floats,
) -> None:
    drawn = np.random.default_rng(2).multivariate_normal(np.zeros(12), covariance, 150)
    perfect = fitted(np.zeros(12), covariance)
    departure = np.array([strehl(fitted(w)).value for w in drawn]) - 1
    # of a sum of squares the mean square of 150 draws errs by some 8 %; what the best tilt gains back is of higher order
    assert strehl(perfect).std == pytest.approx(np.sqrt(np.mean(departure**2)), rel=0.15)
    lengths = np.linalg.norm(drawn, axis=1)
    assert rms(perfect).std == pytest.approx(np.sqrt(np.mean(lengths**2)), rel=0.15)
    assert coma(perfect).angle_deg.std == pytest.approx(360 / np.sqrt(12))


def test_the_wavefront_at_best_focus_lacks_defocus_and_its_error(
    covariance: Floats,
) -> None:
    focused = at_focus(fitted(MIXED, covariance))
    assert focused.noll == NOLL[1:]
    np.testing.assert_array_equal(focused.waves, MIXED[1:])
    np.testing.assert_array_equal(focused.covariance, covariance[1:, 1:])
    assert at_focus(focused).noll == focused.noll


def test_a_mode_that_the_data_leave_open_leaves_open_what_depends_on_it() -> None:
    covariance = 1e-6 * np.eye(12)
    covariance[0, 0] = np.inf
    wavefront = fitted(MIXED, covariance)
    for number in (
        rms(wavefront),
        strehl(wavefront),
        mtf50(wavefront, "x"),
        peak_to_valley(wavefront),
    ):
        assert np.isinf(number.std)
    assert coma(wavefront).magnitude.std == pytest.approx(1e-3, rel=0.01)
    unknown = replace(wavefront, covariance=np.full((12, 12), np.nan))
    for number in (
        rms(unknown),
        strehl(unknown),
        mtf50(unknown, "x"),
        coma(unknown).magnitude,
    ):
        assert np.isnan(number.std)
        assert np.isfinite(number.value)


def test_a_wavefront_without_modes_is_a_perfect_lens() -> None:
    none = fitted(MIXED).without(NOLL)
    assert (strehl(none).value, rms(none).value, peak_to_valley(none).value) == (1, 0, 0)
    assert mtf(none, 100.0, "x").value == pytest.approx(
        diffraction_mtf(np.array(100.0 / CUTOFF))
    )
    assert psf(none, 0.8, 5).value[2, 2] > 0.1
    assert opd_map(none, 5).value[2, 2] == 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: psf(PERFECT, 1.0, 20), "size = 20: an odd number"),
        (
            lambda: psf(PERFECT, 2.0),
            r"spacing_um = 2: at most lambda N is needed, here 1.68 um",
        ),
        (lambda: mtf(PERFECT, [np.nan], "x"), "frequency_per_mm, shape"),
        (
            lambda: mtf(PERFECT, 1.0, "radial"),  # type: ignore[arg-type]
            "direction 'radial': x, y, tangential, sagittal",
        ),
        (lambda: encircled_energy(PERFECT, -1.0), "radii are 0 or more"),
        (
            lambda: radius_of_energy(PERFECT, 0.999),
            "share = 0.999: above 0 and at most 0.99",
        ),
        (lambda: opd_map(PERFECT, 0), "samples = 0"),
        (
            lambda: coma(at_focus(PERFECT).without((8,))),
            "Noll mode 8 is not among the fitted: 5, 6, 7, 9",
        ),
        (
            lambda: fitted(np.zeros(2), noll=(4, 4)),
            r"noll = \(4, 4\): .* each is given once",
        ),
        (
            lambda: fitted(np.zeros(2), np.eye(3)),
            r"covariance has shape \(3, 3\); \(2, 2\) is needed",
        ),
        (lambda: fitted(np.zeros(2), np.array([[1.0, 2.0], [0.0, 1.0]])), "not symmetric"),
        (lambda: replace(PERFECT, f_number=0.0), "f_number = 0"),
    ],
)
def test_what_has_no_answer_is_refused_in_a_line(
    call: Callable[[], object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call()
