"""What is reported of wavefronts over pupils that are no clear discs, against discs, closed forms and sampled PSFs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j1

from labkit.optics.encircled_energy import encircled_energy, radius_of_energy
from labkit.optics.metrics import opd_map, peak_to_valley, psf_value, rms
from labkit.optics.mtf import mtf, mtf50, transfer_function, turning_transfer_function
from labkit.optics.rim import ROUND_RIM, Circle, Diaphragm, Rim
from labkit.optics.strehl import strehl
from labkit.optics.through_focus import mtf_through_focus
from labkit.optics.wavefront import FittedWavefront

NOLL = tuple(range(4, 16))
WAVES = 0.03 * np.random.default_rng(1).normal(size=12)
WAVES[0] = 0.2
OVER_A_DISC = FittedWavefront(NOLL, WAVES, 1e-6 * np.eye(12), 600.0, 450.0, 2.8)
RIMS = {
    "hexagon": Rim((Diaphragm(6, 0.1, 0.2),)),
    "ring": Rim(obstructed=0.176),
    "cat's eye": Rim((Circle(), Circle(0.3, 0.95, 0.7))),
    "all": Rim((Diaphragm(5, 0.3),), (0.03, 0.02, 0.01, 0.0), 0.1),
}
PERFECT = FittedWavefront((), np.zeros(0), np.zeros((0, 0)), 600.0, 450.0, 2.8)


def over(name: str) -> FittedWavefront:
    return replace(OVER_A_DISC, rim=RIMS[name])


def test_a_disc_by_its_outline_is_a_disc() -> None:
    outlined = replace(OVER_A_DISC, rim=ROUND_RIM)
    frequency = np.linspace(0, OVER_A_DISC.cutoff_per_mm, 9)
    for slices in (transfer_function, turning_transfer_function):
        value, slopes = slices(outlined, frequency, 30.0)
        expected, expected_slopes = slices(OVER_A_DISC, frequency, 30.0)
        assert np.abs(value - expected)[:-1].max() < 2.5e-6
        assert np.abs(value[-1]) < 6e-5  # at the cutoff
        away = np.abs(slopes - expected_slopes).max(axis=0)
        assert away[:-1].max() < 2.5e-5
        assert away[-1] < 1.6e-3
    for number in (strehl, rms, peak_to_valley):
        ours, theirs = number(outlined), number(OVER_A_DISC)
        assert ours.value == pytest.approx(theirs.value, rel=1e-6)
        assert ours.std == pytest.approx(theirs.std, rel=1e-5)
    for ours, theirs in (
        (mtf50(outlined, "x"), mtf50(OVER_A_DISC, "x")),
        (radius_of_energy(outlined, 0.8), radius_of_energy(OVER_A_DISC, 0.8)),
    ):
        assert ours.value == pytest.approx(theirs.value, rel=1e-4)
        assert ours.std == pytest.approx(theirs.std, rel=1e-3)
    by_outline, by_disc = (
        mtf_through_focus(of, 100.0, "y", np.linspace(-0.1, 0.1, 3)).value
        for of in (outlined, OVER_A_DISC)
    )
    assert by_outline == pytest.approx(by_disc, abs=3e-5)


@pytest.mark.parametrize("name", RIMS)
def test_strehl_ratio_and_mtf_are_those_of_the_psf(name: str) -> None:
    w = over(name)
    perfect = replace(w, waves=0 * WAVES)
    peak = psf_value(w, 0.15, 801).max() / psf_value(perfect, 0.15, 801).max()
    assert strehl(w).value == pytest.approx(peak, rel=0.02)  # the samples miss the peak
    assert strehl(perfect).value == pytest.approx(1)
    psf, at_mm = psf_value(w, 0.3, 1601), 0.3e-3 * (np.arange(1601) - 800)
    for direction, along in (("x", psf.sum(axis=0)), ("y", psf.sum(axis=1))):
        frequency = np.array([50.0, 150.0, 300.0])
        sums = np.abs(np.exp(-2j * np.pi * np.outer(frequency, at_mm)) @ along)
        # the window lacks some thousandths of the halo
        curve = mtf(w, frequency, direction)  # type: ignore[arg-type]
        assert curve.value == pytest.approx(sums, abs=2e-3)


@pytest.mark.parametrize("name", RIMS)
def test_rms_and_extremes_are_over_the_clear_part(name: str) -> None:
    w, path = over(name), opd_map(over(name), 800).value
    assert rms(w).value == pytest.approx(np.nanstd(path), rel=2e-3)
    assert peak_to_valley(w).value == pytest.approx(
        np.nanmax(path) - np.nanmin(path), rel=0.02
    )
    clear = np.isfinite(path).mean() * (2 * w.rim.longest) ** 2
    assert clear == pytest.approx(np.pi * w.rim.area, rel=2e-3)


@pytest.mark.parametrize("along", [40.0, 130.0])
def test_coarse_lines_lose_what_two_displaced_cats_eyes_do_not_share(along: float) -> None:
    """Chords of the overlap of two unit discs, half a radius apart towards 40 degrees, shorten by the displacement."""
    eye = replace(PERFECT, rim=Rim((Circle(), Circle(0.5, 1.0, np.deg2rad(40)))))
    turn = np.deg2rad(40 - along)
    x = 0.5 * np.cos(turn)
    y = 0.5 * np.sin(turn)
    height = np.linspace(-1, 1, 20_001)
    half = np.sqrt(1 - height**2)
    other = np.sqrt(np.maximum(1 - (height - y) ** 2, 0))
    chords = np.minimum(half, x + other) - np.maximum(-half, x - other)
    chords = np.where(np.abs(height - y) < 1, np.maximum(chords, 0), 0)
    nu = np.array([0.001, 0.0025, 0.005, 0.01, 0.02, 0.05])
    common = [np.maximum(chords - 2 * v, 0).sum() / chords.sum() for v in nu]
    curve = mtf(eye, nu * 1e3 / (0.6 * 2.8), along)
    assert curve.value == pytest.approx(common, abs=5e-6)


def test_defocus_has_the_same_rms_over_a_ring_of_equal_area() -> None:
    defocus = FittedWavefront((4,), np.array([0.3]), np.zeros((1, 1)), 600.0, 450.0, 2.8)
    ring = replace(defocus, rim=Rim(obstructed=0.3))
    assert rms(ring).value == pytest.approx(0.3, rel=1e-9)


def test_a_perfect_ring_has_the_encircled_energy_of_its_closed_form() -> None:
    ring = replace(PERFECT, rim=Rim(obstructed=0.16))
    outer, inner = 0.84**-0.5, 0.4 * 0.84**-0.5

    def light(v: float) -> float:
        field = outer * j1(outer * v) - inner * j1(inner * v)
        return float(2 * field**2 / v)

    radius_um = np.array([1.0, 2.0, 5.0])
    exact = [quad(light, 1e-9, np.pi * r / (0.6 * 2.8), limit=200)[0] for r in radius_um]
    assert encircled_energy(ring, radius_um).value == pytest.approx(exact, abs=4e-4)


@pytest.mark.parametrize("name", [*RIMS, "disc"])
def test_derivatives_that_nobody_needs_are_left_out(name: str) -> None:
    wavefront = OVER_A_DISC if name == "disc" else over(name)
    frequency = np.linspace(0, wavefront.cutoff_per_mm, 9)
    value, slopes = transfer_function(wavefront, frequency, 30.0)
    alone, left_out = transfer_function(wavefront, frequency, 30.0, slopes=False)
    np.testing.assert_allclose(alone, value, atol=1e-15)
    assert slopes.any()
    assert not left_out.any()
