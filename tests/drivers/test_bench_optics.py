"""The bench's own optics against poppy, closed forms and published values."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import poppy
import pytest
from scipy.special import j1

from labkit.drivers.simulated.optics import defocus_waves, noll_to_nm, point_spread, zernike


@pytest.mark.parametrize("j", range(1, 22))
def test_modes_are_nolls_as_poppy_has_them(j: int) -> None:
    y, x = np.meshgrid(*2 * [np.linspace(-0.7, 0.7, 41)], indexing="ij")
    theirs = poppy.zernike.zernike1(j, rho=np.hypot(x, y), theta=np.arctan2(y, x), outside=0.0)
    np.testing.assert_allclose(zernike(j, x, y), theirs, atol=1e-12)


def test_noll_4_to_11_have_the_orders_of_nolls_table() -> None:
    assert [noll_to_nm(j) for j in range(4, 12)] == [
        (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(("range_mm", "waves"), [(3013.2, 0.07484), (3200.0, 1.06783), (3300.0, 1.55325)])
def test_defocus_against_range_has_the_published_values(range_mm: float, waves: float) -> None:
    assert defocus_waves(range_mm, 3000.0, 70.0, 2.8, 0.985) == pytest.approx(waves, abs=1e-5)


def test_a_perfect_lens_shows_airys_disc() -> None:
    psf = point_spread({}, 550.0, 4.0, 0.5, 400)
    r = np.hypot(*np.meshgrid(*2 * [np.arange(-400, 401) * 0.5])) / (0.55 * 4.0)
    r[400, 400] = 1e-9
    airy = (2 * j1(np.pi * r) / (np.pi * r)) ** 2 * np.pi / 4 * (0.5 / (0.55 * 4.0)) ** 2  # unit integral
    assert psf.sum(dtype=float) == pytest.approx(1, abs=1e-6)
    # the energy beyond 200 um is 0.2 lambda N / r = 0.2 %, given back by the normalisation
    assert np.abs(psf - airy).sum() < 4e-3


def test_an_aberrated_psf_is_poppys_in_its_orientation_too() -> None:
    waves = {4: 0.6, 5: 0.05, 7: 0.08, 8: -0.05, 9: 0.04, 11: 0.03}
    wavelength_nm, f_number, spacing_um, reach = 600.0, 2.8, 0.6, 60
    ours = point_spread(waves, wavelength_nm, f_number, spacing_um, 400)[340:461, 340:461]
    coefficients = [0.0, 0, 0, *(waves.get(j, 0.0) * 450e-9 for j in range(4, 12))]
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(poppy.ZernikeWFE(radius=1.0, coefficients=coefficients))
    scale = np.degrees(spacing_um * 1e-6 / (f_number * 2.0)) * 3600
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=2 * reach + 1, oversample=1)
    # poppy's light goes against the slope of the path (it writes the inverse transform): turn it by 180 degrees
    theirs = system.calc_psf(wavelength=wavelength_nm * 1e-9)[0].data[::-1, ::-1]
    assert np.abs(ours / ours.sum() - theirs / theirs.sum()).sum() < 3e-3


@pytest.mark.parametrize(("mode", "axis"), [(2, 1), (3, 0)])
def test_a_path_that_grows_to_the_right_or_down_throws_light_there(mode: int, axis: int) -> None:
    # Z2 = 2 u, Z3 = 2 v: half a wave RMS is two waves across the pupil, which tilt the light by 2 lambda N
    psf = point_spread({mode: 0.5}, 500.0, 4.0, 0.5, 40, reference_nm=500.0)
    expected = [40, 40]
    expected[axis] += round(2 * 0.5 * 4.0 / 0.5)
    assert list(np.unravel_index(psf.argmax(), psf.shape)) == expected


def test_a_grid_too_coarse_for_the_light_is_refused() -> None:
    with pytest.raises(ValueError, match="too coarse"):
        point_spread({}, 450.0, 1.4, 0.6, 50)
