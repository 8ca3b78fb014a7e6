"""The test of an optimum by what it leaves: noise that nobody calibrated, Bayer planes, several frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.estimation.climb import NoisePrior, Problem, State
from labkit.estimation.likelihood import FrameData
from labkit.estimation.residuals import Verdict, judge
from labkit.estimation.settings import SETTINGS
from labkit.optics.other_circle import root_over_clear_part
from labkit.optics.rim import Circle, Rim
from labkit.types import Floats

SHAPE = (24, 26)
ROWS, COLUMNS = np.indices(SHAPE)
RED = (ROWS % 2 == 0) & (COLUMNS % 2 == 0)
GREEN = (ROWS + COLUMNS) % 2 == 1
CALIBRATED, UNKNOWN = NoisePrior(0.5, 0.01, 4.0, 0.01), NoisePrior(0.5, 2.0, 4.0, 2.0)


@dataclass(frozen=True)
class NoModel:
    """Stands where `judge` needs none: the residuals are given."""


def verdict(
    seed: int,
    used: NDArray[np.bool_],
    prior: NoisePrior,
    *,
    louder: float = 1.0,
    pattern: Floats | float = 0.0,
) -> Verdict:
    """On noise of 0.5 counts per electron about 400 u + 30 and read variance 4, `louder` times as strong, and a pattern."""
    rng = np.random.default_rng(seed)
    relative = rng.uniform(0.1, 1, SHAPE)
    mean = 400 * relative + 30
    counts = rng.normal(mean, louder * np.sqrt(0.5 * mean + 4)) + pattern
    frame = FrameData(counts, used, np.ones(SHAPE), np.zeros(SHAPE))
    state = State(np.zeros(3), (None,), np.array([400.0]), np.array([30.0]), prior.centre)  # type: ignore[arg-type]
    return judge(Problem(NoModel(), (frame,), prior), state, [relative[used]])  # type: ignore[arg-type]


def test_behind_a_cats_eye_the_clear_part_decides_what_is_undetermined() -> None:
    """Half a wave of defocus, coma and spherical aberration, which leave a third of it there."""
    accepted, noll = verdict(0, GREEN, CALIBRATED), (4, 8, 11)
    eye = Rim((Circle(), Circle(0.5, 0.95, 0.0)))
    _, vectors = np.linalg.eigh(root_over_clear_part(noll, eye))
    dark = np.diag([1e-4] * 3) + 0.25 * np.outer(vectors[:, 0], vectors[:, 0])
    assert accepted.given_covariance(dark, noll).undetermined
    assert accepted.given_covariance(dark, noll, eye) == accepted
    assert not accepted.given_covariance(25 * dark, noll, eye).accepted


@pytest.mark.parametrize("prior", [CALIBRATED, UNKNOWN], ids=["calibrated", "unknown"])
@pytest.mark.parametrize(
    "used", [np.ones(SHAPE, bool), GREEN, RED], ids=["mono", "green", "red"]
)
def test_noise_alone_is_accepted_on_every_kind_of_plane(
    used: NDArray[np.bool_], prior: NoisePrior
) -> None:
    rejected = sum(not verdict(seed, used, prior).accepted for seed in range(300))
    # 0.3 are expected at a significance of 1e-3; more than 3 come by chance less than once in 3000 times
    assert rejected <= 3
    assert SETTINGS.contradiction_chance == 1e-3


@pytest.mark.parametrize(
    ("used", "lags"), [(np.ones(SHAPE, bool), 8), (GREEN, 6), (RED, 4)]
)
def test_likeness_is_asked_only_at_distances_that_the_plane_has(
    used: NDArray[np.bool_], lags: int
) -> None:
    # of the eight, green lacks (0, 1) and (1, 0), red the diagonals as well; chi2 of k has mean k and variance 2 k
    correlation = [verdict(seed, used, CALIBRATED).correlation for seed in range(300)]
    assert np.mean(correlation) == pytest.approx(lags, abs=4 * np.sqrt(2 * lags / 300))


def test_louder_noise_is_rejected_where_the_noise_was_calibrated() -> None:
    assert not any(
        verdict(seed, GREEN, CALIBRATED, louder=1.5).accepted for seed in range(20)
    )


def test_louder_noise_says_nothing_where_it_was_not() -> None:
    judged = [verdict(seed, GREEN, UNKNOWN, louder=1.5) for seed in range(100)]
    assert {v.excess for v in judged} == {0.0}
    assert sum(not v.accepted for v in judged) <= 2


def test_modes_that_the_data_do_not_tell_are_named_and_rejected() -> None:
    accepted = verdict(0, GREEN, CALIBRATED)
    told = np.diag([1e-4, 4e-4, 1e-4])
    assert accepted.given_covariance(told, (4, 8, 11)) == accepted
    opposed = np.array([1.0, 0.0, -2.0])
    seen = accepted.given_covariance(told + 9 * np.outer(opposed, opposed), (4, 8, 11))
    assert not seen.accepted
    assert seen.undetermined == ("-0.5 defocus +1 spherical",)
    assert accepted.given_covariance(
        np.diag([1e-4, 1.0, 1e-4]), (4, 8, 11)
    ).undetermined == ("horizontal coma",)


@pytest.mark.parametrize("prior", [CALIBRATED, UNKNOWN], ids=["calibrated", "unknown"])
@pytest.mark.parametrize(
    "used", [np.ones(SHAPE, bool), GREEN, RED], ids=["mono", "green", "red"]
)
def test_a_pattern_is_rejected_whether_or_not_the_noise_is_known(
    used: NDArray[np.bool_], prior: NoisePrior
) -> None:
    ripple = 20 * np.sin(COLUMNS / 3) * np.sin(ROWS / 3)
    assert not any(
        verdict(seed, used, prior, pattern=ripple).accepted for seed in range(20)
    )
