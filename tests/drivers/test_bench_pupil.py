"""The bench's pupils that are no discs: blades, obstruction and cat's eye against poppy and closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, radians, sin, sqrt
from typing import Any

import astropy.units as u
import numpy as np
import poppy
import pytest
from scipy.special import j1

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.image import fine_grid
from labkit.drivers.simulated.optics import halo_beyond, point_spread
from labkit.drivers.simulated.pupil import SPIKES, Pupil
from labkit.drivers.simulated.world import BenchSettings, TrueLens
from labkit.types import Floats, Floats32

NM, F_NUMBER, SPACING_UM, REACH, SHOWN = 600.0, 2.8, 0.6, 400, 60
WAVES = {4: 0.4, 5: 0.05, 9: 0.08, 15: -0.05, 20: 0.03}
"""Defocus, and modes that are one power of the radius: over another circle they are themselves, times a number."""


def with_poppy(pupil: Pupil, *apertures: Any) -> Floats:
    """The PSF of apertures in units of the clear area's radius, (2 SHOWN + 1,) * 2, of unit sum."""
    radius = pupil.extent
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    for aperture in apertures:
        system.add_pupil(aperture)
    waves = [0.0] * 20
    for j, amount in WAVES.items():
        waves[j - 1] = amount * 450e-9 * radius ** {4: 2, 5: 2, 9: 3, 15: 4, 20: 5}[j]
    system.add_pupil(poppy.ZernikeWFE(radius=radius, coefficients=waves))
    scale = np.degrees(SPACING_UM * 1e-6 / (F_NUMBER * 2.0)) * 3600
    fov = 2 * SHOWN + 1
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=fov, oversample=1)
    # poppy's light goes against the slope of the path: turn it by 180 degrees
    psf = system.calc_psf(wavelength=NM * 1e-9)[0].data[::-1, ::-1]
    return np.asarray(psf / psf.sum())


def disc(radius: float, right: float = 0.0, down: float = 0.0) -> Any:
    return poppy.CircularAperture(
        radius=radius, gray_pixel=True, pad_factor=1.2, shift_x=right, shift_y=down
    )


def overlapping(*apertures: Any) -> Any:
    return poppy.CompoundAnalyticOptic([*apertures], mergemode="and")


def ours(pupil: Pupil) -> Floats:
    psf = point_spread(WAVES, NM, F_NUMBER, SPACING_UM, REACH, pupil=pupil)
    middle = slice(REACH - SHOWN, REACH + SHOWN + 1)
    shown = psf[middle, middle].astype(float)
    return np.asarray(shown / shown.sum())


def difference(pupil: Pupil, *apertures: Any) -> float:
    return float(np.abs(ours(pupil) - with_poppy(pupil, *apertures)).sum())


@pytest.mark.parametrize("blades", [5, 6, 7])
def test_straight_blades_have_poppys_psf(blades: int) -> None:
    pupil = Pupil(blades=blades, turn_deg=180 / blades)  # a corner to the right
    apart = difference(pupil, poppy.NgonAperture(nsides=blades, radius=pupil.extent))
    # 9e-4 to 2e-3, poppy's binary rim: half of it with twice as many samples
    assert apart < 3e-3


def test_an_obstructed_pupil_has_poppys_psf() -> None:
    pupil = Pupil(obstruction=0.42)
    dark = poppy.InverseTransmission(disc(0.42 * pupil.opening))
    apart = difference(pupil, disc(pupil.opening), dark)
    assert apart < 3e-3  # 2.1e-3 as measured, poppy's rim


def test_a_cats_eye_has_poppys_psf() -> None:
    shift, radius, direction = 0.5, 1.2, radians(-60.0)
    second = disc(radius, shift * cos(direction), shift * sin(direction))
    pupil = Pupil(cats_eye=(shift, radius, -60.0))
    assert difference(pupil, disc(1.0), second) < 3e-3  # 1.9e-3 as measured
    assert difference(pupil, disc(1.0)) > 0.2


def test_rounded_blades_are_arcs_through_the_corners() -> None:
    pupil = Pupil(blades=6, turn_deg=24.0, rounding=0.2)
    half, corners, radius = pi / 6, pupil.extent, pupil.extent / 0.2
    middle = corners * cos(half) - sqrt(radius**2 - (corners * sin(half)) ** 2)
    angles = [radians(24.0 + 60 * k) for k in range(6)]
    arcs = [disc(radius, middle * cos(angle), middle * sin(angle)) for angle in angles]
    assert difference(pupil, *arcs) < 2e-3  # 1.0e-3 as measured


