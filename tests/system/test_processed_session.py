"""A session of processed pictures beside the session of the raw files that they were made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from labkit.analysis.fit import fit
from labkit.calibration.calibrate import calibrate
from labkit.photographs.decoding import read_photograph
from labkit.results import Results
from labkit.session.import_frames import import_frames
from labkit.session.session import Session
from labkit.types import Floats
from tests.plans import SMALL, plan_text, simulated

from .conftest import ADDRESS, capture_through

FEW = {
    "camera": {"frames_per_range": 1, "flats_per_range": 4, "darks": 2},
    "fit": {"zernike_noll": [4, 6]},
}
MONO = {
    "sensor": {"cfa_pattern": "mono", "black_level": 600, "white_level": 16383},
    "target": {"order": 3, "size_mm": 18.9},
}
PLAN = plan_text(SMALL, {"target": MONO["target"], "fit": FEW["fit"]})
ONE_RANGE = simulated([2060], 1950.0, ADDRESS)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """The results of raw files of a sensor without filters, which need no demosaicing."""
    folder = tmp_path_factory.mktemp("raw") / "session"
    capture_through((5, 6), plan_text(SMALL, ONE_RANGE, FEW, MONO), folder)
    fit(folder, workers=1, plain=True)
    return Results.load(folder)


def stored(light: Floats) -> Floats:
    """sRGB's numbers of light, by the standard's formula."""
    return np.asarray(
        np.where(
            light <= 0.0031308,
            12.92 * light,
            1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055,
        )
    )


def session_of(results: Results) -> Path:
    assert results.folder is not None
    return results.folder.parents[1]


def developed(raw: Results, folder: Path, suffix: str, **how: object) -> Path:
    """FRAMES.csv of the session's photographs but its darks, as pictures in colours of 8 bit."""
    session = Session.open(session_of(raw))
    lines = ["file,kind,range_mm"]
    for frame in session.frames:
        if frame.kind == "dark":
            continue  # a program has taken the black level off
        mosaic = read_photograph(frame.path, session.plan.sensor)
        light = (mosaic.light) / (mosaic.white - mosaic.black[0, 0])
        grey = np.rint(255 * stored(light)).clip(0, 255).astype(np.uint8)
        name = frame.file.replace(".tif", suffix)
        Image.fromarray(np.dstack([grey] * 3)).save(folder / name, **how)  # type: ignore[arg-type]
        lines.append(f"{name},{frame.kind},{frame.range_mm:g}")
    (folder / "frames.csv").write_text("\n".join(lines))
    return folder / "frames.csv"


def test_photon_transfer_finds_the_raw_files_gain_behind_the_rounding_to_8_bit(
    raw: Results, tmp_path: Path
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    made = import_frames(
        developed(raw, tmp_path, ".png"), tmp_path / "plan.toml", tmp_path / "session"
    )
    session = Session.open(session_of(raw))
    of_raw = calibrate(session.frames, session.plan).noise["G"]
    found = calibrate(made.frames, made.plan).noise["G"]
    assert found.gain is not None
    assert found.gain_std is not None
    assert of_raw.gain is not None
    # counts of the pictures are 65535 where the raw's are 16383 - 600; without the rounding's part it would be 15 % more
    assert found.gain == pytest.approx(of_raw.gain * 65535 / 15783, abs=3 * found.gain_std)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "how", "limit"),
    [
        (".png", {}, 0.45),  # 0.23 measured
        (".jpg", {"quality": 100, "subsampling": 0}, 0.8),  # 0.42 measured
    ],
)
def test_pictures_of_8_bit_give_the_raw_files_wavefront(
    raw: Results, tmp_path: Path, suffix: str, how: dict[str, object], limit: float
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    csv = developed(raw, tmp_path, suffix, **how)
    import_frames(csv, tmp_path / "plan.toml", tmp_path / "session")
    results = fit(tmp_path / "session", workers=1, plain=True)
    expected, found = raw[2060, "G"], results[2060, "G"]
    std = np.sqrt(np.diag(found.covariance) + np.diag(expected.covariance))
    # the same photons: what differs is the rounding's alone, below the photons' noise
    # both sessions leave the sign of the even modes open: of twins the nearer one counts
    twins = [found.waves] if found.twin is None else [found.waves, found.twin.waves]
    off = min(np.abs((one - expected.waves) / std).max() for one in twins)
    assert off < limit
    assert any("sRGB" in warning and "PSF" in warning for warning in results.warnings)
