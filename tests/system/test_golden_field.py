"""A field of an independent simulator: six carpets at three ranges, in three colours, against its truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labkit

GOLDEN_FOLDER = Path(__file__).parents[3] / "shared" / "golden"
SIMULATED = GOLDEN_FOLDER / "field-open"

pytestmark = [
    pytest.mark.skipif(not SIMULATED.exists(), reason="needs ../shared"),
    pytest.mark.timeout(900),
]


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        (GOLDEN_FOLDER / "truth-field-open.json").read_text()
    )
    return found


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> labkit.Results:
    session = tmp_path_factory.mktemp("field") / "night"
    labkit.import_frames(SIMULATED / "frames.csv", SIMULATED / "plan.toml", session)
    labkit.fit(session, workers=2)
    return labkit.Results.load(session)


def test_tilt_curvature_and_best_focus_are_within_their_errors(
    results: labkit.Results, truth: dict[str, Any]
) -> None:
    field = results.field
    assert field is not None
    tilt, covariance = field.sensor_tilt
    errors = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(tilt - truth["tilt_um_per_mm"]) < 3 * errors)
    # measured 0.019 and 0.012 µm/mm
    assert np.all(errors < 0.04)
    curvature = field.curvature
    assert abs(curvature.value - truth["curvature_per_mm"]) < 3 * curvature.std
    assert curvature.std < 7e-5
    assert results.focus is not None
    for channel, focus_mm in truth["best_focus_mm"].items():
        found = results.focus[channel]
        assert abs(found.value - focus_mm) < 3 * found.std
        assert found.std < 0.1


def test_every_tile_has_its_wavefront_and_its_place(
    results: labkit.Results, truth: dict[str, Any]
) -> None:
    tiles = {(t["range_mm"], t["channel"], tuple(t["tile"])): t for t in truth["tiles"]}
    assert len(results) == len(tiles) == 54
    pulls = []
    for wavefront in results:
        assert wavefront.accepted
        assert wavefront.placement is not None
        assert wavefront.tile is not None
        assert wavefront.range_mm is not None
        tile = tiles[wavefront.range_mm, wavefront.channel, wavefront.tile]
        modes = np.array([tile["modes"][str(j)] for j in wavefront.noll])
        # measured 0.0006 waves at most
        assert np.linalg.norm(wavefront.waves - modes) < 0.0012
        away = np.subtract(wavefront.placement.centre_px, tile["centre_px"])
        assert np.abs(away).max() < 0.008
        assert wavefront.pulls is not None
        pulls.append(wavefront.pulls)
    # of tiles held out, measured 1.01
    assert np.std(pulls) == pytest.approx(1, abs=0.15)


def test_nothing_is_invented_of_camera_or_lens(results: labkit.Results) -> None:
    assert results.model_parts == {}
    codes = {finding.code for finding in results.findings}
    assert codes.isdisjoint({"lens-changed", "cones-contradict-one-lens", "two-camps"})