def on_a_grid(reach: int) -> Floats:
    """Distances of a PSF's samples from its middle, in lambda N."""
    at = np.arange(-reach, reach + 1) * SPACING_UM / (NM * 1e-3 * F_NUMBER)
    return np.asarray(np.hypot(at[:, None], at))


def test_a_mirror_lens_has_the_rings_of_an_annulus() -> None:
    share, outer = 0.42, 1 / sqrt(1 - 0.42**2)
    r = np.pi * np.maximum(on_a_grid(REACH), 1e-9)
    field = outer * j1(r * outer) / r - share * outer * j1(r * share * outer) / r
    light = 4 * field**2 * pi / 4 * (SPACING_UM / (NM * 1e-3 * F_NUMBER)) ** 2
    pupil = Pupil(obstruction=share)
    psf = point_spread({}, NM, F_NUMBER, SPACING_UM, REACH, pupil=pupil)
    assert np.abs(psf - light).sum() < 2e-7  # 1.1e-7 as measured
    # what is beyond 240 um, but for a tenth that is beyond 2.4 mm, is the halo's
    halo = halo_beyond(NM, F_NUMBER, SPACING_UM, REACH, 10, 400, pupil)
    assert halo.sum(dtype=float) == pytest.approx(0.9 * (1 - light.sum()), rel=1e-3)


def transform_of_a_polygon(corners: Floats, at: Floats) -> Floats:
    """The transform of the inside of (n, 2) corners at (k, 2) cycles per unit, by the theorem of Stokes."""
    sides = np.roll(corners, -1, axis=0) - corners
    middles = corners + sides / 2
    across = at[:, 1:] * sides[:, 0] - at[:, :1] * sides[:, 1]
    edges = across * np.sinc(at @ sides.T) * np.exp(-2j * np.pi * at @ middles.T)
    return np.asarray(edges.sum(axis=1) / (2j * np.pi * (at**2).sum(axis=1)))


