"""The bench's own optics against poppy, closed forms and published values."""

from __future__ import annotations

from dataclasses import replace

import astropy.units as u
import numpy as np
import poppy
import pytest
from scipy.special import j0, j1

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.optics import (
    defocus_waves,
    farthest_ray_um,
    halo_beyond,
    noll_to_nm,
    point_spread,
    working_f_number,
    zernike,
)
from labkit.drivers.simulated.scene import carry
from labkit.drivers.simulated.view import cone
from labkit.drivers.simulated.world import BenchSettings, TrueLens, TruePose, TrueRail
from labkit.types import Floats


@pytest.mark.parametrize("j", range(1, 46))
def test_modes_are_nolls_as_poppy_has_them(j: int) -> None:
    y, x = np.meshgrid(*2 * [np.linspace(-0.7, 0.7, 41)], indexing="ij")
    theirs = poppy.zernike.zernike1(
        j, rho=np.hypot(x, y), theta=np.arctan2(y, x), outside=0.0
    )
    np.testing.assert_allclose(zernike(j, x, y), theirs, atol=1e-12)


def test_noll_4_to_11_have_the_orders_of_nolls_table() -> None:
    assert [noll_to_nm(j) for j in range(4, 12)] == [
        (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("range_mm", "waves"), [(3013.2, 0.07484), (3200.0, 1.06783), (3300.0, 1.55325)]
)
def test_defocus_against_range_has_the_published_values(
    range_mm: float, waves: float
) -> None:
    assert defocus_waves(range_mm, 3000.0, 70.0, 2.8, 0.985) == pytest.approx(
        waves, abs=1e-5
    )


def test_the_farthest_ray_has_the_slope_of_noll_at_the_rim() -> None:
    # the slope of sqrt(3) (2 r^2 - 1) is 4 sqrt(3) r, that of sqrt(8) (3 r^3 - 2 r) along x 7 sqrt(8) at r = 1
    for rim in (1.0, 1.1):
        assert farthest_ray_um({4: 0.5}, 4.0, rim, 500.0) == pytest.approx(
            2 * 4.0 * 0.5 * 4 * np.sqrt(3) * rim * 0.5, rel=1e-6
        )
    assert farthest_ray_um({8: 1.0}, 1.0, 1.0, 1000.0) == pytest.approx(
        2 * 7 * np.sqrt(8), rel=1e-6
    )


def test_light_is_followed_as_far_as_a_strong_wavefront_throws_it() -> None:
    settings = replace(BenchSettings(), halo_um=100.0)
    weak, strong = (
        Bench(replace(settings, lens=TrueLens(noll=(37,), aberration_waves=waves))).view
        for waves in (0.05, 1.0)
    )
    assert weak.reach_um() == 100.0
    assert weak.reach_um(150.0) == 150.0
    # Noll 37, sqrt(9) R(8, 0), has the slope 3 * 40 at the rim
    waves = strong.waves("G")
    assert abs(waves[37]) == pytest.approx(1.0)
    at_rim = 120 * waves[37] + 4 * np.sqrt(3) * waves[4]
    assert strong.reach_um() == pytest.approx(
        2 * 2 * cone(strong.settings.lens) * abs(at_rim) * 0.45, rel=0.05
    )


def test_a_perfect_lens_shows_airys_disc() -> None:
    psf = point_spread({}, 550.0, 4.0, 0.5, 400)
    r = np.hypot(*np.meshgrid(*2 * [np.arange(-400, 401) * 0.5])) / (0.55 * 4.0)
    r[400, 400] = 1e-9
    airy = (
        (2 * j1(np.pi * r) / (np.pi * r)) ** 2 * np.pi / 4 * (0.5 / (0.55 * 4.0)) ** 2
    )  # unit integral
    assert np.abs(psf - airy).sum() < 1.6e-7  # 8.5e-8 as measured
    # what is beyond 200 um is 0.2 %; out to 2 mm all of it but a tenth
    halo = halo_beyond(550.0, 4.0, 0.5, 400, 10, 400)
    tenth = (1 - airy.sum()) / 10
    assert psf.sum(dtype=float) + halo.sum(dtype=float) == pytest.approx(
        1 - tenth, abs=7e-7
    )


def test_a_defocused_psf_is_as_bright_as_hankels_transform_has_it() -> None:
    wavelength_um, f_number, spacing_um, waves, reach = 0.54, 7.7, 0.533, 0.7, 656
    psf = point_spread({4: waves}, 1e3 * wavelength_um, f_number, spacing_um, reach)[
        reach, reach:
    ]
    rho, weight = (np.polynomial.legendre.leggauss(400)[k] / 2 for k in (0, 1))
    rho += 0.5
    pupil = (
        2
        * weight
        * rho
        * np.exp(2j * np.pi * waves * 0.45 / wavelength_um * np.sqrt(3) * (2 * rho**2 - 1))
    )
    airy_um = wavelength_um * f_number
    r = (
        np.arange(75) * spacing_um
    )  # out to the geometric rim, 4 times the waves peak to valley in lambda N
    light = (
        np.abs(j0(np.pi * r[:, None] / airy_um * rho) @ pupil) ** 2
        * np.pi
        / 4
        * (spacing_um / airy_um) ** 2
    )
    assert np.abs(psf[:75] - light).max() < 3e-7 * light.max()  # 1.5e-7 as measured


def test_an_aberrated_psf_is_poppys_in_its_orientation_too() -> None:
    waves = {4: 0.6, 5: 0.05, 7: 0.08, 8: -0.05, 9: 0.04, 11: 0.03}
    wavelength_nm, f_number, spacing_um, reach = 600.0, 2.8, 0.6, 60
    ours = point_spread(waves, wavelength_nm, f_number, spacing_um, 400)[340:461, 340:461]
    coefficients = [0.0, 0, 0, *(waves.get(j, 0.0) * 450e-9 for j in range(4, 12))]
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(poppy.ZernikeWFE(radius=1.0, coefficients=coefficients))
    scale = np.degrees(spacing_um * 1e-6 / (f_number * 2.0)) * 3600
    system.add_detector(
        pixelscale=scale * u.arcsec / u.pixel, fov_pixels=2 * reach + 1, oversample=1
    )
    # poppy's light goes against the slope of the path (it writes the inverse transform): turn it by 180 degrees
    theirs = system.calc_psf(wavelength=wavelength_nm * 1e-9)[0].data[::-1, ::-1]
    assert np.abs(ours / ours.sum() - theirs / theirs.sum()).sum() < 3e-3


@pytest.mark.parametrize(("mode", "axis"), [(2, 1), (3, 0)])
def test_a_path_that_grows_to_the_right_or_down_throws_light_there(
    mode: int, axis: int
) -> None:
    # Z2 = 2 u, Z3 = 2 v: half a wave RMS is two waves across the pupil, which tilt the light by 2 lambda N
    psf = point_spread({mode: 0.5}, 500.0, 4.0, 0.5, 40, reference_nm=500.0)
    expected = [40, 40]
    expected[axis] += round(2 * 0.5 * 4.0 / 0.5)
    assert list(np.unravel_index(psf.argmax(), psf.shape)) == expected


def test_a_grid_too_coarse_for_the_light_is_refused() -> None:
    with pytest.raises(ValueError, match="too coarse"):
        point_spread({}, 450.0, 1.4, 0.6, 50)


def gap(mm: float) -> Floats:
    return np.array([[1.0, mm], [0.0, 1.0]])


def thin(focal_mm: float) -> Floats:
    return np.array([[1.0, 0.0], [-1 / focal_mm, 1.0]])


FRONT, BACK = gap(15.0) @ thin(90.0), thin(120.0) @ gap(24.0)
STOP_MM = 9.0
"""Radius of the stop that stands between a lens of 90 mm, 15 mm before it, and one of 120 mm, 24 mm behind it."""


def two_lenses() -> tuple[float, float, float, float]:
    """Focal length, f-number at infinity, pupil magnification, and how far the front principal plane lies behind the
    first lens, mm: of rays (height, angle) through both lenses, and from the stop outwards."""
    (_, _), (c, d) = BACK @ FRONT
    focal_mm, principal_mm = -1 / c, (d - 1) / c
    entrance_mm, exit_mm = (
        STOP_MM / FRONT[0, 0],
        STOP_MM / BACK[1, 1],
    )  # radii of the pupils
    behind_mm = (
        FRONT[0, 1] / FRONT[0, 0]
    )  # of the first lens, by so much: rays to there go through the stop's centre
    assert behind_mm == pytest.approx(
        principal_mm - focal_mm + focal_mm * entrance_mm / exit_mm
    )
    return focal_mm, focal_mm / (2 * entrance_mm), exit_mm / entrance_mm, principal_mm


def test_cone_and_scale_are_those_of_rays_through_two_lenses_and_a_stop() -> None:
    focal_mm, f_number, pupils, principal_mm = two_lenses()
    best_mm, range_mm = 800.0, 700.0
    whole = BACK @ FRONT @ gap(best_mm - principal_mm)
    sensor = gap(
        -whole[0, 1] / whole[1, 1]
    )  # where rays from the axis at best focus meet again
    angle = (
        STOP_MM / (FRONT @ gap(best_mm - principal_mm))[0, 1]
    )  # of the ray that just passes the stop
    cone = 1 / (2 * abs((sensor @ whole @ [0, angle])[1]))
    assert working_f_number(f_number, best_mm, focal_mm, pupils) == pytest.approx(
        cone, rel=1e-12
    )

    to_stop = FRONT @ gap(range_mm - principal_mm)
    chief = np.array(
        [1.0, -to_stop[0, 0] / to_stop[0, 1]]
    )  # from 1 mm off the axis through the stop's centre
    scale = abs((sensor @ BACK @ FRONT @ gap(range_mm - principal_mm) @ chief)[0])
    lens = TrueLens(focal_mm, f_number, pupils, {"G": 550.0}, {"G": best_mm})
    assert millimetre_px(lens, range_mm) * 4.78e-3 == pytest.approx(scale, rel=1e-12)


def millimetre_px(
    lens: TrueLens, range_mm: float, tape_error_mm: float = 0.0, colour: str = "G"
) -> float:
    """How many pixels of the bench's picture a millimetre of a target spans that faces the camera squarely."""
    rail = TrueRail(range_at_zero_mm=range_mm, tape_error_mm=tape_error_mm, scatter_mm=0)
    bench = Bench(replace(BenchSettings(), lens=lens, rail=rail, pose=TruePose(0, 0, 0, 0)))
    right, _ = carry(
        bench.view.to_pixels(bench.view.lateral(colour)), np.array([0.0, 1.0]), np.zeros(2)
    )
    return float(right[1] - right[0])


def test_a_target_at_best_focus_is_as_large_as_its_image_wherever_the_pupils_stand() -> (
    None
):
    for pupils in (0.6, 1.0, 1.7):
        lens = TrueLens(
            pupil_magnification=pupils, best_focus_mm=dict.fromkeys("RGB", 500.0)
        )
        assert millimetre_px(lens, 500.0) == pytest.approx(
            70 / (500 - 70) / 4.78e-3, rel=1e-12
        )


def test_sizes_follow_the_distance_from_the_entrance_pupil_and_the_tape_errs() -> None:
    lens = TrueLens(pupil_magnification=0.7)
    near, far = millimetre_px(lens, 1000.0), millimetre_px(lens, 1100.0)
    assert 100 / (near / far - 1) == pytest.approx(1000 - 70 + 70 / 0.7, rel=1e-9)
    assert millimetre_px(lens, 1000.0, tape_error_mm=100.0) == far


def test_a_colour_may_be_larger_than_the_others() -> None:
    lens = TrueLens(lateral_colour={"B": 2e-4})
    assert millimetre_px(lens, 3000.0, colour="B") == pytest.approx(
        millimetre_px(lens, 3000.0) * 1.0002, rel=1e-12
    )
