"""The lens in results: its numbers at best focus, and its longitudinal colour."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.optics.strehl import strehl
from labkit.report.curves import at_best_focus
from labkit.results import BestFocus, Focus, Lens, Results
from labkit.results.tables import longitudinal_colour
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.results_samples import FOCUS, LENS, REJECTED, a_wavefront, some_results, written


def test_the_lens_has_no_defocus_in_its_strehl_ratio_rms_or_mtf() -> None:
    blurred, sharp = a_wavefront(defocus=1.2), a_wavefront(defocus=0.0)
    assert blurred.strehl.value < 0.2
    assert blurred.best.strehl == sharp.best.strehl
    assert blurred.best.strehl == strehl(sharp.at_focus())
    assert blurred.best.rms.value == pytest.approx(0.05)  # 0.03 and 0.04
    assert blurred.best.rms_nm.value == pytest.approx(0.05 * 450)
    assert blurred.best.rms_own_waves.value == pytest.approx(0.05 * 450 / 650)
    assert blurred.best.mtf50("y") == sharp.best.mtf50("y")
    half = float(blurred.best.mtf([blurred.best.mtf50().value]).value[0])
    assert half == pytest.approx(0.5, abs=1e-8)


def test_a_number_is_computed_once_and_the_report_has_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    results = some_results()
    best = results.nearest_focus("R").best
    kept = best.strehl, best.mtf50("x"), best.energy_radius()
    for name in ("strehl", "mtf50", "radius_of_energy"):
        monkeypatch.setattr(f"labkit.results.best_focus.{name}", None)
    (focus, _) = at_best_focus(results)
    assert focus.best is best
    assert (focus.best.strehl, focus.mtf50("x"), focus.best.energy_radius()) == kept


def test_read_results_have_the_same_best_focus(tmp_path: Path) -> None:
    loaded = Results.load(written(tmp_path))
    assert loaded[3000.0, "R"].best.strehl == some_results()[3000.0, "R"].best.strehl
    assert isinstance(loaded[3000.0, "R"].best, BestFocus)


def test_a_wrong_optimum_is_not_taken_for_the_lens() -> None:
    wavefronts = (
        a_wavefront(3000.0, "R", 0.01, test=REJECTED),
        a_wavefront(3200.0, "R", 0.9),
    )
    assert some_results(wavefronts=wavefronts).nearest_focus("R").range_mm == 3200.0


def session(covariance: Floats | None) -> Focus:
    return replace(
        FOCUS,
        best_focus_mm={
            "R": Uncertain(2010.0, 0.5, "mm"),
            "G": Uncertain(2000.0, 0.4, "mm"),
            "B": Uncertain(1996.0, 0.4, "mm"),
        },
        covariance=covariance,
    )


def test_errors_that_channels_share_cancel_in_longitudinal_colour() -> None:
    # common 0.3 mm, and 0.4, 0.2646, 0.2646 mm of each channel's own
    own = np.array([0.16, 0.07, 0.07])
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = 0.09 + np.diag(own)
    red, blue = longitudinal_colour(session(covariance), None)
    assert (red.name, red.range_shift.value) == ("R \N{MINUS SIGN} G", 10.0)
    assert red.range_shift.std == pytest.approx(np.sqrt(0.16 + 0.07))
    assert blue.range_shift.value == -4.0
    assert blue.range_shift.std == pytest.approx(np.sqrt(0.14))
    assert red.sensor_shift is None
    apart, _ = longitudinal_colour(session(None), None)
    assert apart.range_shift.std == pytest.approx(np.hypot(0.5, 0.4))


def test_a_colour_that_focuses_farther_has_its_image_behind_the_sensor() -> None:
    lens: Lens = replace(
        LENS,
        focal_length=Uncertain(100.0, 0.1, "mm"),
        range_zero=Uncertain(5.0, 1.0, "mm"),
    )
    red, blue = longitudinal_colour(session(None), lens)
    assert red.sensor_shift is not None
    assert blue.sensor_shift is not None
    # the sensor stands where 2005 mm is sharp; red's focal length brings 2015 mm there
    sensor_mm = 1 / (1 / 100 - 1 / 2005)
    red_focal_mm = 1 / (1 / sensor_mm + 1 / 2015)
    shift_mm = 1 / (1 / red_focal_mm - 1 / 2005) - sensor_mm
    assert red.sensor_shift.value == pytest.approx(1e3 * shift_mm, rel=1e-3)
    assert blue.sensor_shift.value < 0
    # errors of 0.64 mm in 10 mm and of 0.1 % of the focal length, twice
    expected = red.sensor_shift.value * np.hypot(np.hypot(0.5, 0.4) / 10, 2e-3)
    assert red.sensor_shift.std == pytest.approx(expected, rel=0.02)


def test_longitudinal_colour_needs_two_channels() -> None:
    assert longitudinal_colour(None, LENS) == ()
    one = replace(
        FOCUS, best_focus_mm={"G": Uncertain(2000.0, 0.4, "mm")}, covariance=np.eye(2)
    )
    assert longitudinal_colour(one, LENS) == ()
    assert [shift.name for shift in some_results().longitudinal_colour()] == [
        "B \N{MINUS SIGN} R"
    ]
