"""The likelihood against finite differences and simulated noise; the verdict on pure noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from labkit.estimation.climb import NoisePrior, Problem, State
from labkit.estimation.likelihood import (
    Detector,
    FrameData,
    log_likelihood,
    low_orders,
    predict,
    score,
)
from labkit.estimation.residuals import judge
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation
from labkit.types import Floats

DETECTOR = Detector(400.0, 30.0, 0.5, 4.0)
SHAPE = (12, 15)
UNEVEN = np.array([0.1, -0.05, 0.02, 0.03, -0.04])


def case(rng: np.random.Generator) -> tuple[Evaluation, FrameData]:
    n = SHAPE[0] * SHAPE[1]
    evaluation = Evaluation(
        rng.uniform(0.1, 1, n), rng.normal(size=(3, n)), rng.normal(size=(8, n))
    )
    frame = FrameData(
        np.zeros(SHAPE),
        np.ones(SHAPE, bool),
        rng.uniform(0.8, 1.2, SHAPE),
        rng.uniform(0.0, 0.02, SHAPE),
    )
    return evaluation, exposed(evaluation.mean, frame, rng)


def exposed(relative: Floats, frame: FrameData, rng: np.random.Generator) -> FrameData:
    """Counts drawn from thesis (3.4), written out here."""
    mean = frame.illumination * (400.0 * relative.reshape(SHAPE) + 30.0)
    variance = 0.5 * mean + 4.0 + (frame.relative_std * mean) ** 2
    return FrameData(
        rng.normal(mean, np.sqrt(variance)),
        frame.used,
        frame.illumination,
        frame.relative_std,
    )


def stepped(evaluation: Evaluation, frame: FrameData, step: Floats) -> float:
    relative = (
        evaluation.mean + step[:3] @ evaluation.by_waves + step[3:11] @ evaluation.by_pose
    )
    noise, uneven = np.exp(step[-2:]), UNEVEN[: step.size - 15] + step[13:-2]
    own = Detector(
        400.0 + step[11],
        30.0 + step[12],
        0.5 * float(noise[0]),
        4.0 * float(noise[1]),
        uneven,
    )
    return log_likelihood(relative, frame, own)


@pytest.mark.parametrize("unknown_light", [False, True])
def test_the_gradient_is_a_finite_difference(unknown_light: bool) -> None:
    evaluation, frame = case(np.random.default_rng(6))
    detector, shapes = DETECTOR, 0
    if unknown_light:
        frame = replace(frame, departures=low_orders(*SHAPE))
        detector, shapes = replace(DETECTOR, unevenness=UNEVEN), UNEVEN.size
    gradient = score(evaluation, frame, detector).gradient
    size = np.array([1e-6] * 11 + [1e-3] * 2 + [1e-5] * (shapes + 2))
    found = [
        (stepped(evaluation, frame, s) - stepped(evaluation, frame, -s)) / (2 * h)
        for s, h in zip(np.diag(size), size, strict=True)
    ]
    np.testing.assert_allclose(gradient, found, rtol=1e-4, atol=1e-4)


def test_the_score_scatters_as_the_information_says() -> None:
    rng = np.random.default_rng(7)
    evaluation, frame = case(rng)
    information = score(evaluation, frame, DETECTOR).information
    draws = [
        score(evaluation, exposed(evaluation.mean, frame, rng), DETECTOR).gradient
        for _ in range(3000)
    ]
    whiten = np.linalg.inv(np.linalg.cholesky(information))
    covariance = whiten @ np.cov(np.array(draws).T) @ whiten.T
    # entries of a covariance of 3000 unit normals err by sqrt(2/3000) at most; allow five (225 of them are looked at)
    assert np.abs(covariance - np.eye(15)).max() < 5 * np.sqrt(2 / 3000)


def test_light_of_low_order_multiplies_the_illumination() -> None:
    evaluation, frame = case(np.random.default_rng(9))
    even, _ = predict(evaluation.mean, frame, DETECTOR)
    frame = replace(frame, departures=low_orders(*SHAPE))
    leaning, _ = predict(
        evaluation.mean,
        frame,
        replace(DETECTOR, unevenness=np.array([0.0, 0.2, 0.0, 0.0, 0.0])),
    )
    np.testing.assert_allclose(
        (leaning / even).reshape(SHAPE)[:, 3], np.linspace(0.8, 1.2, SHAPE[0])
    )


def test_departures_of_another_shape_are_refused() -> None:
    _, frame = case(np.random.default_rng(9))
    with pytest.raises(
        ValueError, match=r"departures has shape \(5, 3, 4\); \(any, 12, 15\) is needed"
    ):
        replace(frame, departures=low_orders(3, 4))


def test_the_variance_follows_the_mean() -> None:
    evaluation, frame = case(np.random.default_rng(8))
    mean, variance = predict(evaluation.mean, frame, DETECTOR)
    expected = 0.5 * mean + 4.0 + (frame.relative_std.ravel() * mean) ** 2
    np.testing.assert_allclose(variance, expected)


@dataclass(frozen=True)
class NoModel:
    """Stands where `judge` needs none: the residuals are given."""


def verdict_on(rng: np.random.Generator, bump: float = 0.0) -> bool:
    evaluation, frame = case(rng)
    frame.counts[4:8, 4:8] += bump
    prior = NoisePrior(0.5, 0.01, 4.0, 0.01)
    problem = Problem(NoModel(), (frame,), prior)  # type: ignore[arg-type]
    state = State(np.zeros(3), (None,), np.array([400.0]), np.array([30.0]), prior.centre)  # type: ignore[arg-type]
    return judge(problem, state, [evaluation.mean]).accepted


def test_pure_noise_is_hardly_ever_rejected() -> None:
    rejected = sum(not verdict_on(np.random.default_rng(seed)) for seed in range(1500))
    # 1.5 are expected at the significance of 1e-3; more than 7 come by chance once in 2000 times
    assert rejected <= 7
    assert SETTINGS.contradiction_chance == 1e-3


def test_structure_is_rejected() -> None:
    assert not any(verdict_on(np.random.default_rng(seed), bump=45.0) for seed in range(20))
