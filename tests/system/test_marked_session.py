"""A session of a single target with marks around it, from capture to fit: their light is modelled, and changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.analysis.fit import fit
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.session.session import Session
from tests.plans import IPAD, SMALL, plan_text, simulated

NONE_BEYOND = ",".join(f"lens.noll_{noll}=0" for noll in range(7, 16))
ADDRESS = f"simulated:seed=7,sensor=2mp,lens.noll_5=0.03,lens.noll_6=-0.02,{NONE_BEYOND}"

PLAN = plan_text(
    SMALL,
    simulated([2000, 2100], 1950.0, ADDRESS),
    {
        "display": IPAD,
        "target": {"order": 3, "size_mm": 25.98, "marks": True},
        "camera": {"frames_per_range": 2, "flats_per_range": 1, "darks": 1},
        "fit": {"zernike_noll": [4, 6], "range_std_mm": 0.0015},
    },
)


@pytest.mark.slow
def test_marks_do_not_change_the_fit(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    with (
        Session.create(folder, PLAN, tmp_path) as session,
        open_devices(session.plan, context=DeviceContext()) as devices,
    ):
        run_plan(session, devices)
        truth = devices.camera._bench.truth  # type: ignore[attr-defined]
    results = fit(folder, workers=1)
    assert len(results.wavefronts) == 2
    assert not any("contradict" in finding.text for finding in results.findings)
    for wavefront in results.wavefronts:
        true = truth.waves(wavefront.range_mm or 0.0, "G")
        # the truth's waves are of 450 nm, the session's of its only colour
        apart = wavefront.waves - np.array([true[j] for j in (4, 5, 6)]) * 450 / 550
        # measured: 0.00012, of standard errors of 0.0003
        assert np.abs(apart).max() < 0.00023
        assert wavefront.std.max() < 0.0004
