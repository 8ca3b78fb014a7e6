"""Sessions of a grid on the simulated bench: written, imported, and their truth beside them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.field_sessions import (
    FOUR_RANGES_MM,
    LENS,
    MISALIGNED,
    FieldSession,
    field_session,
    make,
)
from labkit.analysis.observe import observe
from labkit.drivers.simulated.setup import settings_for
from labkit.field.flats import session_illumination
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.plan.sensor import Sensor
from labkit.session.import_frames import import_frames
from labkit.target.target import open_target
from tests.plans import SMALL, plan_text, simulated
from tests.results_samples import some_results

TINY = replace(
    LENS,
    f_number=11.0,
    aberration_waves=0.0,
    field_terms=replace(MISALIGNED, coma_waves=(0.0, 0.0), coma_per_mm=0.0, cos4=1.0),
)
"""Without coma, which moves the centroid of light from the chief ray."""


def tiny(tile_px: int = 64) -> FieldSession:
    """A grid of carpets too small to be measured, which takes a moment."""
    return field_session((1, 2), (1180.0, 1260.0), TINY, tile_px=tile_px, order=2)


def test_a_written_session_imports_and_has_its_truth_beside_it(tmp_path: Path) -> None:
    session = tiny()
    made = make(session, tmp_path / "shots")
    found = import_frames(
        tmp_path / "shots/frames.csv", tmp_path / "shots/plan.toml", tmp_path / "session"
    )
    kinds = [frame.kind for frame in found.frames]
    assert (kinds.count("target"), kinds.count("flat"), kinds.count("dark")) == (2, 4, 2)
    assert found.plan.target.grid == (1, 2)
    truth = json.loads((tmp_path / "shots/truth.json").read_text())
    assert truth == json.loads(made.to_json())
    assert [len(visit["tiles"]) for visit in truth["visits"]] == [6, 6]
    results = some_results(folder=found.folder / "results/latest", plan=found.plan)
    lights = session_illumination(results)
    assert set(lights) == {"R", "B"}
    corners = [number.value for number in lights["R"].corners.values()]
    # a tenth is lost in the corners by vignetting, and hardly anything by the fourth power of the cosine
    assert np.mean(corners) == pytest.approx(90, abs=2)


def test_a_clipped_tile_is_left_out_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tiny(), tmp_path / "shots")
    session = import_frames(
        tmp_path / "shots/frames.csv", tmp_path / "shots/plan.toml", tmp_path / "session"
    )

    def overexposed(path: Path, sensor: Sensor, cut: Cut = WHOLE) -> Photograph:
        picture = read_photograph(path, sensor, cut)
        counts = picture.counts.copy()
        right = slice(counts.shape[1] // 2, None)
        counts[:, right] = (600 + 4 * (counts[:, right] - 600.0)).clip(0, picture.white)
        return replace(picture, counts=counts)

    monkeypatch.setattr("labkit.analysis.observe.read_photograph", overexposed)
    target = open_target(session.plan.target)
    observations, findings = observe(session, session.plan, target, channel="G")
    assert {o.tile for o in observations} == {(0, 0)}
    left_out = [f for f in findings if f.code == "tile-left-out"]
    assert [f.key and f.key.tile for f in left_out] == [(0, 1), (0, 1)]
    assert "the others are clipped or unlit" in left_out[0].text


def test_carpets_lie_where_the_truth_has_their_centres(tmp_path: Path) -> None:
    session = tiny()
    truth = make(session, tmp_path / "shots")
    target, flat = (
        read_photograph(tmp_path / f"shots/{kind}_1180_0.dng", session.plan.sensor).counts
        for kind in ("target", "flat")
    )
    green = ((target - 600.0) / (flat - 600.0))[0::2, 1::2]
    row, col = np.indices(green.shape)
    for tile in truth.visits[0].tiles:
        if tile.channel == "G":
            near = np.abs(2 * col + 1 - tile.centre_px[1]) < 28
            light = np.where(near, green, 0.0)
            middle = (2 * row * light).sum(), ((2 * col + 1) * light).sum()
            # a carpet is symmetric; noise, hot pixels and samples two pixels apart leave 0.13
            np.testing.assert_allclose(middle / light.sum(), tile.centre_px, atol=0.2)


def test_a_grid_of_three_by_four_has_a_tile_for_each_carpet() -> None:
    session = field_session((3, 4), FOUR_RANGES_MM)
    assert (session.settings.sensor.rows, session.settings.sensor.cols) == (768, 1024)
    pitch = session.plan.target.pitch_mm
    assert pitch is not None
    # the panel has a whole number of its pixels from carpet to carpet
    steps = pitch / session.settings.panel.pitch_mm
    assert steps == pytest.approx(round(steps))


def test_a_bench_for_a_plan_with_a_grid_knows_its_tiles() -> None:
    target = {"grid": [2, 3], "pitch_mm": 12.04}  # 120.4 pixels of the panel
    text = plan_text(SMALL, simulated([2000], 1950.0), {"target": target})
    settings = settings_for(Plan.parse(text, Path()), 1)
    assert (settings.grid.shape, settings.grid.pitch_mm) == ((2, 3), 12.0)
    assert settings.varies
    assert settings.grid.centre_mm((0, 2)) == (12.0, -6.0)
