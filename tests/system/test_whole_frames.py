"""Golden sessions pasted into whole frames, beside a room: the results are those of the crop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import labkit
from tests.whole_frames import Embedding, embed_session

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
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
    crop: labkit.Results, tmp_path: Path, lit: bool
) -> None:
    how = Embedding(shape=(1500, 2200), place=(400, 1600))
    if lit:
        how = replace(how, room=bookshelf(how.shape))
    frames = embed_session(GOLDEN / "bench-open", tmp_path / "frames", how)
    whole = fitted(frames, tmp_path / "session")
    away = [
        np.abs(whole[w.range_mm, "G"].waves - w.waves) / np.sqrt(np.diag(w.covariance))
        for w in crop
    ]
    # measured: 0.037 in the dark, 0.033 beside the bookshelf
    assert np.max(away) < 0.07, away
