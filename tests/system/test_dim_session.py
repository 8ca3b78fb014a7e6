"""A session with so little light that fits near focus are no parabolas of the likelihood."""

from __future__ import annotations

from pathlib import Path

import pytest

import labkit
from benchmarks.random_sessions import make
from benchmarks.sessions import STUDIES


@pytest.mark.slow
def test_fits_that_contradict_each_other_near_focus_blame_no_number_of_the_plan(
    tmp_path: Path,
) -> None:
    """5,000 electrons, and 0.03 waves of defocus at 644.1 mm, known to 0.01.

    Each fit's own likelihood made chi2 273 for 143 degrees of freedom, and the wavelength of blue a mistake of 5 %.
    """
    drawn, folder = STUDIES["as-made"](1, 10), tmp_path / "session"
    truth = make(drawn, folder)
    results = labkit.fit(
        folder,
        ranges_mm=[619.3, 644.1, 671.0],
        channels=["G", "B"],
        noll=(4, 36),
        workers=1,
    )
    assert [finding.code for finding in results.findings] == [
        "pupil-magnification-undetermined"
    ]
    assert results.focus is not None
    chi2 = results.focus.chi2_per_freedom
    assert chi2 is not None
    assert chi2 < 1.3  # 1.12 measured
    for channel, best in results.focus.best_focus_mm.items():
        assert abs(best.value - truth.best_focus_mm[channel]) < 3 * best.std  # 1.6 measured
    assert results.lens is not None
    for channel, nm in drawn.settings.lens.wavelength_nm.items():
        if channel in results.lens.wavelengths_nm:
            found = results.lens.wavelengths_nm[channel]
            assert abs(found.value - nm) < 2 * found.std  # 1.0 measured
            assert found.std < 0.01 * nm
