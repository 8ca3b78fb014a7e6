"""Zernike modes, pupil, PSF and lens against poppy, closed forms and published values."""

from __future__ import annotations

from collections.abc import Callable

import astropy.units as u
import numpy as np
import poppy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import j1

from labkit.experiments.methods.shaded_aperture import disc_area
from labkit.optics.lens import ThinLens, circle_of_confusion_mm, defocus_waves
from labkit.optics.psf import Pupil, diffraction_mtf, smooth_disc
from labkit.optics.zernike import is_even, zernike
from labkit.types import Floats

EVERY_MODE = tuple(range(4, 16))


@pytest.mark.parametrize("j", range(1, 37))
def test_modes_are_nolls_as_poppy_has_them(j: int) -> None:
    y, x = np.meshgrid(*2 * [np.linspace(-0.7, 0.7, 31)], indexing="ij")
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    theirs = poppy.zernike.zernike1(j, rho=rho, theta=theta, outside=0.0)
    np.testing.assert_allclose(zernike(j, rho, theta), theirs, atol=1e-11)


@pytest.mark.parametrize(
    ("edge", "limits"),
    [(smooth_disc, (1e-7, 1.4e-6, 5e-6)), (disc_area, (5e-5, 2.5e-4, 1.6e-4))],
)
def test_the_transform_of_a_smooth_disc_is_airys_wherever_its_samples_lie(
    edge: Callable[[Floats, float], Floats], limits: tuple[float, ...]
) -> None:
    at = np.arange(-64.0, 65.0)
    for reach, limit in zip(
        (5.3, 10.7, 20.3), limits, strict=True
    ):  # in lambda N, of a window of about 121
        airy = 2 * j1(np.pi * reach) / (np.pi * reach)
        off = [
            (edge(at, radius) @ np.cos(np.pi * reach / radius * at)).sum()
            / (np.pi * radius**2)
            - airy
            for radius in np.linspace(60, 61, 11)
        ]
        assert limit / 10 < np.abs(off).max() < limit


def airy_share(spacing: float, reach: int) -> np.ndarray:
    """Airy's disc, share of the light on each sample; spacing in lambda N."""
    r = np.hypot(*np.meshgrid(*2 * [np.arange(-reach, reach) * spacing]))
    r[reach, reach] = 1e-9
    airy: np.ndarray = (2 * j1(np.pi * r) / (np.pi * r)) ** 2 * np.pi / 4 * spacing**2
    return airy


def test_a_perfect_lens_shows_airys_disc() -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 0.4 * 2.2, 500, (4,))
    difference = pupil.psf(np.zeros(1)) - airy_share(0.4, 250)
    # all of it near the border: the edge's kernel dims what lies there, and the window's copies overlap
    assert np.abs(difference).sum() < 1.3e-3
    assert np.abs(difference[150:350, 150:350]).sum() < 4e-5


@pytest.mark.parametrize(
    ("nu", "mtf"),
    [(0.1, 0.872889), (0.25, 0.685038), (0.5, 0.391002), (0.75, 0.144294), (0.9, 0.037386)],
)
def test_a_perfect_lens_has_the_published_mtf(nu: float, mtf: float) -> None:
    assert diffraction_mtf(np.array([nu]))[0] == pytest.approx(mtf, abs=6e-7)


@pytest.mark.parametrize("waves", [0.05, 0.2, 0.5, 1.0])
def test_the_axis_of_a_defocused_psf_follows_the_squared_sinc(waves: float) -> None:
    pupil = Pupil(0.45, 0.45, 4.0, 0.72, 600, (4,))
    strehl = pupil.psf(np.array([waves]))[300, 300] / pupil.psf(np.zeros(1))[300, 300]
    # peak to valley sqrt(12) RMS
    assert strehl == pytest.approx(np.sinc(np.sqrt(12) * waves) ** 2, abs=7e-8)


