"""Real photographs of disks through seven filters, imported and fitted together: examples/real_disks.py.

Skipped where they are not at hand.
"""

import runpy
from pathlib import Path

import numpy as np
import pytest

from benchmarks.claims import limit

CLAIM = "real_disks"
ROOT = Path(__file__).parents[2]
PHOTOGRAPHS = ROOT.parent / "shared" / "real" / "disks"


@pytest.mark.skipif(not PHOTOGRAPHS.is_dir(), reason="needs ../shared/real/disks")
@pytest.mark.slow
def test_focus_size_and_place_are_smooth_in_wavelength_and_exposures_linear(
    tmp_path: Path,
) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "real_disks.py"))
    outcome = example["check"](PHOTOGRAPHS, tmp_path / "work")
    assert outcome.nonlinear < limit(CLAIM, "nonlinear")
    # best focus lies on a parabola in wavelength within its errors, and these tell 700 nm from 500
    assert outcome.settled
    assert outcome.chi2 < limit(CLAIM, "chi2")
    bend = np.abs(outcome.focus_um[-1] - outcome.focus_um[2])
    assert bend > 2 * np.hypot(outcome.std_um[-1], outcome.std_um[2])
    nm = np.array(list(example["BANDS"]), dtype=float)
    # at 400 nm green pixels see more than blue ones: that light is not of 400 nm, and its place not of that colour
    cubic = np.polynomial.Polynomial.fit(nm[1:], outcome.size[1:], 3)
    assert np.max(np.abs(outcome.size[1:] - cubic(nm[1:]))) < limit(CLAIM, "size")
    for axis in (0, 1):
        cubic = np.polynomial.Polynomial.fit(nm[1:], outcome.centre_px[1:, axis], 3)
        assert np.max(np.abs(outcome.centre_px[1:, axis] - cubic(nm[1:]))) < limit(
            CLAIM, "centre_px"
        )
    assert np.all(
        np.diff(outcome.size[1:]) > 0
    )  # longer waves, a larger picture, by half a per cent from 450 to 700 nm
    assert outcome.size[-1] - outcome.size[1] == pytest.approx(0.0047, abs=0.0005)
    assert (tmp_path / "work" / "real_disks.png").stat().st_size > 10_000
