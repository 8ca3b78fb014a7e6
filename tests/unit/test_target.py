"""The target's exact band-limited sampling, against filters and transforms that labkit did not compute."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from labkit.errors import TargetError
from labkit.target.target import CellTarget
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats


def carpet_transform(order: int, nu_y: Floats, nu_x: Floats) -> Floats:
    """Transform of a pre-carpet of side 1, by self-similarity: its black is shifted copies of a smaller black."""
    black = np.outer(np.sinc(nu_y), np.sinc(nu_x))
    whole = black.copy()
    scale = 1.0
    black = np.outer(np.sinc(nu_y / 3**order), np.sinc(nu_x / 3**order)) / 9.0**order
    for _ in range(order):
        scale /= 3
        cy, cx = 2 * np.cos(2 * np.pi * nu_y * scale), 2 * np.cos(2 * np.pi * nu_x * scale)
        black = black * (np.outer(1 + cy, 1 + cx) - 1)
    return whole - black


def test_samples_have_the_carpets_own_fourier_series_in_the_pass_band() -> None:
    side, bandwidth, n = 6.0, 4.0, 240
    at = (
        (np.arange(n) - n // 2) * 24.0 / n
    )  # a torus of four sides: the spectrum's samples 1/24 apart
    target = CellTarget(carpet_cells(3), (side, side))
    got = np.fft.fft2(np.fft.ifftshift(target.sample(at, at, bandwidth))) * (24.0 / n) ** 2
    nu = np.fft.fftfreq(n, 24.0 / n)
    passed = np.abs(nu) <= bandwidth
    want = side**2 * carpet_transform(3, nu[passed] * side, nu[passed] * side)
    # 1e-4 of the filter in each axis, relative to the strongest line
    assert np.max(np.abs(got[np.ix_(passed, passed)] - want)) < 2e-4 * np.max(np.abs(want))


def test_samples_hold_nothing_beyond_the_stop_band() -> None:
    at = (
        np.arange(400) - 200
    ) * 0.05  # a grid of Nyquist frequency 10, twice finer than the stop band's start
    target = CellTarget(carpet_cells(4), (6.0, 6.0))
    spectrum = np.abs(np.fft.fft2(target.sample(at, at, 4.0)))
    beyond = np.abs(np.fft.fftfreq(400, 0.05)) > 1.3 * 4.0
    assert np.max(spectrum[beyond]) < 1e-4 * spectrum.max()


@pytest.mark.slow
def test_samples_agree_with_fine_box_sampling_and_a_long_scipy_filter() -> None:
    rng = np.random.default_rng(1)
    cells = rng.random((7, 5))
    target = CellTarget(cells, (7.0, 5.0), surround=0.3)
    fine, margin, bandwidth = 60, 25, 1.5
    picture = np.pad(
        np.kron(cells, np.ones((fine, fine))), margin * fine, constant_values=0.3
    )
    taps = signal.firwin(
        40 * fine + 1, 1.15 * bandwidth, window=("kaiser", 12.0), fs=fine
    )  # a far sharper filter
    for axis in (0, 1):
        picture = signal.convolve(
            picture, np.expand_dims(taps, 1 - axis), mode="same", method="fft"
        )
    inside = slice(margin * fine, -margin * fine)
    at_y, at_x = ((np.arange(n * fine) + 0.5) / fine - n / 2 for n in cells.shape)
    want, got = picture[inside, inside], target.sample(at_y, at_x, bandwidth)
    # between the bands the two filters differ, so compare what both pass
    smooth = signal.firwin(8 * fine + 1, 0.5, window=("kaiser", 9.0), fs=fine)
    for axis in (0, 1):
        want, got = (
            signal.convolve(p, np.expand_dims(smooth, 1 - axis), mode="same", method="fft")
            for p in (want, got)
        )
    core = slice(4 * fine // 3, -4 * fine // 3)
    assert np.max(np.abs(want - got)[core, core]) < 2e-3


@settings(max_examples=25)
@given(st.floats(0.05, 50.0), st.floats(0.0, 1.0))
def test_a_constant_target_in_its_own_colour_stays_constant(
    bandwidth: float, radiance: float
) -> None:
    target = CellTarget(np.full((3, 4), radiance), (3.0, 4.0), surround=radiance)
    at = np.linspace(-6, 6, 31)
    assert target.sample(at, at, bandwidth) == pytest.approx(radiance, abs=1e-9)


def test_sampling_is_linear_in_the_cells_and_moves_with_them() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.random((2, 6, 6))
    at = np.linspace(-5, 5, 40)

    def sampled(cells: Floats) -> Floats:
        return CellTarget(cells, (6.0, 6.0)).sample(at, at, 0.8)

    np.testing.assert_allclose(sampled(a + 2 * b), sampled(a) + 2 * sampled(b), atol=1e-12)
    moved = CellTarget(np.pad(a, ((2, 0), (0, 4))), (8.0, 10.0)).sample(
        at + 1.0, at - 2.0, 0.8
    )
    np.testing.assert_allclose(moved, sampled(a), atol=1e-9)


@pytest.mark.parametrize("ends", [(-20.0, -16.0), (-15.4, -12.0), (-0.3, 0.3), (6.0, 19.0)])
def test_samples_of_a_part_are_those_of_the_whole(ends: tuple[float, float]) -> None:
    target = CellTarget(carpet_cells(4), (30.0, 30.0))
    every = np.linspace(-20, 20, 801)
    part = (every >= ends[0]) & (every <= ends[1])
    whole = target.sample(every, every, 1.5)
    # sums of more terms round otherwise
    assert np.allclose(
        target.sample(every[part], every, 1.5), whole[part], rtol=0, atol=1e-12
    )


def test_all_of_the_light_arrives() -> None:
    target = CellTarget(carpet_cells(2), (2.0, 2.0))
    at = (np.arange(300) - 150) * 0.05
    assert target.sample(at, at, 5.0).sum() * 0.05**2 == pytest.approx(
        4.0 * (1 - (8 / 9) ** 2), rel=1e-4
    )


def test_rows_run_down_and_columns_run_right() -> None:
    cells = np.zeros((3, 3))
    cells[0, 2] = 1.0
    target = CellTarget(cells, (3.0, 3.0))
    at = np.array([-1.0, 0.0, 1.0])
    assert target.sample(at, at, 1.0).argmax() == 2
    np.testing.assert_array_equal(target.radiance(at[:, None], at), cells)


def test_point_values_are_the_surround_outside() -> None:
    target = CellTarget(np.zeros((2, 2)), (1.0, 1.0), surround=1.0)
    np.testing.assert_array_equal(
        target.radiance([-0.51, -0.49, 0.49, 0.51], 0.0), [1.0, 0.0, 0.0, 1.0]
    )


def test_nine_million_samples_of_a_fifth_order_carpet_take_under_half_a_second() -> None:
    target = CellTarget(carpet_cells(5), (46.8, 46.8))
    at = np.linspace(-25, 25, 3000)
    target.sample(at[:10], at[:10], 20.0)

    def seconds() -> float:
        begun = time.process_time()
        target.sample(at, at, 20.0)
        return time.process_time() - begun

    assert min(seconds() for _ in range(4)) < 0.5


@pytest.mark.parametrize(
    ("cells", "size_mm", "says"),
    [
        (np.zeros(3), (1.0, 1.0), "rows and columns"),
        (np.full((2, 2), np.nan), (1.0, 1.0), "finite"),
        (np.full((2, 2), -1.0), (1.0, 1.0), "not negative"),
        (np.zeros((2, 2)), (0.0, 1.0), "longer than 0 mm"),
    ],
)
def test_an_impossible_target_is_refused(
    cells: Floats, size_mm: tuple[float, float], says: str
) -> None:
    with pytest.raises(TargetError, match=says):
        CellTarget(cells, size_mm)


def test_a_bandwidth_must_be_above_zero() -> None:
    with pytest.raises(ValueError, match="above 0"):
        CellTarget(np.zeros((2, 2)), (1.0, 1.0)).sample([0.0], [0.0], 0.0)