def test_an_aberrated_psf_is_poppys_in_its_orientation_too() -> None:
    waves = {4: 0.6, 5: 0.05, 7: 0.08, 8: -0.05, 9: 0.04, 11: 0.03}
    pupil = Pupil(0.6, 0.45, 2.8, 0.6, 800, tuple(waves))
    ours = pupil.psf(np.array(list(waves.values())))[340:461, 340:461]
    coefficients = [0.0, 0, 0, *(waves.get(j, 0.0) * 450e-9 for j in range(4, 12))]
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(poppy.ZernikeWFE(radius=1.0, coefficients=coefficients))
    scale = np.degrees(0.6e-6 / (2.8 * 2.0)) * 3600
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=121, oversample=1)
    # poppy's light goes against the slope of the path (it writes the inverse transform): turn it by 180 degrees
    theirs = system.calc_psf(wavelength=600e-9)[0].data[::-1, ::-1]
    assert np.abs(ours / ours.sum() - theirs / theirs.sum()).sum() < 3e-3


@pytest.mark.parametrize(("mode", "axis"), [(2, 1), (3, 0)])
def test_a_path_that_grows_to_the_right_or_down_throws_light_there(
    mode: int, axis: int
) -> None:
    # Z2 = 2 rho cos(theta) is x, Z3 is y: one wave RMS is four waves across the pupil, 4 lambda N
    psf = Pupil(0.5, 0.5, 4.0, 1.0, 128, (mode,)).psf(np.array([0.5]))
    peak = np.array(np.unravel_index(psf.argmax(), psf.shape)) - 64
    expected = np.zeros(2)
    expected[axis] = 2 * 0.5 * 4.0 / 1.0
    np.testing.assert_array_equal(peak, expected)


def test_psf_derivatives_are_finite_differences() -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 1.0, 96, EVERY_MODE)
    waves = np.random.default_rng(1).normal(0, 0.1, 12)
    slopes = pupil.psf_jacobian(waves)[1]
    for k, step in enumerate(1e-5 * np.eye(12)):
        difference = (pupil.psf(waves + step) - pupil.psf(waves - step)) / 2e-5
        assert np.abs(slopes[k] - difference).max() < 1e-6 * np.abs(slopes).max()


def test_slopes_in_single_precision_are_the_jacobian() -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 1.0, 96, EVERY_MODE)
    waves = np.random.default_rng(1).normal(0, 0.1, 12)
    for slope, exact in zip(
        pupil.psf_slopes(waves), pupil.psf_jacobian(waves)[1], strict=True
    ):
        assert slope.dtype == np.float32
        assert np.abs(slope - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("waves", "says"),
    [
        (
            [0.1],
            r"waves has shape \(1,\); \(2,\) is needed \(waves RMS, one for each mode\)",
        ),
        (
            [0.1, np.nan],
            r"waves, shape \(2,\): 1 of 2 values are not finite \(waves RMS, one for each mode\)",
        ),
        (
            [0.1, 1j],
            r"waves: real numbers are needed \(waves RMS, one for each mode\), not complex128",
        ),
    ],
)
def test_a_wavefront_that_is_none_is_refused(waves: list[complex], says: str) -> None:
    pupil = Pupil(0.55, 0.45, 4.0, 1.0, 64, (4, 5))
    for use in (pupil.psf, pupil.psf_jacobian):
        with pytest.raises(ValueError, match=says):
            use(np.array(waves))


@settings(max_examples=20)
@given(st.lists(st.floats(-0.5, 0.5), min_size=12, max_size=12))
def test_the_twin_has_the_same_psf(waves: list[float]) -> None:
    pupil = Pupil(0.5, 0.5, 4.0, 1.0, 64, EVERY_MODE)
    twin = [-w if is_even(j) else w for j, w in zip(EVERY_MODE, waves, strict=True)]
    np.testing.assert_allclose(
        pupil.psf(np.array(twin)), pupil.psf(np.array(waves)), atol=1e-12
    )


@pytest.mark.parametrize(
    ("range_mm", "corrected", "thesis"),
    [(3013.2, 0.07484, 0.07049), (3200.0, 1.06783, 1.00566), (3300.0, 1.55325, 1.46279)],
)
def test_defocus_against_range_has_the_published_values(
    range_mm: float, corrected: float, thesis: float
) -> None:
    lens = ThinLens(70.0, 2.8, 0.985)
    assert defocus_waves(lens, range_mm, 3000.0, 450.0) == pytest.approx(
        corrected, abs=6e-6
    )
    assert defocus_waves(lens, range_mm, 3000.0, 450.0, "thesis") == pytest.approx(
        thesis, abs=6e-6
    )


