"""Pose, gain, read noise and flat field on frames of an independent simulator, whose truth is known."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.calibration.calibrate import Calibration, calibrate, channel_data
from labkit.finder.find_target import find_target
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.session.session import Session
from labkit.target.target import open_target

GOLDEN = Path(__file__).parents[2].parent / "shared" / "golden"

pytestmark = pytest.mark.skipif(
    not GOLDEN.is_dir(), reason="the shared sessions are not here"
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    source = GOLDEN / "bench-open"
    folder = tmp_path_factory.mktemp("golden") / "session"
    with Session.create(folder, (source / "plan.toml").read_text(), source) as made:
        for row in csv.DictReader((source / "frames.csv").read_text().splitlines()):
            range_mm = float(row["range_mm"]) if row["range_mm"] else None
            made.add_frame(source / row["file"], row["file"], row["kind"], range_mm)  # type: ignore[arg-type]
        yield made


@pytest.fixture(scope="module")
def calibration(session: Session) -> Calibration:
    return calibrate(session.frames, session.plan)


def found_in(path: Path, plan_path: Path) -> NDArray[np.float64]:
    plan = Plan.load(plan_path)
    mosaic = read_photograph(path, plan.sensor)
    return find_target(mosaic, open_target(plan.target))


@pytest.mark.parametrize("range_mm", [2000, 2080, 2160])
def test_a_still_target_is_found_twice_in_the_same_place_and_of_the_right_size(
    range_mm: int,
) -> None:
    folder = GOLDEN / "bench-open"
    first, second = (
        found_in(folder / f"target_{range_mm}_{k}.dng", folder / "plan.toml")
        for k in range(2)
    )
    assert np.max(np.abs(first - second)) < 0.05
    plan = Plan.load(folder / "plan.toml")
    f, pitch = plan.lens.focal_length_mm, plan.sensor.pixel_pitch_um * 1e-3
    side = plan.target.size_mm * f / (range_mm - f) / pitch
    sides = np.linalg.norm(first - np.roll(first, 1, axis=0), axis=1)
    assert sides.mean() == pytest.approx(side, rel=0.01)


@pytest.mark.parametrize("trial", range(4))
def test_an_undersampled_target_is_found(trial: int) -> None:
    corners = found_in(
        GOLDEN / "thesis-open" / f"trial{trial}.tif", GOLDEN / "thesis-open" / "plan.toml"
    )
    assert np.max(np.abs(corners - np.array([[17, 17], [17, 88], [88, 88], [88, 17]]))) < 4


@pytest.mark.parametrize("channel", ["R", "G", "B"])
def test_gain_and_read_noise_are_the_simulators(
    calibration: Calibration, channel: str
) -> None:
    truth = json.loads((GOLDEN / "truth-bench-open.json").read_text())
    found = calibration.noise[channel]
    assert found.gain is not None
    assert found.gain_std is not None
    assert found.read_noise is not None
    assert found.read_noise_std is not None
    assert abs(found.gain - truth["gain"]) < 4 * found.gain_std < 0.01
    assert abs(found.read_noise - truth["read_noise_dn"]) < 4 * found.read_noise_std < 0.02


def test_a_flat_over_its_model_is_photon_noise_at_every_scale(
    session: Session, calibration: Calibration
) -> None:
    for frame in (frame for frame in session.frames if frame.kind == "flat"):
        data = channel_data(
            calibration, frame, read_photograph(frame.path, session.plan.sensor), "G"
        )
        assert data.noise.gain is not None
        assert data.noise.read_noise is not None
        model = data.illumination * (
            data.counts[data.mask].sum() / data.illumination[data.mask].sum()
        )
        z = (data.counts - model) / np.sqrt(
            data.noise.gain * model + data.noise.read_noise**2 + 1 / 12
        )
        # the frame is one of twelve that made its own model
        assert z[data.mask].std() == pytest.approx(np.sqrt(11 / 12), abs=0.02)
        blocks = np.where(data.mask, z, 0.0).reshape(6, 40, 6, 40).sum(
            axis=(1, 3)
        ) / np.sqrt(800)
        assert blocks.std() < 1 + 4 / np.sqrt(72)
