"""A session of 24 megapixels from capture to report: a target of 111 pixels somewhere in a bright room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.analysis.fit import fit
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.world import Truth
from labkit.photographs.decoding import read_photograph
from labkit.report.html import write_report
from labkit.results import Results
from labkit.session.session import Session
from tests.plans import IPAD, SMALL, plan_text, simulated

NONE_BEYOND = ",".join(f"lens.noll_{noll}=0" for noll in range(7, 16))
ADDRESS = f"simulated:seed=7,sensor=24mp,lens.noll_5=0.03,lens.noll_6=-0.02,{NONE_BEYOND}"

PLAN = plan_text(
    SMALL,
    simulated([2000, 2100], 1950.0, ADDRESS),
    {
        "display": IPAD,
        "target": {"order": 3, "size_mm": 25.98},
        "camera": {"frames_per_range": 1, "flats_per_range": 1, "darks": 1},
        "fit": {"zernike_noll": [4, 6], "range_std_mm": 0.0015},
    },
)


@dataclass(frozen=True)
class Ended:
    """A session with its results, its report, and the truth."""

    folder: Path
    results: Results
    report: Path
    truth: Truth


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    folder = tmp_path_factory.mktemp("whole") / "session"
    context = DeviceContext()
    with (
        Session.create(folder, PLAN, folder.parent) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices)
        bench = devices.camera._bench  # type: ignore[attr-defined]
    results = fit(folder, workers=1)
    return Ended(folder, results, write_report(results), bench.truth)


@pytest.mark.slow
def test_the_photographs_are_whole_frames_of_a_camera(ended: Ended) -> None:
    session = Session.open(ended.folder)
    assert len(session.frames) == 5
    file = session.frames[-1].path
    photograph = read_photograph(file, session.plan.sensor)
    assert photograph.counts.shape == (4000, 6000)
    # a byte and a half a pixel at most, where an uncompressed file has two
    assert file.stat().st_size < 1.5 * photograph.counts.size


@pytest.mark.slow
def test_the_fit_ends_at_the_truth(ended: Ended) -> None:
    assert len(ended.results.wavefronts) == 2
    for wavefront in ended.results.wavefronts:
        true = ended.truth.waves(wavefront.range_mm or 0.0, "G")
        # the truth's waves are of 450 nm, the session's of its only colour
        apart = wavefront.waves - np.array([true[j] for j in (4, 5, 6)]) * 450 / 550
        # measured: 0.0002, of standard errors of 0.0003
        assert np.abs(apart).max() < 0.0004
    assert ended.results.focus
    best = ended.results.focus.best_focus_mm["G"]
    # measured: 0.21, of a standard error of 0.34
    assert best.value == pytest.approx(ended.truth.best_focus_mm["G"], abs=0.42)


@pytest.mark.slow
def test_the_report_shows_the_photographs(ended: Ended) -> None:
    assert ended.report.stat().st_size > 100_000