def test_straight_blades_have_the_spikes_of_a_polygon_wherever_they_are_turned() -> None:
    pupil, turn = Pupil(blades=5, turn_deg=11.0), radians(11.0 + 180 / 5)
    angles = turn + 2 * pi * np.arange(5) / 5
    corners = pupil.extent * np.column_stack([np.cos(angles), np.sin(angles)])
    at = np.arange(-REACH, REACH + 1) * SPACING_UM / (2 * NM * 1e-3 * F_NUMBER)
    right, down = np.meshgrid(at, at)
    places = np.column_stack([right.ravel(), down.ravel()])
    places[len(places) // 2] = 1e-9
    field = np.abs(transform_of_a_polygon(corners, places)).reshape(right.shape)
    light = field**2 / pi * (SPACING_UM / (2 * NM * 1e-3 * F_NUMBER)) ** 2
    psf = point_spread({}, NM, F_NUMBER, SPACING_UM, REACH, pupil=pupil)
    assert np.abs(psf - light).sum() < 6e-6  # 3.1e-6 as measured
    halo = halo_beyond(NM, F_NUMBER, SPACING_UM, REACH, 10, 400, pupil)
    assert halo.sum(dtype=float) == pytest.approx(0.9 * (1 - light.sum()), rel=7e-3)


def test_light_far_from_a_polygon_s_image_is_in_its_spikes() -> None:
    """As its transform has it between 200 and 300 lambda N: 0.988 of the light is within 3 degrees of five directions."""
    pupil, turn = Pupil(blades=5, turn_deg=11.0), radians(11.0 + 180 / 5)
    angles = turn + 2 * pi * np.arange(5) / 5
    corners = pupil.extent * np.column_stack([np.cos(angles), np.sin(angles)])
    away, around = np.meshgrid(np.arange(100.0, 150.0, 0.37), np.arange(0, 180, 0.02))
    places = away[..., None] * np.stack(
        [np.cos(np.radians(around)), np.sin(np.radians(around))], axis=-1
    )
    light = np.abs(transform_of_a_polygon(corners, places.reshape(-1, 2))) ** 2
    light = (light.reshape(away.shape) * away).sum(axis=1)
    off = (around[:, 0] - 11 + 18) % 36 - 18
    share = light[np.abs(off) < 3].sum() / light.sum()
    middles = (np.arange(SPIKES) + 0.5) * 180 / SPIKES
    near = np.abs((middles - 11 + 18) % 36 - 18) < 3
    found = pupil.spikes[near].sum() / pupil.spikes.sum()
    assert share == pytest.approx(0.988, abs=0.001)
    # all of it: corners, whose light is faint and everywhere, have none
    assert found == pytest.approx(share, abs=0.02)


def test_light_is_spread_evenly_across_round_blades_and_nowhere_else() -> None:
    """Each of six blades turns its normal by 2 asin(rounding sin(30 degrees)) = 29 degrees."""
    spikes = Pupil(blades=6, turn_deg=10.0, rounding=0.5).spikes
    middles = (np.arange(SPIKES) + 0.5) * 180 / SPIKES
    off = np.abs((middles - 10 + 30) % 60 - 30)
    reach = np.degrees(np.arcsin(0.5 * 0.5))
    np.testing.assert_allclose(spikes[off < reach - 1], 30 / reach, rtol=5e-4)
    np.testing.assert_array_equal(spikes[off > reach + 1], 0.0)
    np.testing.assert_array_equal(Pupil(obstruction=0.4).spikes, 1.0)


def test_two_circles_have_the_spikes_of_the_arcs_that_each_leaves_of_the_other() -> None:
    """The second circle lies to the right: its edge is what is left of the pupil's on the left."""
    shift, radius = 0.5, 1.2
    chord = (shift**2 + 1 - radius**2) / (2 * shift)
    first, second = np.arccos(chord), np.arccos((shift - chord) / radius)
    spikes = Pupil(cats_eye=(shift, radius, 0.0)).spikes
    off = (np.arange(SPIKES) + 0.5) * pi / SPIKES
    both_ways = np.stack([off, pi - off])  # from the axis of both circles
    arcs = np.sum((both_ways < first) + radius * (both_ways < second), axis=0)
    arcs *= pi / (2 * (first + radius * second))
    ends = np.min(np.abs(both_ways - [[[first]], [[second]]]), axis=(0, 1))
    clear = ends > pi / SPIKES
    np.testing.assert_allclose(spikes[clear], arcs[clear], rtol=1e-4)


def test_a_cats_eye_leaves_what_two_circles_share() -> None:
    shift, radius = 0.5, 1.2
    chord = (shift**2 + 1 - radius**2) / (2 * shift)
    first, second = np.arccos(chord), np.arccos((shift - chord) / radius)
    shared = first + radius**2 * second - shift * sqrt(1 - chord**2)
    cut = Pupil(cats_eye=(shift, radius, 30.0))
    assert cut.clear_share == pytest.approx(shared / pi, abs=2e-8)
    length = 2 * first + 2 * radius * second
    assert cut.rim == pytest.approx(length / (2 * shared), abs=2e-5)


def test_blades_of_full_rounding_are_a_disc() -> None:
    disc_psf = ours(Pupil())
    np.testing.assert_allclose(
        ours(Pupil(blades=7, turn_deg=5.0, rounding=1.0)), disc_psf, atol=1e-9
    )
    near = ours(Pupil(blades=7, turn_deg=5.0, rounding=0.99))
    assert 5e-4 < np.abs(near - disc_psf).sum() < 3e-3


def test_clear_areas_are_the_disc_of_the_f_number() -> None:
    for pupil in (
        Pupil(blades=5),
        Pupil(blades=9, turn_deg=3.0, rounding=0.4),
        Pupil(obstruction=0.6),
        Pupil(blades=6, rounding=0.2, obstruction=0.3),
    ):
        assert pupil.clear_share == pytest.approx(1, abs=6e-7)


def test_a_bench_samples_as_finely_as_the_outer_rim_needs() -> None:
    lens = TrueLens(f_number=2.0)
    mirror = replace(lens, pupil=Pupil(obstruction=0.6))
    assert mirror.outer_f_number == pytest.approx(1.6)
    samples = [
        fine_grid(Bench(replace(BenchSettings(samples_per_pixel=1), lens=one)).view).samples
        for one in (lens, mirror)
    ]
    assert samples == [11, 14]


def test_a_bench_photographs_with_its_pupil() -> None:
    def seen(pupil: Pupil) -> Floats32:
        lens = TrueLens(f_number=5.6, pupil=pupil)
        settings = replace(BenchSettings(), lens=lens, halo_um=100.0)
        sensor = replace(settings.sensor, rows=32, cols=40, hot_pixels=0, dead_pixels=0)
        bench = Bench(replace(settings, sensor=sensor))
        bench.turn_screw(250.0)
        bench.stand(250.0)
        bench.light(np.full((20, 20), 255, dtype=np.uint8))
        return bench.irradiance("G")

    round_, mirror = seen(Pupil()), seen(Pupil(obstruction=0.5))
    np.testing.assert_array_equal(seen(Pupil(blades=6, rounding=1.0)), round_)
    assert np.abs(mirror - round_).max() == pytest.approx(0.13, rel=0.1)
    assert mirror.sum() == pytest.approx(round_.sum(), rel=0.01)