def test_the_blur_of_a_point_is_the_slope_of_its_defocus() -> None:
    # transverse ray aberration at the pupil's edge: f/# times the slope of PV rho^2, so diameter = 8 N' PV
    lens = ThinLens(70.0, 16.0, 0.985)
    path_mm = defocus_waves(lens, 3050.0, 3000.0, 450.0) * np.sqrt(12) * 450e-6
    working = lens.pupil_to_image_mm(3000.0) / lens.exit_pupil_mm
    # corrections: NA^2 and the relative change of the image distance, each about 1e-3
    assert circle_of_confusion_mm(lens, 3050.0, 3000.0) == pytest.approx(
        8 * working * path_mm, rel=3e-3
    )


def test_a_lens_in_another_colour_has_the_same_sensor_and_aperture() -> None:
    lens, best_mm, other_mm = ThinLens(39.1, 7.47, 1.14), 523.3, 544.3
    other = lens.in_colour(other_mm, best_mm)
    assert other.focal_length_mm == pytest.approx(
        1 / (1 / 39.1 - 1 / best_mm + 1 / other_mm), rel=1e-12
    )
    assert other.exit_pupil_mm == pytest.approx(lens.exit_pupil_mm, rel=1e-12)
    assert other.image_distance_mm(other_mm) == pytest.approx(
        lens.image_distance_mm(best_mm), rel=1e-12
    )
    # defocus is told by the entrance pupil alone, about; the cone by the sensor, which the law of one focal length would move
    assert defocus_waves(other, 687.3, other_mm, 450.0) == pytest.approx(
        defocus_waves(lens, 687.3, other_mm, 450.0), rel=1e-4
    )
    cone = (
        lens.image_distance_mm(best_mm) + 0.14 * other.focal_length_mm
    ) / lens.exit_pupil_mm
    assert other.working_f_number(other_mm) == pytest.approx(cone, rel=1e-12)
    assert lens.working_f_number(other_mm) / cone - 1 == pytest.approx(-0.0031, abs=1e-4)


def test_working_f_number_and_scale_are_those_of_rays_through_two_lenses_and_a_stop() -> (
    None
):
    """Paraxial rays (height, angle) traced by matrices through f1 | stop | f2; pupils are images of the stop."""
    f1, f2, first, second, stop_mm = (
        90.0,
        160.0,
        12.0,
        25.0,
        14.0,
    )  # lengths before and behind the stop, its radius

    def gap(d: float) -> NDArray[np.float64]:
        return np.array([[1, d], [0, 1]])

    def thin(f: float) -> NDArray[np.float64]:
        return np.array([[1, 0], [-1 / f, 1]])

    before, behind = gap(first) @ thin(f1), thin(f2) @ gap(second)
    (a, _), (c, d) = system = behind @ before
    f, front, back = (
        -1 / c,
        (d - 1) / c,
        (1 - a) / c,
    )  # principal planes: from the first lens, from the second
    assert np.linalg.det(system) == pytest.approx(1)
    entrance = (
        stop_mm / before[0, 0]
    )  # a ray parallel to the axis that meets the stop's rim
    exit_ = (
        stop_mm / behind[1, 1]
    )  # one that leaves parallel to the axis, from the stop's rim
    lens = ThinLens(f, f / (2 * entrance), exit_ / entrance)
    focus, target = 700.0, 650.0  # from the front principal plane
    sensor = lens.image_distance_mm(focus) + back  # from the second lens
    onto_sensor = gap(float(sensor)) @ system @ gap(focus - front)
    assert onto_sensor[0, 1] == pytest.approx(0, abs=1e-9)  # an image
    rim = (
        stop_mm / (before @ gap(focus - front))[0, 1]
    )  # angle of the ray from the axis to the stop's rim
    cone = abs((system @ gap(focus - front) @ [0, rim])[1])
    assert lens.working_f_number(focus) == pytest.approx(1 / (2 * cone), rel=1e-9)
    to_first = before @ gap(target - front)
    chief = (
        -to_first[0, 0] / to_first[0, 1]
    )  # angle of the ray of unit height through the stop's middle
    height = (gap(float(sensor)) @ system @ gap(target - front) @ [1, chief])[0]
    assert lens.chief_ray_scale(target, focus) == pytest.approx(-height, rel=1e-9)
    assert lens.chief_ray_scale(focus, focus) == pytest.approx(
        lens.focused_magnification(focus), rel=1e-12
    )
