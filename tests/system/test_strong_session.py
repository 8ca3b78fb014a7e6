"""A session through a lens with one wave RMS in Noll's modes 5 to 37, of which its plan says nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import labkit
from benchmarks.claims import limit
from benchmarks.random_sessions import KINDS, make

CLAIM = "strong"


@pytest.mark.timeout(1800)
def test_one_wave_in_many_modes_is_found_from_nothing(tmp_path: Path) -> None:
    drawn = KINDS["many-modes-37-one-wave"](1, 0)
    truth = make(drawn, tmp_path / "session")
    results = labkit.fit(tmp_path / "session", workers=1)
    modes = truth.modes_waves["G"]
    for wavefront, visit in zip(results, truth.visits, strict=True):
        assert wavefront.test is not None
        assert wavefront.test.accepted
        assert wavefront.noll == tuple(range(4, 38))
        true = [{**modes, 4: visit.defocus_waves["G"]}[j] for j in wavefront.noll]
        errors = np.subtract(wavefront.waves, true)
        assert np.linalg.norm(errors) < limit(CLAIM, "wavefront_waves")
        assert np.abs(errors / wavefront.std).max() < limit(CLAIM, "z_most")
    assert results.focus is not None
    best = results.focus.best_focus_mm["G"]
    # the encoder counts from the zero that homing and tape left
    true_mm = truth.best_focus_mm["G"] + truth.range_zero_mm - truth.visits[0].range_zero_mm
    assert abs(best.value - true_mm) < limit(CLAIM, "best_focus_mm")
    assert results.model_parts == {}
