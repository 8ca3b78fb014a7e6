"""Zernike orders against the published tables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labkit.optics.orders import (
    coefficients,
    fringe_to_noll,
    noll_to_fringe,
    noll_to_osa,
    osa_to_noll,
)
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import cartesian, nm_to_noll, noll_to_nm, zernike
from labkit.types import Floats

# ANSI Z80.28-2004, table of (n, m) from j = 0; the same in Thibos et al., J. Refract. Surg. 18, S652 (2002), table 2
OSA = [
    *[(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2), (3, -3), (3, -1), (3, 1), (3, 3)],
    *[
        (4, -4),
        (4, -2),
        (4, 0),
        (4, 2),
        (4, 4),
        (5, -5),
        (5, -3),
        (5, -1),
        (5, 1),
        (5, 3),
        (5, 5),
    ],
    *[(6, -6), (6, -4), (6, -2), (6, 0), (6, 2), (6, 4), (6, 6)],
]

# Wyant and Creath, Appl. Opt. Optical Eng. 11 (1992), ch. 1, table of Fringe polynomials, counted from 1; m < 0 for a sine
FRINGE = [
    *[
        (0, 0),
        (1, 1),
        (1, -1),
        (2, 0),
        (2, 2),
        (2, -2),
        (3, 1),
        (3, -1),
        (4, 0),
        (3, 3),
        (3, -3),
        (4, 2),
        (4, -2),
    ],
    *[
        (5, 1),
        (5, -1),
        (6, 0),
        (4, 4),
        (4, -4),
        (5, 3),
        (5, -3),
        (6, 2),
        (6, -2),
        (7, 1),
        (7, -1),
        (8, 0),
    ],
    *[
        (5, 5),
        (5, -5),
        (6, 4),
        (6, -4),
        (7, 3),
        (7, -3),
        (8, 2),
        (8, -2),
        (9, 1),
        (9, -1),
        (10, 0),
    ],
]

NOLL = tuple(range(4, 38))


def fitted(waves: Floats, covariance: Floats | None = None) -> FittedWavefront:
    modes = len(waves)
    return FittedWavefront(
        NOLL[:modes],
        waves,
        np.eye(modes) if covariance is None else covariance,
        550.0,
        450.0,
        2.8,
    )


@pytest.mark.parametrize(("j", "nm"), list(enumerate(OSA)))
def test_osa_numbers_are_the_standards(j: int, nm: tuple[int, int]) -> None:
    assert noll_to_nm(osa_to_noll(j)) == nm


@pytest.mark.parametrize(("j", "nm"), [*enumerate(FRINGE, 1), (49, (12, 0))])
def test_fringe_numbers_are_the_published_ones(j: int, nm: tuple[int, int]) -> None:
    assert noll_to_nm(fringe_to_noll(j)) == nm


@given(st.integers(1, 2000))
def test_every_number_comes_back(j: int) -> None:
    assert osa_to_noll(noll_to_osa(j)) == j
    assert fringe_to_noll(noll_to_fringe(j)) == j
    assert noll_to_fringe(fringe_to_noll(j)) == j
    assert nm_to_noll(*noll_to_nm(j)) == j


@pytest.mark.parametrize(
    "convert", [osa_to_noll, fringe_to_noll, noll_to_osa, noll_to_fringe]
)
def test_a_number_before_the_first_is_refused(convert: Callable[[int], int]) -> None:
    with pytest.raises(ValueError, match=r"counted from [01]"):
        convert(-1)


@pytest.mark.parametrize(
    ("number", "polynomial"),
    [
        (4, lambda r, t: 2 * r**2 - 1),
        (5, lambda r, t: r**2 * np.cos(2 * t)),
        (8, lambda r, t: (3 * r**3 - 2 * r) * np.sin(t)),
        (9, lambda r, t: 6 * r**4 - 6 * r**2 + 1),
        (12, lambda r, t: (4 * r**4 - 3 * r**2) * np.cos(2 * t)),
        (16, lambda r, t: 20 * r**6 - 30 * r**4 + 12 * r**2 - 1),
        (22, lambda r, t: (15 * r**6 - 20 * r**4 + 6 * r**2) * np.sin(2 * t)),
    ],
)
def test_a_fringe_coefficient_multiplies_the_published_polynomial(
    number: int, polynomial: Callable[[Floats, Floats], Floats]
) -> None:
    rho, theta = np.array([0.0, 0.3, 0.8, 1.0]), np.array([0.2, 1.0, 2.5, 4.0])
    wavefront = fitted(np.where(np.array(NOLL) == fringe_to_noll(number), 0.1, 0.0))
    fringe = coefficients(wavefront, "fringe")
    (place,) = np.flatnonzero(fringe.waves)
    assert fringe.index[place] == number
    path = wavefront.opd(rho * np.cos(theta), rho * np.sin(theta))
    np.testing.assert_allclose(
        fringe.waves[place] * polynomial(rho, theta), path, atol=1e-12
    )


def test_covariances_are_sorted_and_scaled_with_their_coefficients() -> None:
    root = np.random.default_rng(1).normal(size=(12, 12))
    wavefront = fitted(np.arange(12.0), root @ root.T)
    fringe = coefficients(wavefront, "fringe")
    a, b = fringe.index.index(9), fringe.index.index(7)  # spherical and coma: Noll 11 and 8
    assert fringe.covariance[a, b] == pytest.approx(
        wavefront.covariance[7, 4] * np.sqrt(5) * np.sqrt(8)
    )
    assert fringe.std[a] == pytest.approx(np.sqrt(5) * wavefront.std[7])
    osa = coefficients(wavefront, "osa")
    assert osa.index == tuple(range(3, 15))
    assert osa.waves[osa.index.index(4)] == 0.0  # defocus


def test_another_order_is_refused() -> None:
    with pytest.raises(ValueError, match="order 'zemax': one of noll, osa, fringe"):
        coefficients(fitted(np.zeros(2)), "zemax")  # type: ignore[arg-type]


@pytest.mark.parametrize("j", [1, 2, 3, 4, 7, 8, 11, 22, 37, 66, 120])
def test_a_mode_is_its_polynomial_in_x_and_y(j: int) -> None:
    x, y = np.random.default_rng(j).uniform(-0.7, 0.7, (2, 40))
    values = np.polynomial.polynomial.polyval2d(x, y, cartesian(j))
    np.testing.assert_allclose(
        values, zernike(j, np.hypot(x, y), np.arctan2(y, x)), atol=1e-11
    )


def test_no_mode_has_orders_that_do_not_match() -> None:
    with pytest.raises(ValueError, match="radial order 3 and azimuthal order 2"):
        nm_to_noll(3, 2)
