"""The smoothest extension against dense linear algebra and calculus."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from labkit.experiments.methods.smooth_extension import fill, roughness

SHAPES = st.sampled_from([(7,), (8,), (5, 6), (6, 6), (3, 4, 5)])


def weighted_transform(shape: tuple[int, ...]) -> np.ndarray:
    """W F as one matrix: every sample's DFT, written out, each line times its frequency in radians per sample."""
    at = np.stack([axis.ravel() for axis in np.indices(shape)])
    line = np.stack(
        [
            (axis.ravel() + n // 2) % n - n // 2
            for axis, n in zip(np.indices(shape), shape, strict=True)
        ]
    )
    per_sample = 2 * np.pi * line / np.array(shape)[:, None]
    matrix: np.ndarray = np.linalg.norm(per_sample, axis=0)[:, None] * np.exp(
        -1j * per_sample.T @ at
    )
    return matrix


def holes(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    known: np.ndarray = rng.random(shape) < rng.uniform(0.1, 0.9)
    known.flat[rng.integers(known.size)] = True
    return known


@given(SHAPES, st.integers(0, 2**32 - 1))
def test_holes_are_filled_as_dense_least_squares_fills_them(
    shape: tuple[int, ...], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    known, f = holes(rng, shape), rng.normal(size=shape)
    matrix = weighted_transform(shape)
    unknown = matrix[:, ~known.ravel()]
    fixed = matrix[:, known.ravel()] @ f[known]
    stacked, wanted = (np.concatenate([a.real, a.imag]) for a in (unknown, -fixed))
    got = fill(f, known)
    np.testing.assert_array_equal(got[known], f[known])
    np.testing.assert_allclose(got[~known], np.linalg.lstsq(stacked, wanted)[0], atol=1e-6)


@given(SHAPES, st.integers(0, 2**32 - 1))
def test_roughness_and_its_gradient_are_exact(shape: tuple[int, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    f, step = rng.normal(size=(2, *shape))
    value, slope = roughness(f)
    assert value == pytest.approx(
        0.5 * np.sum(np.abs(weighted_transform(shape) @ f.ravel()) ** 2) / f.size
    )
    # a quadratic's second-order remainder is the quadratic itself
    assert roughness(f + step)[0] - value - np.vdot(slope, step) == pytest.approx(
        roughness(step)[0]
    )


def test_roughness_is_the_integral_of_the_squared_slope() -> None:
    n = 9

    def wave(t: float) -> float:
        return float(
            0.3 + np.cos(2 * np.pi * 2 * t / n + 0.4) - 0.5 * np.sin(2 * np.pi * 4 * t / n)
        )

    def squared_slope(t: float) -> float:
        one, other = 2 * np.pi * 2 / n, 2 * np.pi * 4 / n
        return float((one * np.sin(one * t + 0.4) + 0.5 * other * np.cos(other * t)) ** 2)

    samples = np.array([wave(t) for t in range(n)])
    assert roughness(samples)[0] == pytest.approx(0.5 * quad(squared_slope, 0, n)[0])


def test_no_other_filling_is_smoother() -> None:
    rng = np.random.default_rng(4)
    known, f = holes(rng, (16, 15)), rng.normal(size=(16, 15))
    filled = fill(f, known)
    for _ in range(20):
        other = filled + np.where(known, 0, rng.normal(0, 1e-3, f.shape))
        assert roughness(other)[0] > roughness(filled)[0]


def test_one_known_sample_is_enough_and_nothing_unknown_is_no_work() -> None:
    known = np.zeros((32, 32), bool)
    known[3, 4] = True
    np.testing.assert_allclose(fill(np.full((32, 32), 2.0), known), 2.0, atol=1e-12)
    f = np.random.default_rng(0).normal(size=(4, 4))
    np.testing.assert_array_equal(fill(f, np.ones((4, 4), bool)), f)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda: fill(np.ones((3, 3)), np.ones((3, 2), bool)),
            r"known has shape \(3, 2\); a mask of shape \(3, 3\)",
        ),
        (
            lambda: fill(np.ones(3), np.ones(3)),  # type: ignore[arg-type]
            "known: a boolean mask",
        ),
        (
            lambda: fill(np.ones(3), np.zeros(3, bool)),
            r"known, shape \(3,\): not one sample is known",
        ),
        (
            lambda: fill(np.array([1, np.nan]), np.array([False, True])),
            "signal.*1 of 2 values are not finite .*radiance",
        ),
        (
            lambda: fill(np.array([1, 1j]), np.array([True, True])),
            "signal: real numbers are needed .*complex128",
        ),
        (lambda: roughness(np.array([np.inf])), "signal.*not finite"),
    ],
)
def test_what_cannot_be_extended_is_refused_in_words(
    call: Callable[[], object], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        call()


def test_unknown_samples_may_hold_anything() -> None:
    known = np.array([True, False, True, False])
    np.testing.assert_allclose(
        fill(np.array([1.0, np.nan, 3.0, np.inf]), known),
        fill(np.array([1.0, 0, 3, 0]), known),
    )
