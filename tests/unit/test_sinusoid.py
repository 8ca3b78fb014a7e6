"""The sinusoid of thesis §4.2: optima and gaps against SciPy's, and the order of the tests' ROC curves."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar

from labkit.experiments.roc import area, detection
from labkit.experiments.sinusoid import (
    HIGHEST,
    TRUE,
    Optima,
    X,
    chirp_gap,
    find_optima,
    linear_gap,
    one_sided,
    relaxation,
    two_sided,
)
from labkit.types import Floats

DRAWS = 400


@cache
def draws() -> list[tuple[Floats, Optima]]:
    """Data whose global optimum is the true one and which have another."""
    rng = np.random.default_rng(7)
    pairs = [(data, find_optima(data)) for data in np.sin(TRUE * X) + rng.normal(size=(DRAWS, X.size))]
    return [(data, found) for data, found in pairs if found is not None and abs(found.best - TRUE) < 0.5]


@cache
def statistics(name: str) -> tuple[Floats, Floats]:
    """Of right and of wrong optima."""
    test = {
        "two-sided": two_sided,
        "one-sided": one_sided,
        "chirp, 1 degree": chirp_gap(1),
        "chirp, 3 degrees": chirp_gap(3),
        "Algorithm 4.9": linear_gap(relaxation()),
    }[name]
    right, wrong = ([test(data, getattr(found, which)) for data, found in draws()] for which in ("best", "other"))
    return np.array(right), np.array(wrong)


def test_optima_are_those_of_a_bounded_search() -> None:
    for data, found in draws()[:10]:
        edges = np.linspace(0, HIGHEST, 41)
        ends = [
            minimize_scalar(lambda t, d=data: np.sum((d - np.sin(t * X)) ** 2), bounds=(a, b), method="bounded")
            for a, b in pairwise(edges)
        ]
        assert found.best == pytest.approx(min(ends, key=lambda end: end.fun).x, abs=1e-3)
        assert min(abs(found.other - end.x) for end in ends) < 1e-3


@pytest.mark.parametrize("degrees", [1, 3])
def test_the_gap_of_the_chirp_is_that_of_scipys_climb(degrees: int) -> None:
    data, found = draws()[0]
    powers = X ** np.arange(1, degrees + 2)[:, None]
    start = np.append(found.best, np.zeros(degrees))

    def residual(t: Floats) -> Floats:
        return np.asarray(data - np.sin(t @ powers))

    climbed = least_squares(residual, start)
    before = 0.5 * np.sum((data - np.sin(found.best * X)) ** 2)
    assert chirp_gap(degrees)(data, found.best) == pytest.approx(before - climbed.cost, abs=1e-4)


def test_the_gap_of_a_linear_relaxation_is_that_of_scipys_climb() -> None:
    directions = relaxation(2)
    np.testing.assert_allclose(directions @ directions.T, np.eye(2), atol=1e-12)
    data, found = draws()[0]
    start = np.append(found.best, np.zeros(2))

    def residual(t: Floats) -> Floats:
        return np.asarray(data - np.sin(t[0] * X) - t[1:] @ directions)

    climbed = least_squares(residual, start)
    before = 0.5 * np.sum((data - np.sin(found.best * X)) ** 2)
    assert linear_gap(directions)(data, found.best) == pytest.approx(before - climbed.cost, abs=1e-4)


def test_one_sided_is_above_two_sided_everywhere() -> None:
    alarms = np.linspace(0.02, 0.98, 49)
    lead = detection(*statistics("one-sided"), alarms) - detection(*statistics("two-sided"), alarms)
    count = len(draws())
    assert lead.min() > -2 * np.sqrt(0.25 / count)  # two standard errors of a detected share, at its largest
    assert area(*statistics("one-sided")) > area(*statistics("two-sided")) + 0.01


@pytest.mark.slow
def test_embeddings_are_above_both() -> None:
    for name in ("chirp, 3 degrees", "Algorithm 4.9"):
        assert area(*statistics(name)) > area(*statistics("one-sided"))


@pytest.mark.slow
def test_more_degrees_of_the_chirp_tell_more() -> None:
    # from the deepest wrong optimum one degree leads into another wrong optimum, three lead out
    assert area(*statistics("chirp, 3 degrees")) > area(*statistics("chirp, 1 degree")) + 0.05
