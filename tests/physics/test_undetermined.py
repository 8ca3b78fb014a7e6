"""Frames that cannot tell what is asked are answered with a verdict."""

import numpy as np
import pytest

from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import Guesses, Views, find_optima
from labkit.experiments.conditions import FRAME, Trial, carpet, draw_trial, optics

NOLL = (4, 5, 6, 7)


@pytest.fixture(scope="module")
def trial() -> Trial:
    return draw_trial(np.random.default_rng(40), noll=NOLL)


def parts(trial: Trial) -> dict[str, FrameData]:
    """Of a picture: pixels beside the target; a few of one white square; one grey without any target."""
    counts, one = trial.frame.counts, np.ones((FRAME, FRAME))
    beside, few = np.zeros((2, FRAME, FRAME), bool)
    beside[5:12, 5:12] = few[50:54, 50:54] = True
    grey = np.random.default_rng(41).normal(50, trial.read_noise, (FRAME, FRAME))
    return {
        "beside the target": FrameData(counts, beside, one, 0 * one),
        "few pixels": FrameData(counts, few, one, 0 * one),
        "no target": FrameData(grey, one > 0, one, 0 * one),
    }


@pytest.mark.parametrize("part", ["beside the target", "few pixels", "no target"])
def test_frames_that_tell_no_wavefront_are_rejected_in_words(
    trial: Trial, part: str
) -> None:
    views = Views((parts(trial)[part],), (trial.pose,), trial.noise)
    best = find_optima(
        optics(NOLL), carpet(), views, Guesses(alone=False, most_starts=2)
    ).best
    assert not best.verdict.accepted
    assert any("defocus" in words for words in best.verdict.undetermined)
    assert np.all(np.isfinite(best.covariance))
