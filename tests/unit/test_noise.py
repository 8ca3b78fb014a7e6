"""Photon transfer against simulated sensors whose noise is known, and its refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy import ndimage

from labkit.errors import DataError
from labkit.noise.emva import ChannelNoise, camera_model
from labkit.noise.levels import read_series
from labkit.session.frame import Frame
from labkit.types import Floats, no_progress
from labkit.uncertain import Uncertain
from tests.ladders import EXPOSURES_S, SIDE, Ladder, TrueCamera, ladder

TRIALS = 40
TRUE = TrueCamera()
READ_COUNTS = TRUE.gain * TRUE.read_noise_e
TRUTH = {
    "gain_counts_per_e": TRUE.gain,
    "read_noise_counts": READ_COUNTS,
    "read_noise_e": TRUE.read_noise_e,
    "prnu_percent": 100 * TRUE.prnu,
    "prnu_whole_percent": 100 * TRUE.prnu,
    "dsnu_e": TRUE.dsnu_e,
    "dsnu_whole_e": TRUE.dsnu_e,
    "dark_current_e_per_s": TRUE.dark_e_per_s,
    "dark_current_from_noise_e_per_s": TRUE.dark_e_per_s,
    "quantum_efficiency_percent": 100 * TRUE.electrons_per_s / TRUE.photons_per_s,
    "threshold_e": np.sqrt((READ_COUNTS**2 + 1 / 12) / TRUE.gain**2 + 0.25) + 0.5,
}


def model(series: Ladder, frames: Sequence[Frame] | None = None) -> ChannelNoise:
    used = series.frames if frames is None else frames
    return camera_model(read_series(used, series.camera.sensor, ["M"], no_progress)["M"])


@cache
def models() -> tuple[ChannelNoise, ...]:
    with TemporaryDirectory() as folder:
        return tuple(model(ladder(Path(folder), seed)) for seed in range(TRIALS))


def pulls(name: str, truth: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    found: list[Uncertain] = [getattr(one, name) for one in models()]
    return np.array([(number.value - truth) / number.std for number in found])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "truth"), TRUTH.items())
def test_numbers_err_by_their_standard_errors(name: str, truth: float) -> None:
    z = pulls(name, float(truth))
    # four standard errors of the mean and of the standard deviation of so many unit normals
    assert abs(z.mean()) < 4 / np.sqrt(TRIALS)
    assert abs(z.std() - 1) < 4 / np.sqrt(2 * TRIALS)


def test_gain_and_read_noise_are_those_of_the_sensor(tmp_path: Path) -> None:
    found = model(ladder(tmp_path, 1))
    assert found.gain_counts_per_e.value == pytest.approx(TRUE.gain, rel=0.01)
    assert found.read_noise_counts.value == pytest.approx(READ_COUNTS, rel=0.02)
    assert found.notes == ()


def test_saturation_is_the_converters_end(tmp_path: Path) -> None:
    found = model(ladder(tmp_path, 2)).saturation_e
    # the variance falls as soon as the brightest of two sigma are cut off
    end = (TRUE.white - TRUE.black) / TRUE.gain
    assert abs(found.value - (end - np.sqrt(end))) < 3 * found.std
    assert found.std < 0.04 * found.value


def test_a_saturation_that_is_not_reached_is_not_determined(tmp_path: Path) -> None:
    found = model(ladder(tmp_path, 3, EXPOSURES_S[:10]))
    assert np.isnan(found.saturation_e.value)
    assert "do not reach saturation" in found.notes[0]
    assert found.gain_counts_per_e.value == pytest.approx(TRUE.gain, rel=0.02)


def test_without_photons_there_is_no_quantum_efficiency(tmp_path: Path) -> None:
    series = ladder(tmp_path, 4)
    found = model(series, series.without("photons"))
    assert np.isnan(found.quantum_efficiency_percent.value)
    assert np.isnan(found.threshold_photons.value)
    assert np.isfinite(found.threshold_e.value)


def test_a_linear_sensor_has_no_linearity_error_beyond_its_own(tmp_path: Path) -> None:
    found = model(ladder(tmp_path, 5)).linearity_error_percent
    assert found.value < 3 * found.std
    assert found.std < 0.1


def test_pixels_in_uneven_light_are_left_out(tmp_path: Path) -> None:
    series = Ladder(TRUE, tmp_path, np.random.default_rng(6))
    series.response *= np.linspace(1, 0.6, SIDE)
    for exposure_s in EXPOSURES_S:
        for _ in range(2):
            series.take("dark", exposure_s)
            series.take("flat", exposure_s)
    found = model(series)
    assert found.series.flats[0].pixels < 0.4 * SIDE**2
    assert abs(found.gain_counts_per_e.value - TRUE.gain) < 3 * found.gain_counts_per_e.std


def refusal(series: Ladder, frames: Sequence[Frame] | None = None) -> str:
    with pytest.raises(DataError) as caught:
        model(series, frames)
    return str(caught.value)


def test_flats_need_darks(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1, EXPOSURES_S[:5])
    flats = [frame for frame in series.frames if frame.kind == "flat"]
    assert "has no darks: photon transfer needs two or more" in refusal(series, flats)


def test_single_frames_are_no_pairs(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1, EXPOSURES_S[:5], frames=1)
    assert "5 exposure times have a single flat (0.02 s, " in refusal(series)


def test_too_few_levels_are_named_with_what_is_needed(tmp_path: Path) -> None:
    message = refusal(ladder(tmp_path, 1, EXPOSURES_S[::6]))
    assert "flats at 2 levels of light between dark and 70% of saturation" in message
    assert "needs 4 or more" in message


def test_clipped_flats_are_refused(tmp_path: Path) -> None:
    message = refusal(ladder(tmp_path, 1, (2.0, 3.0, 4.0, 5.0, 6.0)))
    assert "all flats are clipped, those of 2 s too" in message


def test_a_restless_light_is_refused(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1)
    series.take("flat", EXPOSURES_S[7], light=1.1)
    message = refusal(series)
    assert "the light changed by 9.7%" in message
    assert f"flats of {EXPOSURES_S[7]:g} s" in message


def test_a_warm_dark_is_named(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1)
    warm = series.take("dark", EXPOSURES_S[3], warm=20.0)
    assert refusal(series).startswith(f"{warm.file}, a dark of {EXPOSURES_S[3]:g} s, is +")


def test_copies_are_no_pair(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1)
    frames = [
        frame for frame in series.frames if frame.meta["columns"]["exposure_s"] != "0.02"
    ]
    copied = next(frame for frame in frames if frame.kind == "flat")
    seconds = copied.meta["columns"]["exposure_s"]
    frames = [
        f for f in frames if f.kind == "dark" or f.meta["columns"]["exposure_s"] != seconds
    ]
    assert "hold copies of one photograph" in refusal(series, [*frames, copied, copied])


def test_frames_without_an_exposure_time_are_named(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1, EXPOSURES_S[:5])
    message = refusal(series, series.without("exposure_s"))
    assert message.startswith("20 of 20 flats and darks state no exposure time, such as ")
    assert "add a column exposure_s" in message


@pytest.mark.parametrize(
    ("filtered", "sum_of_correlations"),
    [
        (lambda counts: ndimage.median_filter(counts, 3), 6.5),  # a star eater
        (lambda counts: ndimage.uniform_filter(counts, 2), 3.0),
    ],
)
def test_noise_that_neighbours_share_is_named_and_in_the_errors(
    tmp_path: Path, filtered: Callable[[Floats], Floats], sum_of_correlations: float
) -> None:
    found = model(ladder(tmp_path, 8, filtered=filtered))
    gain = found.gain_counts_per_e
    assert abs(gain.value - TRUE.gain) < gain.std  # 0.05 and 0.6 measured
    assert found.notes[0].startswith("neighbouring pixels share noise, their correlations")
    assert "turn noise reduction off" in found.notes[0]
    shared = float(found.notes[0].split("sum to ")[1].split(" ")[0])
    assert shared == pytest.approx(sum_of_correlations, abs=0.6)  # 0.04 and 0.3 measured


def test_what_rows_share_is_no_filter(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    banded = lambda counts: counts + rng.normal(0, 1.5, (SIDE, 1))  # noqa: E731
    found = model(ladder(tmp_path, 9, filtered=banded))
    assert found.notes == ()


def test_flats_full_below_the_white_level_are_no_copies(tmp_path: Path) -> None:
    full = 2600
    found = model(ladder(tmp_path, 10, filtered=lambda of: np.minimum(of, full)))
    assert found.notes == (
        "the flats pile up at 2600 counts, below the white level of 4095: saturation is there; correct sensor.white_level",
    )
    assert abs(found.gain_counts_per_e.value - TRUE.gain) < 3 * found.gain_counts_per_e.std
    end = (full - TRUE.black) / TRUE.gain
    assert abs(found.saturation_e.value - (end - np.sqrt(end))) < 3 * found.saturation_e.std


def test_darks_clipped_at_zero_leave_the_read_noise_to_the_flats(tmp_path: Path) -> None:
    camera = TrueCamera(black=0.0, dsnu_e=0.0, dark_e_per_s=0.0)
    found = model(ladder(tmp_path, 11, camera=camera))
    assert any("darks are clipped at 0 counts" in note for note in found.notes)
    read = found.read_noise_counts
    assert abs(read.value - READ_COUNTS) < 3 * read.std
    assert abs(found.gain_counts_per_e.value - TRUE.gain) < 3 * found.gain_counts_per_e.std


def test_one_exposure_time_is_named_with_what_is_missing(tmp_path: Path) -> None:
    message = refusal(ladder(tmp_path, 1, (0.2,), frames=8))
    assert "all flats have one exposure time, 0.2 s, and one light" in message
    dimmed = Ladder(TRUE, tmp_path, np.random.default_rng(12))
    for light in np.linspace(0.05, 1, 12).tolist():
        for _ in range(2):
            dimmed.take("dark", 0.3)
            dimmed.take("flat", 0.3, light=light)
    message = refusal(dimmed, dimmed.without("photons"))
    assert "one exposure time, 0.3 s, but means of" in message
    assert "no column photons tells their light apart" in message


def test_a_tone_curve_is_named(tmp_path: Path) -> None:
    curve = lambda counts: 4095 * (counts / 4095) ** (1 / 2.2)  # noqa: E731
    message = refusal(ladder(tmp_path, 13, filtered=curve))
    assert "noise falls where light grows" in message
    assert "without a tone curve" in message


def test_darks_of_other_times_are_taken_with_a_remark(tmp_path: Path) -> None:
    series = ladder(tmp_path, 7)
    frames = [
        frame
        for frame in series.frames
        if frame.kind == "flat" or frame.meta["columns"]["exposure_s"] == "0.02"
    ]
    found = model(series, frames)
    assert any("have no darks of their own exposure time" in note for note in found.notes)
    assert np.isnan(found.dark_current_e_per_s.value)
