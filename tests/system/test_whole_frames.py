"""Golden sessions pasted into whole frames, beside a room: the results are those of the crop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import labkit
from labkit.analysis.observe import observe
from labkit.estimation.local import Guesses, Optimum, Views, find_optima
from labkit.estimation.stated import optics_of
from labkit.findings.findings import Finding
from labkit.target.target import open_target
from labkit.types import Floats
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


def climbed(folder: Path, session: Path, waves: Floats) -> tuple[Optimum, list[Finding]]:
    """The optimum near modes of the one wavefront of a session without flats, and its findings."""
    imported = labkit.import_frames(folder / "frames.csv", folder / "plan.toml", session)
    target = open_target(imported.plan.target)
    (observation,), findings = observe(imported, imported.plan, target, channel="G")
    views = Views(observation.frames, observation.poses, observation.noise)
    optics = replace(optics_of(imported.plan, "G"), f_number=WORKING_F_NUMBER)
    found = find_optima(optics, target, views, Guesses(starts=(waves,), deep=False))
    near = min(found.optima, key=lambda one: float(np.abs(one.waves - waves).max()))
    return near, findings


WORKING_F_NUMBER = 3.64
"""Of bench-open at 2 m."""


@pytest.mark.slow
@pytest.mark.parametrize("lit", [False, True], ids=["dark room", "bookshelf"])
def test_without_flats_a_room_right_beside_the_target_is_left_out(
    tmp_path: Path, lit: bool
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in ("plan.toml", "target_2000_0.dng"):
        (source / name).write_bytes((GOLDEN / "bench-open" / name).read_bytes())
    listed = "file,kind,range_mm\ntarget_2000_0.dng,target,2000.0\n"
    (source / "frames.csv").write_text(listed)
    # defocus of the truth, with the other modes to find
    start = np.r_[-0.485, np.zeros(11)]
    crop, _ = climbed(source, tmp_path / "crop", start)
    shape = (420, 480)
    room = bookshelf(shape) if lit else None
    how = Embedding(shape=shape, place=(90, 110), light=0.9, room=room)
    frames = embed_session(source, tmp_path / "frames", how)
    whole, findings = climbed(frames, tmp_path / "whole", crop.waves)
    assert "surround-uneven" in [finding.code for finding in findings]
    away = np.abs(whole.waves - crop.waves) / np.sqrt(np.diag(crop.covariance))
    # measured: 1.35 in both, for the target's edge is left out too; with the room's light in the fit 60 in the dark, and
    # 19,000 beside the bookshelf
    assert away.max() < 2.7, away
