"""Sampling between grids, against direct sums, SciPy and counting."""

from collections.abc import Callable
from fractions import Fraction
from math import ceil

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import signal

from labkit.experiments.methods.cubic import Cubic
from labkit.experiments.methods.sampling import Sampling, grid_sizes

RNG = np.random.default_rng(5)
SIZES = st.integers(1, 13)


def sample(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return Sampling(values.shape, shape).apply(values)


def by_direct_summation(values: np.ndarray, count: int) -> np.ndarray:
    """The trigonometric polynomial through the samples, its Nyquist line cos - sin, summed at each new point."""
    n = len(values)
    at = np.arange(count) / count
    result = np.full(count, values.mean())
    for f in range(1, (n - 1) // 2 + 1):
        for wave in (np.cos, np.sin):
            own = wave(2 * np.pi * f * np.arange(n) / n)
            result += 2 / n * (own @ values) * wave(2 * np.pi * f * at)
    if n % 2 == 0:
        own = np.cos(np.pi * np.arange(n))
        result += (own @ values) / n * (np.cos(np.pi * n * at) - np.sin(np.pi * n * at))
    return result


@given(SIZES, SIZES, st.integers(0, 2**32 - 1))
def test_samples_are_those_of_the_trigonometric_polynomial(
    n: int, m: int, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=n)
    np.testing.assert_allclose(
        sample(values, (m,)), by_direct_summation(values, m), atol=1e-12 * n
    )


@pytest.mark.parametrize(("n", "m"), [(9, 21), (9, 16), (15, 15)])
def test_more_samples_of_an_odd_number_are_scipys(n: int, m: int) -> None:
    values = RNG.normal(size=n)
    np.testing.assert_allclose(sample(values, (m,)), signal.resample(values, m), atol=1e-12)


@given(
    st.tuples(SIZES, SIZES, SIZES),
    st.tuples(SIZES, SIZES, SIZES),
    st.integers(0, 2**32 - 1),
)
def test_the_adjoint_of_sampling_is_its_adjoint(
    ours: tuple[int, int, int], theirs: tuple[int, int, int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    f, g = rng.normal(size=ours), rng.normal(size=theirs)
    left, right = (
        np.vdot(sample(f, theirs), g),
        np.vdot(f, Sampling(ours, theirs).adjoint(g)),
    )
    assert left == pytest.approx(
        right, abs=float(1e-11 * np.linalg.norm(f) * np.linalg.norm(g))
    )


def test_finer_and_back_is_the_same_again() -> None:
    values = RNG.normal(size=(6, 7, 4))
    np.testing.assert_allclose(
        sample(sample(values, (12, 21, 8)), (6, 7, 4)), values, atol=1e-12
    )


def test_a_whole_ratio_picks_every_so_many_samples() -> None:
    values = RNG.normal(size=(12, 15))
    np.testing.assert_allclose(sample(values, (4, 5)), values[::3, ::3], atol=1e-12)


def test_energy_is_kept_by_finer_sampling_at_the_nyquist_line_too() -> None:
    values = RNG.normal(size=8)
    assert np.sum(sample(values, (24,)) ** 2) / 24 == pytest.approx(np.sum(values**2) / 8)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Sampling((4,), (2, 2)), "differ in their number of axes"),
        (lambda: Sampling((4,), (0,)), r"result: positive whole numbers of samples"),
        (lambda: Sampling((2,), (3,)).apply(np.array([1.0, np.nan])), "signal.*not finite"),
        (lambda: Sampling((4,), (2,)).apply(np.ones(4) * 1j), "complex128"),  # type: ignore[arg-type]
        (
            lambda: Sampling((4,), (2,)).adjoint(np.ones(4)),
            r"values has shape \(4,\); \(2,\) is needed",
        ),
    ],
)
def test_sampling_refuses_what_it_cannot_do(call: Callable[[], object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        call()


@given(st.floats(0.05, 20), st.integers(1, 30), st.integers(1, 30), st.floats(1e-3, 0.3))
@example(1 / 3, 21, 1, 0.125)  # 21/56 is a rounding error beyond the tolerance
def test_grid_sizes_are_the_smallest_there_are(
    ratio: float, least: int, least_divisor: int, tolerance: float
) -> None:
    z1, z2 = grid_sizes(ratio, least, least_divisor, tolerance)
    exact = Fraction(ratio)
    low, high = exact * (1 - Fraction(tolerance)), exact * (1 + Fraction(tolerance))

    def fits(z2: int) -> bool:
        return max(least, ceil(low * z2)) <= high * z2

    assert z1 >= least
    assert z2 >= least_divisor
    assert low <= Fraction(z1, z2) <= high
    assert not any(fits(smaller) for smaller in range(least_divisor, z2))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((0.0, 1, 1, 0.1), "ratio = 0"),
        ((2.0, 0, 1, 0.1), "source_least = 0"),
        ((2.0, 1, 1, 0.0), "tolerance = 0"),
    ],
)
def test_impossible_grids_are_refused(
    arguments: tuple[float, int, int, float], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        grid_sizes(*arguments)


def keys_by_the_paper(s: np.ndarray) -> np.ndarray:
    """Keys (1981), equation (15)."""
    s = np.abs(s)
    near, far = 1.5 * s**3 - 2.5 * s**2 + 1, -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2
    return np.where(s < 1, near, np.where(s < 2, far, 0))


def test_the_cubic_is_keyss() -> None:
    f, row, col = RNG.normal(size=(20, 18)), RNG.uniform(3, 16, 50), RNG.uniform(3, 14, 50)
    down, across = (
        keys_by_the_paper(row[:, None] - np.arange(20)),
        keys_by_the_paper(col[:, None] - np.arange(18)),
    )
    np.testing.assert_allclose(
        Cubic((20, 18), row, col).apply(f),
        np.einsum("pi,ij,pj->p", down, f, across),
        atol=1e-13,
    )


@pytest.mark.parametrize("order", [(0, 0), (1, 0), (0, 2), (1, 1)])
def test_the_adjoint_of_the_cubic_is_its_adjoint(order: tuple[int, int]) -> None:
    f, g, at = RNG.normal(size=(7, 5)), RNG.normal(size=40), RNG.uniform(-9, 9, (2, 40))
    cubic = Cubic((7, 5), *at)
    assert np.vdot(cubic.apply(f, *order), g) == pytest.approx(
        np.vdot(f, cubic.adjoint(g, *order)), abs=1e-11
    )


def test_the_cubic_reproduces_parabolas_and_their_derivatives() -> None:
    y, x = np.indices((9, 10)).astype(float)
    f = 1.0 + x * y - 2 * x**2 + 3 * y
    b, a = RNG.uniform(2, 6, (2, 30))
    cubic = Cubic(f.shape, b, a)
    np.testing.assert_allclose(cubic.apply(f), 1 + a * b - 2 * a**2 + 3 * b, atol=1e-12)
    np.testing.assert_allclose(cubic.apply(f, 1, 0), a + 3, atol=1e-12)
    np.testing.assert_allclose(cubic.apply(f, 0, 2), -4, atol=1e-12)
    np.testing.assert_allclose(cubic.apply(f, 1, 1), 1, atol=1e-12)


def test_the_cubics_error_falls_with_the_cube_of_the_spacing() -> None:
    at = RNG.uniform(0, 1, 4000)

    def error(n: int) -> float:
        f = np.sin(2 * np.pi * np.arange(n) / n + 0.3)[:, None]
        return float(
            np.abs(
                Cubic((n, 1), at * n, 0 * at).apply(f) - np.sin(2 * np.pi * at + 0.3)
            ).max()
        )

    # of a third-order error every halving of the spacing leaves an eighth
    assert error(256) / error(512) == pytest.approx(8, rel=0.1)


def test_the_cubic_goes_round_the_torus() -> None:
    f, row, col = RNG.normal(size=(5, 6)), np.array([0.3]), np.array([5.7])
    outside = Cubic((5, 6), row + 10, col - 12).apply(f)
    np.testing.assert_allclose(Cubic((5, 6), row, col).apply(f), outside, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Cubic((4, 4), np.zeros(3), np.zeros(4)), "col has shape"),
        (lambda: Cubic((4, 4), np.full(1, np.nan), np.zeros(1)), "row.*not finite"),
        (
            lambda: Cubic((4, 4), np.zeros(1), np.zeros(1)).apply(np.zeros((4, 4)), 0, 3),
            "order 3",
        ),
        (
            lambda: Cubic((4, 4), np.zeros(1), np.zeros(1)).apply(np.zeros(4)),
            "image has shape",
        ),
    ],
)
def test_the_cubic_refuses_what_it_cannot_do(call: Callable[[], object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        call()
