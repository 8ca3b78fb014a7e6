"""Optical numbers in light of several wavelengths, against poppy, closed forms and finite differences."""

from __future__ import annotations

from dataclasses import replace

import astropy.units as u
import numpy as np
import poppy
import pytest
from scipy.special import j0, j1

from labkit.optics.encircled_energy import encircled_energy
from labkit.optics.metrics import psf_value
from labkit.optics.mtf import mtf
from labkit.optics.psf import diffraction_mtf
from labkit.optics.spectrum import Spectrum
from labkit.optics.strehl import strehl
from labkit.optics.through_focus import mtf_through_focus, strehl_through_focus
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Floats
from tests.physics import test_metrics
from tests.physics.test_metrics import Number

NOLL = tuple(range(4, 12))
MIXED = np.array([0.3, 0.05, -0.04, 0.06, -0.03, 0.02, 0.03, 0.05])
N, UM, REFERENCE_UM = 2.8, 0.6, 0.45
LIGHT = Spectrum((0.94, 1.0, 1.08), (0.3, 0.5, 0.2))


def fitted(
    waves: Floats, covariance: Floats | None = None, noll: tuple[int, ...] = NOLL
) -> FittedWavefront:
    waves = np.asarray(waves, float)
    covariance = 1e-6 * np.eye(len(waves)) if covariance is None else covariance
    return FittedWavefront(
        noll[: len(waves)],
        waves,
        covariance,
        1e3 * UM,
        1e3 * REFERENCE_UM,
        N,
        spectrum=LIGHT,
    )


PERFECT = fitted(np.zeros(8))


@pytest.fixture(scope="module")
def theirs() -> Floats:
    """poppy's PSF of MIXED, 0.6 um apart, 401 x 401; its axes are turned to ours as test_optics explains."""
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(
        poppy.ZernikeWFE(
            radius=1.0, coefficients=[0.0, 0, 0, *(MIXED * REFERENCE_UM * 1e-6)]
        )
    )
    scale = np.degrees(0.6e-6 / (N * 2.0)) * 3600
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=401, oversample=1)
    lines = {
        "wavelengths": [node * UM * 1e-6 for node in LIGHT.nodes],
        "weights": list(LIGHT.weights),
    }
    image: Floats = np.asarray(system.calc_psf(source=lines)[0].data[::-1, ::-1], float)
    return np.asarray(image / image.sum())


def test_a_psf_is_poppys_of_the_same_lines(theirs: Floats) -> None:
    shown = theirs[140:261, 140:261] / theirs[140:261, 140:261].sum()
    assert (
        np.abs(psf_value(fitted(MIXED), 0.6, 121) - shown).sum() < 3e-3
    )  # 1.5e-3 measured
    alone = psf_value(replace(fitted(MIXED), spectrum=Spectrum()), 0.6, 121)
    assert np.abs(alone - shown).sum() > 0.025  # 0.050 measured


@pytest.mark.parametrize(("direction", "axis"), [("x", 0), ("y", 1)])
def test_mtfs_are_those_of_poppys_psf(direction: str, axis: int, theirs: Floats) -> None:
    frequency = np.fft.rfftfreq(401, 0.6e-3)[4:140:9]
    transform = np.abs(np.fft.rfft(theirs.sum(axis=axis)))[4:140:9]
    # 0.3 % of the light lies beyond poppy's window; in one wavelength up to 0.005 off
    curve = mtf(fitted(MIXED), frequency, direction)  # type: ignore[arg-type]
    np.testing.assert_allclose(curve.value, transform, atol=4e-3)


@pytest.mark.parametrize(
    ("waves", "most"), [(0.0, 8e-4), (1.2, 1.6e-3), (2.0, 5.4e-3)]
)  # half of each measured
def test_a_few_wavelengths_stand_for_a_spectrum_40_nm_broad(
    waves: float, most: float
) -> None:
    nm = np.linspace(480, 600, 41)
    weights = np.exp(-(((nm - 540) / 17) ** 2) / 2)
    lines = Spectrum(tuple(nm / 540), tuple(weights / weights.sum()))
    few = Spectrum.of_samples(nm.tolist(), weights.tolist(), 540.0)
    aberrated = FittedWavefront(
        NOLL,
        np.array([waves, *MIXED[1:]]),
        np.zeros((8, 8)),
        540.0,
        1e3 * REFERENCE_UM,
        3.6,
    )
    true, ours = (
        psf_value(replace(aberrated, spectrum=light), 0.5, 161) for light in (lines, few)
    )
    assert np.abs(ours - true).sum() < most


def test_a_perfect_lens_has_the_sums_of_closed_forms() -> None:
    frequency, radius = np.linspace(0, 680, 20), np.array([0.0, 0.5, 2.05, 30.0])
    airy_um = [(share, node * UM * N) for share, node in LIGHT.shares]
    expected = sum(
        share * diffraction_mtf(frequency * airy * 1e-3) for share, airy in airy_um
    )
    np.testing.assert_allclose(mtf(PERFECT, frequency, 33.0).value, expected, atol=1e-13)
    assert mtf(PERFECT, PERFECT.cutoff_per_mm * 0.999, "x").value > 0
    assert mtf(PERFECT, PERFECT.cutoff_per_mm * 1.001, "x").value == 0
    arguments = [(share, np.pi * radius / airy) for share, airy in airy_um]
    energy = sum(share * (1 - j0(v) ** 2 - j1(v) ** 2) for share, v in arguments)
    np.testing.assert_allclose(encircled_energy(PERFECT, radius).value, energy, atol=1e-12)
    assert strehl(PERFECT).value == pytest.approx(1, abs=1e-12)


def test_the_strehl_ratio_of_defocus_is_a_sum_of_squared_sincs_over_squared_wavelengths() -> (
    None
):
    waves = 0.15
    lights = [
        (share / node**2, np.sqrt(12) * waves * REFERENCE_UM / (node * UM))
        for share, node in LIGHT.shares
    ]
    expected = sum(height * np.sinc(across) ** 2 for height, across in lights) / sum(
        height for height, _ in lights
    )
    assert strehl(fitted(np.array([waves]))).value == pytest.approx(expected, abs=1e-10)


def test_through_focus_each_point_is_that_of_the_defocus() -> None:
    wavefront, defocus = fitted(MIXED), np.array([-0.2, 0.0, 0.25])
    ratios = strehl_through_focus(wavefront, defocus).value
    modulation = mtf_through_focus(wavefront, 120.0, 20.0, defocus).value
    for k, waves in enumerate(defocus):
        there = fitted(np.array([waves, *MIXED[1:]]))
        assert ratios[k] == pytest.approx(strehl(there).value, abs=1e-9)
        assert modulation[k] == pytest.approx(
            float(mtf(there, 120.0, 20.0).value), abs=1e-7
        )


OF_ALL_LIGHT = ("psf", "mtf", "mtf50", "strehl", "radius_of_energy")
NUMBERS: dict[str, Number] = {name: test_metrics.NUMBERS[name] for name in OF_ALL_LIGHT} | {
    "mtf_through_focus": lambda w: (lambda c: (c.value, c.std))(
        mtf_through_focus(w, 80.0, "x", np.array([0.0, 0.2]))
    ),
    "strehl_through_focus": lambda w: (lambda c: (c.value, c.std))(
        strehl_through_focus(w, np.array([0.0, 0.1]))
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_standard_errors_are_slopes_times_the_errors_of_the_modes(name: str) -> None:
    test_metrics.assert_errors_are_slopes(NUMBERS[name], fitted, MIXED)
