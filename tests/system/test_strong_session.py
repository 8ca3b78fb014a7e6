"""A session through a lens with half a wave RMS in Noll's modes 5 to 37, of which its plan says nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import labkit
from benchmarks.random_sessions import KINDS, make


@pytest.mark.timeout(300)
def test_half_a_wave_in_many_modes_is_found_from_nothing(tmp_path: Path) -> None:
    drawn = KINDS["many-modes-37"](1, 0)
    truth = make(drawn, tmp_path / "session")
    results = labkit.fit(tmp_path / "session", workers=1)
    modes = truth.modes_waves["G"]
    for wavefront, visit in zip(results, truth.visits, strict=True):
        assert wavefront.test is not None
        assert wavefront.test.accepted
        true = [{**modes, 4: visit.defocus_waves["G"]}[j] for j in wavefront.noll]
        assert wavefront.noll == tuple(range(4, 38))
        # 0.0020 waves were measured, with a stated error of 0.0023
        assert np.linalg.norm(np.subtract(wavefront.waves, true)[1:]) < 0.004
