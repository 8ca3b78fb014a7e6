"""The subgroups of perspective, against the thesis's matrices, OpenCV and Taylor's remainder."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labkit.experiments.methods.warp_groups import (
    DEGREES,
    WarpGroup,
    warp,
    warp_derivatives,
)

CENTRE = (3.0, 4.0)


def near_identity(group: WarpGroup, rng: np.random.Generator) -> np.ndarray:
    scale = np.full(group.dof, 0.2)
    scale[6:] = 0.01
    return np.asarray(group.identity() + rng.uniform(-1, 1, group.dof) * scale)


def by_the_thesis(dof: int, x: np.ndarray) -> np.ndarray:
    """Appendix C, as printed."""
    x = np.concatenate([[np.nan], x])
    c, s = np.cos, np.sin
    rows = {
        1: lambda: [[c(x[1]), -s(x[1]), 0], [s(x[1]), c(x[1]), 0], [0, 0, 1]],
        2: lambda: [[1, 0, x[1]], [0, 1, x[2]], [0, 0, 1]],
        3: lambda: [[c(x[3]), -s(x[3]), x[1]], [s(x[3]), c(x[3]), x[2]], [0, 0, 1]],
        4: lambda: [
            [x[3] * c(x[4]), -x[3] * s(x[4]), x[1]],
            [x[3] * s(x[4]), x[3] * c(x[4]), x[2]],
            [0, 0, 1],
        ],
        5: lambda: [
            [x[3] * c(x[5]), -x[4] * s(x[5]), x[1]],
            [x[3] * s(x[5]), x[4] * c(x[5]), x[2]],
            [0, 0, 1],
        ],
        6: lambda: [[x[3], x[5], x[1]], [x[4], x[6], x[2]], [0, 0, 1]],
        8: lambda: [[x[3], x[5], x[1]], [x[4], x[6], x[2]], [x[7], x[8], 1]],
    }
    return np.array(rows[dof]())


def remainders(
    value: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    way: np.ndarray,
    steps: tuple[float, ...],
) -> list[float]:
    """Largest errors of the second-order Taylor series after each step."""
    first, second = (
        np.tensordot(way, gradient, 1),
        np.einsum("i,j,ij...->...", way, way, hessian),
    )
    return [
        float(np.abs(value(x + h * way) - value(x) - h * first - h**2 / 2 * second).max())
        for h in steps
    ]


@pytest.mark.parametrize("dof", DEGREES)
def test_matrices_are_the_thesiss_and_the_identity_is_one(dof: int) -> None:
    group, rng = WarpGroup(dof), np.random.default_rng(dof)
    x = near_identity(group, rng)
    np.testing.assert_allclose(group.matrix(x), by_the_thesis(dof, x), atol=1e-15)
    np.testing.assert_array_equal(group.matrix(group.identity()), np.eye(3))


@pytest.mark.parametrize("dof", DEGREES)
def test_points_go_where_opencv_sends_them_back(dof: int) -> None:
    group, rng = WarpGroup(dof), np.random.default_rng(dof)
    x, points = near_identity(group, rng), rng.uniform(-3, 8, (2, 40))
    moved = cv2.perspectiveTransform(
        (points - np.array([CENTRE]).T).T[None], np.linalg.inv(by_the_thesis(dof, x))
    )
    np.testing.assert_allclose(
        group.to_object(x, points, CENTRE), moved[0].T + np.array([CENTRE]).T, atol=1e-12
    )


@pytest.mark.parametrize("dof", DEGREES)
def test_coordinates_leave_a_remainder_of_third_order(dof: int) -> None:
    group, rng = WarpGroup(dof), np.random.default_rng(dof)
    x, points, way = (
        near_identity(group, rng),
        rng.uniform(-3, 8, (2, 5, 8)),
        rng.normal(size=dof),
    )
    way[6:] *= 0.02
    by_x, by_xx = group.to_object_derivatives(x, points, CENTRE)
    assert (by_x.shape, by_xx.shape) == ((dof, 2, 5, 8), (dof, dof, 2, 5, 8))
    one, half = remainders(
        lambda v: group.to_object(v, points, CENTRE), x, by_x, by_xx, way, (2e-3, 1e-3)
    )
    # a half step leaves an eighth, but for the fourth order; a pure shift leaves rounding only
    assert half < 1e-12 or one / half == pytest.approx(8, rel=0.05)


@pytest.mark.parametrize("dof", DEGREES)
def test_warped_images_leave_a_remainder_of_third_order(dof: int) -> None:
    group, rng = WarpGroup(dof), np.random.default_rng(dof + 10)
    image = rng.normal(size=(24, 27))
    x, way = near_identity(group, rng), rng.normal(size=dof)
    way[6:] *= 0.02
    where = rng.uniform(4, 20, (2, 300))
    fraction = group.to_object(x, where, ((24 - 1) / 2, (27 - 1) / 2)) % 1
    where = where[
        :, np.all((fraction > 0.1) & (fraction < 0.9), axis=0)
    ]  # no step may pass a sample
    by_x, by_xx = warp_derivatives(image, group, x, where)
    one, half = remainders(
        lambda v: warp(image, group, v, where), x, by_x, by_xx, way, (2e-3, 1e-3)
    )
    assert one / half == pytest.approx(8, rel=0.05)


@given(st.sampled_from([1, 2, 3, 4, 6]), st.integers(0, 2**32 - 1))
def test_a_subgroup_holds_its_products(dof: int, seed: int) -> None:
    group, rng = WarpGroup(dof), np.random.default_rng(seed)
    product = group.matrix(near_identity(group, rng)) @ group.matrix(
        near_identity(group, rng)
    )
    angle = np.arctan2(product[1, 0], product[0, 0])
    size = np.hypot(product[0, 0], product[1, 0])
    shifts = list(product[:2, 2])
    x = {1: [angle], 2: shifts, 3: [*shifts, angle], 4: [*shifts, size, angle]}
    x[6] = [*shifts, *product[:2, 0], *product[:2, 1]]
    np.testing.assert_allclose(group.matrix(np.array(x[dof])), product, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_a_smooth_picture_is_moved_as_geometry_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    group = WarpGroup(8)
    x, rows = near_identity(group, rng), np.arange(64.0)
    wave = 2 * np.pi * np.array([3, 2]) / 64  # whole periods on the torus
    image = np.cos(wave[0] * rows[:, None] + wave[1] * rows + 0.4)
    where = rng.uniform(20, 44, (2, 50))
    at = group.to_object(x, where, (31.5, 31.5))
    # Keys' error for a wave of k radians a sample is below k^3 / 6 (Keys 1981, (17), for k = 0.29: 0.0042)
    np.testing.assert_allclose(
        warp(image, group, x, where), np.cos(wave @ at + 0.4), atol=0.0042
    )


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: WarpGroup(7), "dof = 7"),
        (lambda: WarpGroup(3).matrix(np.zeros(2)), r"x has shape \(2,\); \(3,\) is needed"),
        (lambda: WarpGroup(1).matrix(np.array([np.nan])), "not finite"),
        (lambda: WarpGroup(4).to_object(np.zeros(4), np.zeros((2, 1))), "singular"),
        (
            lambda: WarpGroup(1).to_object(np.zeros(1), np.zeros((3, 1))),
            r"where has shape \(3, 1\)",
        ),
        (
            lambda: WarpGroup(8).to_object(
                np.array([0, 0, 1, 0, 0, 1, 0.1, 0]), np.array([[0.0, 30.0], [0, 0]])
            ),
            "where: 1 of 2 points .* horizon",
        ),
        (
            lambda: WarpGroup(8).to_object(
                np.array([0, 0, 1, 0, 0, 1, 0.1, 0]), np.array([[30.0, 31.0], [0, 0]])
            ),
            "where: 2 of 2 points .* horizon",
        ),
        (
            lambda: warp(np.zeros(3), WarpGroup(1), np.zeros(1), np.zeros((2, 1))),
            r"image has shape \(3,\)",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(
    call: Callable[[], object], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        call()
