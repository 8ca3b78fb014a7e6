"""What a camera adds, against kernels drawn in space and against finite differences; spectra against their moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from labkit.imaging.blur import Blur
from labkit.imaging.grid import Torus
from labkit.imaging.model import ForwardModel
from labkit.imaging.parts import Diffusion, LowPass, Part, Smear, SpectrumWidth, Veil
from labkit.imaging.parts.blur import BROADEST_PX, NARROWEST_PX
from labkit.optics.psf import Pupil
from labkit.optics.spectrum import WIDEST_SPECTRUM, Spectrum
from labkit.plan import Channel
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.unit.test_cone import CARPET, OPTICS, POSE, TRUTH

ROWS, COLUMNS = np.linspace(0.0, 1.3, 7)[:, None], np.linspace(-1.2, 1.1, 8)[None, :]
EVERY = (
    LowPass(0.3, 0.5),
    LowPass(0.6, 0.1, turned=True),
    LowPass(-0.1, 0.2),
    Diffusion(0.04),
    Smear(0.02, 0.01, 0.008),
    Veil(0.03),
)


def named(part: Part) -> str:
    return part.name


def spots(*places: tuple[float, float]) -> Floats:
    """Transfer function of equal points at (row, column), pixels."""
    return np.asarray(
        np.mean([np.cos(2 * np.pi * (r * ROWS + c * COLUMNS)) for r, c in places], axis=0)
    )


def sampled(density: Floats, at: Floats) -> Floats:
    """Transfer function of a kernel (n, n) sampled at `at` (n,) along both axes, by summing."""
    down, across = (
        np.exp(-2j * np.pi * ROWS * at[None, :]),
        np.exp(-2j * np.pi * COLUMNS.T * at[None, :]),
    )
    return np.asarray((down @ density @ across.T).real / density.sum())


def test_a_low_pass_filter_makes_four_spots_of_a_point() -> None:
    s, t = np.sqrt([0.3, 0.5]) / 2
    expected = spots((s, t), (s, -t), (-s, t), (-s, -t))
    assert LowPass(0.3, 0.5).transfer(ROWS, COLUMNS) == pytest.approx(expected, abs=1e-14)


def test_a_turned_one_has_its_spots_on_the_axes() -> None:
    s = np.sqrt(0.5) * 0.7
    expected = spots((s, 0), (-s, 0), (0, s), (0, -s))
    assert LowPass(0.49, 0.49, turned=True).transfer(ROWS, COLUMNS) == pytest.approx(
        expected, abs=1e-14
    )


def test_diffusion_and_smear_are_the_transforms_of_their_kernels() -> None:
    at = np.linspace(-2, 2, 401)
    y, x = np.meshgrid(at, at, indexing="ij")
    assert Diffusion(0.04).transfer(ROWS, COLUMNS) == pytest.approx(
        sampled(np.exp(-(y**2 + x**2) / 0.08), at), abs=1e-12
    )
    inverse = np.linalg.inv([[0.05, 0.02], [0.02, 0.04]])
    tilted = np.exp(
        -0.5 * (inverse[0, 0] * y**2 + 2 * inverse[0, 1] * y * x + inverse[1, 1] * x**2)
    )
    assert Smear(0.05, 0.04, 0.02).transfer(ROWS, COLUMNS) == pytest.approx(
        sampled(tilted, at), abs=1e-12
    )


@pytest.mark.parametrize("frequency", [0.0, 0.01, 0.03, 0.2])
def test_a_veil_is_the_hankel_transform_of_its_kernel(frequency: float) -> None:
    scale = 8.0
    spread, _ = quad(
        lambda r: np.exp(-r / scale) * j0(2 * np.pi * frequency * r) * r / scale**2,
        0,
        60 * scale,
        limit=500,
    )
    seen = Veil(0.1, scale).transfer(
        np.array([[0.6 * frequency]]), np.array([[0.8 * frequency]])
    )
    assert seen == pytest.approx(0.9 + 0.1 * spread, abs=1e-9)


@pytest.mark.parametrize("part", EVERY, ids=named)
def test_slopes_of_a_part_are_its_differences(part: Part) -> None:
    for k, slope in enumerate(part.slopes(ROWS, COLUMNS)):
        step = 1e-5 * np.eye(len(part.values))[k]
        up, down = (
            part.at(np.array(part.values) + sign * step).transfer(ROWS, COLUMNS)
            for sign in (1, -1)
        )
        assert slope == pytest.approx((up - down) / 2e-5, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(
    "part", [LowPass(), LowPass(turned=True), Diffusion(), Smear(), Veil()], ids=named
)
def test_a_part_of_nothing_does_nothing(part: Part) -> None:
    assert part.transfer(ROWS, COLUMNS) == pytest.approx(np.ones((7, 8)), abs=1e-15)
    # and has slopes there, which an estimate that begins there goes by; only a veil of no light has no scale
    slopes = dict(zip(part.labels, part.slopes(ROWS, COLUMNS), strict=True))
    assert [label for label, slope in slopes.items() if np.abs(slope).max() < 0.1] == [
        "log_scale"
    ] * (part == Veil())


def test_a_veil_is_neither_broader_nor_narrower_than_can_be_told() -> None:
    assert Veil().at((0.1, -9.0)).scale_px == pytest.approx(NARROWEST_PX)
    assert Veil().at((0.1, 9.0)).scale_px == pytest.approx(BROADEST_PX)
    assert Veil().at(Veil(0.1, 30.0).values).scale_px == pytest.approx(30.0)


def test_a_few_wavelengths_have_a_spectrums_moments() -> None:
    nm, weights = np.linspace(500, 580, 9), np.array([0.0, 1, 2, 5, 9, 7, 3, 1, 0.5])
    spectrum = Spectrum.of_samples(nm.tolist(), weights.tolist(), 540.0)
    assert len(spectrum.nodes) == 7
    for power in range(14):
        moment = np.average((nm / 540) ** power, weights=weights)
        assert np.dot(spectrum.weights, np.power(spectrum.nodes, power)) == pytest.approx(
            moment, rel=1e-12
        )


def test_a_spectrum_of_one_or_two_wavelengths_is_itself() -> None:
    assert Spectrum.of_samples([560.0], [3.0], 550.0).nodes == pytest.approx((560 / 550,))
    two = Spectrum.of_samples([540.0, 560.0, 700.0], [1.0, 3.0, 0.0], 550.0)
    assert two.nodes == pytest.approx((540 / 550, 560 / 550))
    assert two.weights == pytest.approx((0.25, 0.75))


@pytest.mark.parametrize("weights", [[0.0, 0.0], [1.0, -0.1]])
def test_a_spectrum_without_light_is_refused(weights: list[float]) -> None:
    with pytest.raises(ValueError, match="weights"):
        Spectrum.of_samples([540.0, 560.0], weights, 550.0)


def test_a_spectrum_of_a_width_has_it() -> None:
    spectrum = Spectrum.of_width(0.03**2)
    nodes, weights = np.array(spectrum.nodes), np.array(spectrum.weights)
    assert [weights.sum(), weights @ nodes, weights @ (nodes - 1) ** 2] == pytest.approx(
        [1, 1, 0.03**2]
    )
    assert spectrum.physical == spectrum
    assert Spectrum.of_width(-1e-4).physical == Spectrum()


def test_optics_spare_the_shortest_wavelength_that_an_estimate_may_reach() -> None:
    width = SpectrumWidth(0.03**2)
    fitted, given = replace(OPTICS, parts=(width,)), replace(OPTICS, given=(width,))
    assert (
        min(fitted.light.nodes)
        > fitted.shortest
        == pytest.approx(1 - np.sqrt(2) * WIDEST_SPECTRUM)
    )
    assert given.shortest == min(given.light.nodes) == pytest.approx(1 - np.sqrt(2) * 0.03)


def test_the_psf_of_a_spectrum_is_the_mean_of_its_wavelengths() -> None:
    torus, waves = Torus((96, 96), (8, 8), (80, 80), 5, 5.0, 0.45), np.array([0.2, -0.1])
    pupil = Pupil(0.55, 0.45, 4.0, 5.0 / 5, 96, (4, 7))
    blur = Blur(torus, pupil, 5.0, Spectrum.of_samples([540.0, 560.0], [1.0, 3.0], 550.0))
    each = [replace(pupil, wavelength_um=um).psf(waves) for um in (0.54, 0.56)]
    mean = 0.25 * each[0] + 0.75 * each[1]
    assert blur.psf(waves) == pytest.approx(
        mean, abs=2.5e-6
    )  # pupils of other sizes fold other halos into their windows
    assert mean.max() > 0.03


LIT = Spectrum.of_samples([480.0, 540.0, 560.0, 620.0], [1.0, 4.0, 3.0, 1.0], 550.0)


def test_a_spectrum_of_another_width_keeps_its_form_and_mean() -> None:
    wider = LIT.with_variance(2 * LIT.variance)
    assert wider.weights == LIT.weights
    assert wider.mean == pytest.approx(LIT.mean)
    assert wider.variance == pytest.approx(2 * LIT.variance)
    assert Spectrum().with_variance(4e-4) == Spectrum.of_width(4e-4)


def test_a_typical_spectrum_grows_and_shrinks_about_its_own_width() -> None:
    part = SpectrumWidth().about(LIT, None)
    assert part.light == LIT
    (slopes,) = part.light_slopes()
    nodes, weights = np.array([*slopes]), np.array([*slopes.values()])
    moments = [weights.sum(), weights @ nodes, weights @ (nodes - LIT.mean) ** 2]
    assert moments == pytest.approx([0, 0, 1], abs=1e-9)  # by the variance's own slope
    assert part.at([1.0]).light.variance == pytest.approx(2 * LIT.variance)
    assert 0 < part.at([-1.0]).light.variance < 0.02 * LIT.variance
    found = part.quantities(
        [Uncertain(-0.5 * LIT.variance, 0.1 * LIT.variance)],
        Channel.from_tables({"name": "G", "wavelength_nm": 550.0}),
    )
    width_nm = found["spectrum.G.width_nm"]
    assert width_nm.value == pytest.approx(550 * np.sqrt(0.5 * LIT.variance))
    assert width_nm.std == pytest.approx(0.1 * width_nm.value)


def test_slopes_by_a_typical_light_are_differences_of_pictures() -> None:
    torus, waves = Torus((96, 96), (8, 8), (80, 80), 5, 5.0, 0.45), np.array([0.2, -0.1])
    pupil, part = (
        Pupil(0.55, 0.45, 5.0, 5.0 / 5, 96, (4, 7)),
        SpectrumWidth().about(LIT, None),
    )
    blur = Blur(torus, pupil, 5.0, LIT, parts=(part,))
    slope, step = next(blur.by_parts(waves)), 0.05 * LIT.variance
    up, down = (
        replace(blur, spectrum=part.at([sign * step]).light).transfer(waves)
        for sign in (1, -1)
    )
    difference = (up - down) / (2 * step)
    assert np.linalg.norm(slope - difference) < 0.01 * np.linalg.norm(difference)


def test_a_spectrum_that_can_grow_no_more_has_the_slope_that_it_had_just_before() -> None:
    torus, waves = Torus((96, 96), (8, 8), (80, 80), 5, 5.0, 0.45), np.array([0.2, -0.1])
    blur = Blur(torus, Pupil(0.55, 0.45, 5.0, 5.0 / 5, 96, (4, 7)), 5.0)
    before, there = (
        next(
            replace(
                blur, parts=(SpectrumWidth().at([share * WIDEST_SPECTRUM**2]),)
            ).by_parts(waves)
        )
        for share in (0.9, 2)
    )
    assert np.linalg.norm(there - before) < 0.06 * np.linalg.norm(before)  # 0.03


@pytest.mark.parametrize("variance", [None, 0.03**2, 0.01**2, 0.0])
def test_slopes_by_the_camera_are_differences_of_pictures(variance: float | None) -> None:
    light = () if variance is None else (SpectrumWidth(variance),)
    optics = replace(OPTICS, parts=(*EVERY[1:2], *EVERY[3:], *light))
    model = ForwardModel.build(optics, CARPET, (58, 60), POSE, f_number_margin=0.02)
    used, drawing = [np.ones((58, 60), bool)], model.draw([POSE])
    slopes = model.evaluate(TRUTH.waves, drawing, used, by_camera=True)[0].by_waves[
        len(TRUTH.waves) :
    ]
    steps = np.array([1e-3] * 8 + [4e-4] * (variance is not None) + [1e-3])
    limits = [1.2e-5] * 8 + [7e-3] * (variance is not None) + [3e-3]
    for k, (step, limit) in enumerate(zip(np.diag(steps), limits, strict=True)):
        up, down = (
            model.with_optics(
                optics.with_camera_parameters(optics.camera_parameters + sign * step)
            ).means(TRUTH.waves, drawing, used)[0]
            for sign in (1, -1)
        )
        difference = (up - down) / (2 * step[k])
        assert np.abs(slopes[k] - difference).max() < limit * np.abs(difference).max(), (
            optics.camera_labels[k : k + 1]
        )
