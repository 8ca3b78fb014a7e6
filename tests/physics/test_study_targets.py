"""The comparison of targets."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from labkit.experiments.conditions import carpet, draw_trial
from labkit.experiments.targets import READ_NOISES, SPECS, bounds
from labkit.target.target import CellTarget
from tests.studies import quick


def test_a_black_target_tells_nothing_and_that_is_said() -> None:
    trial = draw_trial(np.random.default_rng(0))
    (found,) = bounds(CellTarget(np.zeros((1, 1)), (2.0, 2.0)), trial, [1.0])
    assert math.isinf(found.rms(0, len(trial.noll)))
    assert len(found.undetermined) >= len(trial.noll)


def test_where_read_noise_rules_the_bound_is_as_large_as_it() -> None:
    trial = draw_trial(np.random.default_rng(0))
    low, high = bounds(carpet(), trial, [1e3, 2e3])
    # photons add 37 counts^2 to a million
    assert high.rms(0, 12) / low.rms(0, 12) == pytest.approx(2, rel=1e-3)


def test_the_study_says_how_each_target_compares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = quick("targets", tmp_path, capsys)
    assert [claim["measured"] > 0 for claim in summary["claims"]] == [True] * len(SPECS)
    rows = list(csv.DictReader((tmp_path / "targets.csv").read_text().splitlines()))
    for name in SPECS:
        own = [float(row["rms_bound_waves"]) for row in rows if row["target"] == name]
        assert len(own) == len(READ_NOISES)
        assert own == sorted(own)  # more noise tells less
