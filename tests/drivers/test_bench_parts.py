"""What the bench's filter, diffusion, smear, veil and spectra do to pictures, against closed forms, moved cameras and poppy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import astropy.units as u
import numpy as np
import poppy
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.optics import point_spread
from labkit.drivers.simulated.parts import LowPassFilter, Smear, Spectrum, Veil
from labkit.drivers.simulated.scene import FineGrid, photograph, transform
from labkit.drivers.simulated.spread import aside, psf_and_halo, veiled
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueLens,
    TruePanel,
    TrueRail,
    TrueSensor,
)
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats, Floats32

SMALL = BenchSettings(
    lens=TrueLens(f_number=5.6),
    sensor=TrueSensor(rows=32, cols=40, hot_pixels=0, dead_pixels=0),
    panel=TruePanel(pixels=(300, 300)),
    halo_um=100.0,
    samples_per_pixel=6,
)
Part = tuple[LowPassFilter, float, Smear]
NONE: Part = (LowPassFilter(), 0.0, Smear())
ASIDE: list[Part] = [
    (LowPassFilter(0.37, 0.83), 0.0, Smear()),
    (LowPassFilter(0.71, 0.71, turned=True), 0.0, Smear()),
    (LowPassFilter(), 0.1, Smear()),
    (LowPassFilter(), 0.3, Smear()),
    (LowPassFilter(), 0.0, Smear(0.5, 33.0)),
    (LowPassFilter(0.37, 0.83), 0.2, Smear(2.5, 110.0)),
]


def with_parts(
    part: Part = NONE, settings: BenchSettings = SMALL, **lens: Any
) -> BenchSettings:
    low_pass, diffusion_px, smear = part
    sensor = replace(settings.sensor, low_pass=low_pass, diffusion_px=diffusion_px)
    return replace(
        settings,
        sensor=sensor,
        rail=TrueRail(smear=smear),
        lens=replace(settings.lens, **lens),
    )


def at_work(settings: BenchSettings, picture: Floats | None = None) -> Bench:
    """A bench that shows a carpet, or another picture of 0 to 1."""
    bench = Bench(settings)
    bench.turn_screw(60.0)
    bench.stand(60.0)
    cells = carpet_cells(3) if picture is None else picture
    bench.light((np.kron(cells, np.ones((4, 4))) * 255).astype(np.uint8))
    return bench


def closed_form(
    low_pass: LowPassFilter, diffusion_px: float, smear: Smear, down: float, right: float
) -> float:
    """Transfer at so many cycles per pixel."""
    first, second = (
        ((down + right) / 2**0.5, (down - right) / 2**0.5)
        if low_pass.turned
        else (down, right)
    )
    filtered = np.cos(np.pi * low_pass.rows_px * first) * np.cos(
        np.pi * low_pass.cols_px * second
    )
    angle = np.radians(smear.direction_deg)
    smeared = np.sinc(smear.length_px * (down * np.sin(angle) + right * np.cos(angle)))
    return float(
        filtered * smeared * np.exp(-2 * (np.pi * diffusion_px) ** 2 * (down**2 + right**2))
    )


@pytest.mark.parametrize("part", ASIDE)
@pytest.mark.parametrize("samples", [6, 7, 16])
def test_what_goes_aside_has_the_closed_form_at_every_frequency_that_a_psf_holds(
    part: Part, samples: int
) -> None:
    kernel = aside(*part, samples).astype(float)
    place = (np.arange(len(kernel)) - len(kernel) // 2) / samples
    errors = []
    for frequency in (
        np.array([0.02, 0.3, 0.6, 0.9]) * samples / 2
    ):  # the last: nine tenths of Nyquist's
        for angle in np.linspace(0, np.pi, 13):
            down, right = frequency * np.sin(angle), frequency * np.cos(angle)
            turn = np.exp(-2j * np.pi * down * place), np.exp(-2j * np.pi * right * place)
            errors.append(abs(turn[0] @ kernel @ turn[1] - closed_form(*part, down, right)))
    assert kernel.sum() == pytest.approx(1, abs=1e-7)
    assert max(errors) < 8e-5  # 4e-5 as measured


@pytest.mark.parametrize("turned", [False, True])
def test_a_filtered_psf_is_the_mean_of_four_that_are_tilted_aside(turned: bool) -> None:
    rows_px, cols_px = (0.71, 0.71) if turned else (0.37, 0.83)
    nm, f_number, pitch_um, samples, reach = (
        450.0,
        2.8,
        4.78,
        8,
        240,
    )  # as coarse as the bench samples: 1.05 of Nyquist's rate
    waves = {4: 0.5, 5: 0.05, 7: 0.08, 9: 0.04}
    # a tilt of a waves RMS throws light aside by 4 a lambda N
    per_px = pitch_um / (4 * nm * 1e-3 * f_number)
    mean = np.zeros(2 * (2 * reach + 1,))
    for down, right in LowPassFilter(rows_px, cols_px, turned).spots_px:
        mean += (
            point_spread(
                {**waves, 2: right * per_px, 3: down * per_px},
                nm,
                f_number,
                pitch_um / samples,
                reach,
            )
            / 4
        )
    plain = point_spread(waves, nm, f_number, pitch_um / samples, reach)
    ours = fftconvolve(
        plain,
        aside(LowPassFilter(rows_px, cols_px, turned), 0.0, Smear(), samples),
        mode="same",
    )
    assert abs(plain - mean).sum() > 0.3
    assert abs(ours - mean)[40:-40, 40:-40].sum() < 1.2e-4  # 6e-5 as measured, of all light


def spots(part: Part) -> tuple[Floats, Floats]:
    """Where a part throws light, (n, 2) pixels down and right, and shares: written out for one part at a time."""
    low_pass, diffusion_px, smear = part
    if diffusion_px:
        nodes, shares = np.polynomial.hermite_e.hermegauss(6)
        places = diffusion_px * np.array(
            [(down, right) for down in nodes for right in nodes]
        )
        return places, np.outer(shares, shares).ravel() / shares.sum() ** 2
    if smear.length_px:
        nodes, shares = np.polynomial.legendre.leggauss(5)
        angle = np.radians(smear.direction_deg)
        return np.outer(
            nodes * smear.length_px / 2, [np.sin(angle), np.cos(angle)]
        ), shares / 2
    if low_pass.turned:
        return low_pass.rows_px / 2**0.5 * np.array(
            [[1, 0], [-1, 0], [0, 1], [0, -1]]
        ), np.full(4, 0.25)
    corners = [
        (i * low_pass.rows_px, j * low_pass.cols_px)
        for i in (-0.5, 0.5)
        for j in (-0.5, 0.5)
    ]
    return np.array(corners), np.full(4, 0.25)


@pytest.mark.parametrize("part", [*ASIDE[:2], (LowPassFilter(), 0.2, Smear()), ASIDE[4]])
def test_a_picture_is_the_mean_of_pictures_from_where_the_light_was_thrown(
    part: Part,
) -> None:
    moved = at_work(SMALL)
    middle = np.array(moved._wander_px)
    mean = np.zeros((SMALL.sensor.rows, SMALL.sensor.cols))
    for place, share in zip(*spots(part), strict=True):
        moved._wander_px = tuple(middle + place)
        mean += share * moved.irradiance("G", 12)
    error = at_work(with_parts(part)).irradiance("G", 12) - mean
    assert (
        np.sqrt(np.mean(error**2)) < 5e-4
    )  # 2.4e-4 as measured: edges are drawn by 34 points a sample


def cone() -> float:
    """SMALL's f-number at the sensor: from exit pupil to image, over the pupil's diameter."""
    lens = SMALL.lens
    focal_mm, pupils = lens.focal_length_mm, lens.pupil_magnification
    sensor_mm = 1 / (
        1 / focal_mm - 1 / lens.best_focus_mm["G"]
    )  # from the rear principal plane
    return (sensor_mm + (pupils - 1) * focal_mm) / (pupils * focal_mm / lens.f_number)


def edge_picture(psf: Floats32, halo: Floats32, grid: FineGrid, edge_px: float) -> Floats32:
    """Half a plane that is white from edge_px on."""
    x = grid.centres(grid.cols)
    white = np.clip((x - edge_px) * grid.samples + 0.5, 0, 1).astype(np.float32)
    scene = np.tile(white, (grid.rows * grid.samples + 2 * grid.reach, 1))
    return photograph(transform(scene, grid), psf, 1.0, halo)


@pytest.mark.parametrize("part", [NONE, *ASIDE])
def test_a_blurred_edge_has_the_closed_form_of_diffraction_pixel_and_part(
    part: Part,
) -> None:
    edge_px = 7.3
    wide = replace(SMALL, sensor=TrueSensor(rows=400, cols=400))  # as far as the halo goes
    grid = FineGrid(8, 16, 20, 1600)
    psf, halo = psf_and_halo(with_parts(part, wide), "G", {}, grid)
    seen = edge_picture(psf, halo, grid, edge_px)[4] / (
        psf.sum(dtype=float) + halo.sum(dtype=float)
    )
    cutoff = 4.78 / (0.55 * cone())  # cycles per pixel

    def integrand(nu: float, x: float) -> float:
        s = nu / cutoff
        mtf = (
            2
            / np.pi
            * (np.arccos(s) - s * np.sqrt(1 - s * s))
            * closed_form(*part, 0.0, nu)
        )
        return float(mtf * np.sinc(nu) * 2 * x * np.sinc(2 * nu * x))

    expected = [
        0.5 + quad(integrand, 0, cutoff, args=(j - edge_px,), limit=200)[0]
        for j in range(16)
    ]
    np.testing.assert_allclose(
        seen, expected, atol=7e-4
    )  # 3.3e-4 as measured, without any part too


@pytest.fixture(scope="module")
def ideal() -> list[Floats32]:
    """A spot and white as a bench without parts sees them."""
    return [at_work(SMALL, np.ones((side, side))).irradiance("G") for side in (2, 75)]


@pytest.mark.parametrize("part", [ASIDE[0], ASIDE[1], ASIDE[5]])
def test_no_light_is_lost_aside(part: Part, ideal: list[Floats32]) -> None:
    spot, white = (
        at_work(with_parts(part), np.ones((side, side))).irradiance("G") for side in (2, 75)
    )
    # the longest of them carries 5e-5 of the light out of the frame
    assert spot.sum(dtype=float) == pytest.approx(ideal[0].sum(dtype=float), rel=1e-4)
    np.testing.assert_allclose(white, ideal[1], rtol=6e-5)


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_a_veil_takes_its_share_of_contrast_and_spreads_it(shape: Any) -> None:
    scale = 4.0
    veil = Veil(0.03, scale, shape)
    grid = FineGrid(128, 128, 2, 128)
    x = grid.centres(128)
    for cycles in (1 / 64, 1 / 16):
        wave = np.tile(1 + np.cos(2 * np.pi * cycles * x), (x.size, 1)).astype(np.float32)
        scene = transform(wave, grid)
        seen = wave[128:-128, 128:-128].reshape(128, 2, 128, 2).mean(axis=(1, 3))
        spread = np.exp(-2 * (np.pi * scale * cycles) ** 2)
        if shape == "exponential":
            spread = (1 + (2 * np.pi * scale * cycles) ** 2) ** -1.5
        contrast = 2 * np.mean(
            veiled(seen, scene, veil)[64] * np.cos(2 * np.pi * cycles * np.arange(128))
        )
        before = 2 * np.mean(seen[64] * np.cos(2 * np.pi * cycles * np.arange(128)))
        assert contrast / before == pytest.approx(
            1 - 0.03 + 0.03 * spread, abs=3e-5
        )  # 1.5e-5, the exponential's peak
        assert veiled(seen, scene, veil).mean() == pytest.approx(1, abs=1e-5)


def test_a_benchs_veil_lies_over_its_pictures() -> None:
    share, scale = 0.02, 5.0
    clear = at_work(SMALL).irradiance("G")
    real = at_work(with_parts(veil=Veil(share, scale, "gaussian"))).irradiance("G")
    spread = (real - (1 - share) * clear) / share
    again = gaussian_filter(clear, scale)
    middle = slice(12, -12)
    # the picture holds diffraction already, whose halo is no Gaussian's: 0.016 of 0.44 to 0.86
    np.testing.assert_allclose(spread[middle, middle], again[middle, middle], atol=0.03)


LINES = ((530.0, 0.3), (548.0, 0.5), (575.0, 0.2))


def test_a_spectrum_gives_the_mean_of_its_wavelengths_pictures() -> None:
    own = with_parts(
        spectrum={"G": Spectrum(tuple((nm, 10 * share) for nm, share in LINES))}
    )
    mean = np.zeros((SMALL.sensor.rows, SMALL.sensor.cols))
    for nm, share in LINES:
        mean += share * at_work(
            with_parts(wavelength_nm={"R": 650.0, "G": nm, "B": 450.0})
        ).irradiance("G", 8)
    error = at_work(own).irradiance("G", 8) - mean
    assert abs(error).max() < 1.2e-6  # 6e-7, single precision


def test_a_spectrums_psf_is_poppys_with_the_same_paths_in_nm() -> None:
    waves = {4: 0.6, 5: 0.05, 7: 0.08, 8: -0.05, 9: 0.04, 11: 0.03}
    settings = with_parts(spectrum={"G": Spectrum(LINES)})
    grid = FineGrid(8, 8, 8, 400)
    ours, _ = psf_and_halo(settings, "G", waves, grid)
    coefficients = [0.0, 0, 0, *(waves.get(j, 0.0) * 450e-9 for j in range(4, 12))]
    system = poppy.OpticalSystem(npix=1024, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(poppy.ZernikeWFE(radius=1.0, coefficients=coefficients))
    scale = np.degrees(4.78e-6 / 8 / (cone() * 2.0)) * 3600
    system.add_detector(pixelscale=scale * u.arcsec / u.pixel, fov_pixels=121, oversample=1)
    source = {
        "wavelengths": [nm * 1e-9 for nm, _ in LINES],
        "weights": [share for _, share in LINES],
    }
    # poppy's light goes against the slope of the path: turn it by 180 degrees
    theirs = system.calc_psf(source=source, normalize="none")[0].data[::-1, ::-1]
    ours = ours[340:461, 340:461]
    assert (
        np.abs(ours / ours.sum() - theirs / theirs.sum()).sum() < 1.8e-3
    )  # 9e-4 as measured


def test_longitudinal_colour_is_defocus_that_grows_with_the_wavelength() -> None:
    spectrum = Spectrum(((570.0, 1.0),), defocus_waves_per_nm=0.01)
    grid = FineGrid(8, 8, 8, 200)
    shifted, _ = psf_and_halo(with_parts(spectrum={"G": spectrum}), "G", {4: 0.1}, grid)
    plain, _ = psf_and_halo(
        with_parts(spectrum={"G": Spectrum(((570.0, 1.0),))}), "G", {4: 0.3}, grid
    )
    np.testing.assert_allclose(shifted, plain, atol=1e-9)


def test_a_bench_whose_parts_are_nothing_makes_the_same_picture_to_the_bit() -> None:
    none = (LowPassFilter(0.0, 0.0, True), 0.0, Smear(0.0, 45.0))
    nothing = with_parts(
        none, veil=Veil(0.0, 10.0), spectrum={"G": Spectrum(((550.0, 3.0),), 0.1)}
    )
    nothing = replace(nothing, panel=replace(nothing.panel, layout="none", lit_across=0.5))
    np.testing.assert_array_equal(
        at_work(nothing).expose(0.02, 100, "a"), at_work(SMALL).expose(0.02, 100, "a")
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: LowPassFilter(-0.1, 0.5), "0 pixels or more"),
        (lambda: LowPassFilter(0.4, 0.5, turned=True), "one separation"),
        (lambda: Smear(-1.0), "0 pixels long or longer"),
        (lambda: Veil(1.0), "less than 1"),
        (lambda: Veil(0.1, 0.5), "2 pixels wide"),
        (lambda: Spectrum(()), "all positive"),
        (lambda: Spectrum(((550.0, 0.0),)), "all positive"),
        (lambda: aside(LowPassFilter(), -0.1, Smear(), 6), "0 pixels or more"),
    ],
)
def test_parts_that_cannot_be_are_refused(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()
