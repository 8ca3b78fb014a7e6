"""The sinusoid of thesis §4.2: optima and gaps against SciPy's, and the order of the tests' ROC curves."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar

from labkit.experiments.roc import TESTS, area, detection, draws, statistics
from labkit.experiments.sinusoid import (
    HIGHEST,
    Optima,
    X,
    chirp_gap,
    linear_gap,
    relaxation,
)
from labkit.types import Floats


@cache
def drawn() -> list[tuple[Floats, Optima]]:
    return draws(np.random.default_rng(7), 400)


@cache
def of(name: str) -> tuple[Floats, Floats]:
    """Statistics of right and of wrong optima."""
    return statistics(TESTS[name], drawn())


def test_optima_are_those_of_a_bounded_search() -> None:
    for data, optima in drawn()[:10]:
        edges = np.linspace(0, HIGHEST, 41)
        ends = [
            minimize_scalar(
                lambda t, d=data: np.sum((d - np.sin(t * X)) ** 2),
                bounds=(a, b),
                method="bounded",
            )
            for a, b in pairwise(edges)
        ]
        assert optima.best == pytest.approx(min(ends, key=lambda end: end.fun).x, abs=1e-3)
        assert min(abs(optima.other - end.x) for end in ends) < 1e-3


@pytest.mark.parametrize("degrees", [1, 3])
def test_the_gap_of_the_chirp_is_that_of_scipys_climb(degrees: int) -> None:
    data, optima = drawn()[0]
    powers = X ** np.arange(1, degrees + 2)[:, None]
    start = np.append(optima.best, np.zeros(degrees))

    def residual(t: Floats) -> Floats:
        return np.asarray(data - np.sin(t @ powers))

    climbed = least_squares(residual, start)
    before = 0.5 * np.sum((data - np.sin(optima.best * X)) ** 2)
    assert chirp_gap(degrees)(data, optima.best) == pytest.approx(
        before - climbed.cost, abs=1e-4
    )


def test_the_gap_of_a_linear_relaxation_is_that_of_scipys_climb() -> None:
    directions = relaxation(2)
    np.testing.assert_allclose(directions @ directions.T, np.eye(2), atol=1e-12)
    data, optima = drawn()[0]
    start = np.append(optima.best, np.zeros(2))

    def residual(t: Floats) -> Floats:
        return np.asarray(data - np.sin(t[0] * X) - t[1:] @ directions)

    climbed = least_squares(residual, start)
    before = 0.5 * np.sum((data - np.sin(optima.best * X)) ** 2)
    assert linear_gap(directions)(data, optima.best) == pytest.approx(
        before - climbed.cost, abs=1e-4
    )


def test_one_sided_is_above_two_sided_everywhere() -> None:
    alarms = np.linspace(0.02, 0.98, 49)
    lead = detection(*of("one-sided"), alarms) - detection(
        *of("Biernacki, two-sided"), alarms
    )
    count = len(drawn())
    assert lead.min() > -2 * np.sqrt(
        0.25 / count
    )  # two standard errors of a detected share, at its largest
    assert area(*of("one-sided")) > area(*of("Biernacki, two-sided")) + 0.01


@pytest.mark.slow
def test_embeddings_are_above_both() -> None:
    for name in ("embedding, chirp, 3 degrees", "embedding, Algorithm 4.9, 1 degree"):
        assert area(*of(name)) > area(*of("one-sided"))


@pytest.mark.slow
def test_more_degrees_of_the_chirp_tell_more() -> None:
    # from the deepest wrong optimum one degree leads into another wrong optimum, three lead out
    assert (
        area(*of("embedding, chirp, 3 degrees"))
        > area(*of("embedding, chirp, 1 degree")) + 0.05
    )
