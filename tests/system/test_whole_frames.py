"""Golden sessions pasted into whole frames, beside a room: the results are those of the crop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import labkit
from labkit.analysis.locate import Corners, locate
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.target import Target
from tests.whole_frames import Embedding, embed_session

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
SIDE_PX = 240
"""Of the crops."""

pytestmark = pytest.mark.skipif(not GOLDEN.is_dir(), reason="shared/golden is not here")


def bookshelf(shape: tuple[int, int]) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Upright stripes of any brightness, from black to white."""
    rng = np.random.default_rng(4)
    return np.repeat(rng.random((shape[0] // 50, shape[1] // 10)), 10, axis=1)


def fitted(folder: Path, session: Path) -> labkit.Results:
    imported = labkit.import_frames(folder / "frames.csv", folder / "plan.toml", session)
    return labkit.fit(imported, channels="G", workers=1)


@pytest.fixture(scope="module")
def crop(tmp_path_factory: pytest.TempPathFactory) -> labkit.Results:
    """Results of the crops themselves."""
    return fitted(GOLDEN / "bench-open", tmp_path_factory.mktemp("crop") / "session")


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("lit", [False, True], ids=["dark room", "bookshelf"])
def test_a_session_of_whole_frames_ends_with_the_crops_results(
    crop: labkit.Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lit: bool
) -> None:
    how = Embedding(shape=(1500, 2200), place=(400, 1600))
    if lit:
        how = replace(how, room=bookshelf(how.shape))
    frames = embed_session(GOLDEN / "bench-open", tmp_path / "frames", how)
    look_at_the_crop_only(monkeypatch, how)
    whole = fitted(frames, tmp_path / "session")
    away = [
        np.abs(whole[w.range_mm, "G"].waves - w.waves) / np.sqrt(np.diag(w.covariance))
        for w in crop
    ]
    # measured: 0.037 in the dark, 0.033 beside the bookshelf
    assert np.max(away) < 0.07, away


def look_at_the_crop_only(monkeypatch: pytest.MonkeyPatch, how: Embedding) -> None:
    """Search for the target in the pasted part alone: whether it is found in a whole frame is another test's subject."""
    place = how.place

    def in_crop(
        photograph: Photograph,
        file: str,
        range_mm: float | None,
        plan: Plan,
        target: Target,
    ) -> Corners:
        rows, columns = (slice(start, start + SIDE_PX) for start in place)
        crop = photograph.cropped((rows, columns))
        alone = replace(crop, origin_px=(0, 0), whole_px=None)
        corners = locate(alone, file, range_mm, plan, target)
        return {tile: at + place for tile, at in corners.items()}

    monkeypatch.setattr("labkit.analysis.observe.locate", in_crop)
