"""Calibration of simulated sensors whose offset, light and pixels are known, written by plain numpy and tifffile."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from labkit.calibration.calibrate import Calibration, ChannelData, calibrate, channel_data
from labkit.calibration.masters import clipped_mean, shrunk, smooth_illumination
from labkit.calibration.needed import Needed
from labkit.errors import DataError, RawError
from labkit.findings.findings import Finding
from labkit.photographs.decoding import read_photograph
from labkit.session.frame import Frame
from labkit.types import Floats, FrameKind
from tests.sensor import COLOURS, GAIN, PRNU, READ_NOISE, SHAPE, Bench, light_at


def codes(findings: Sequence[Finding]) -> list[str]:
    return [finding.code for finding in findings]


def calibration_of(bench: Bench) -> Calibration:
    return calibrate(bench.session.frames, bench.session.plan)


def data_of(bench: Bench, frame: Frame, name: str) -> ChannelData:
    mosaic = read_photograph(frame.path, bench.session.plan.sensor)
    return channel_data(calibration_of(bench), frame, mosaic, name)


def exposed(
    bench: Bench, name: str, range_mm: float | None, mean_e: Floats | float
) -> ChannelData:
    """A channel of one more target frame."""
    return data_of(bench, bench.add("target", range_mm, mean_e), name)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    with made.session:
        yield made


@pytest.mark.parametrize("name", ["R", "G", "B"])
def test_illumination_and_response_are_found_within_their_errors(
    bench: Bench, name: str
) -> None:
    bench.usual()
    data = exposed(bench, name, 2200.0, 15000 * light_at(2200.0))
    truth = light_at(2200.0) * bench.sensor.response
    ratio = (data.illumination / truth)[data.mask]
    ratio /= ratio.mean()
    assert data.illumination[data.mask].mean() == pytest.approx(1.0, abs=2e-3)
    measured = 1 / np.sqrt(12 * 20000 * COLOURS[name])  # photons of 12 flats
    assert ratio.std() == pytest.approx(measured / np.hypot(1, measured / PRNU), rel=0.07)
    # the posterior std is the error made; of the illumination beneath it a little more is due
    assert ((ratio - 1) / data.relative_std[data.mask]).std() == pytest.approx(
        1.0, abs=0.05
    )


def test_smooth_light_leaves_nothing_large_scale_behind(bench: Bench) -> None:
    bench.usual()
    calibration = calibration_of(bench)
    green = np.zeros(SHAPE, dtype=bool)
    green[0::2, 1::2] = green[1::2, 0::2] = True
    ratio = np.where(green, calibration.illumination[2000.0] / light_at(2000.0), 0.0)
    blocks = ratio.reshape(6, 30, 8, 30).sum(axis=(1, 3)) / 450
    blocks /= blocks.mean()
    # a block of 450 pixels of 0.6 % response has a mean that scatters by 0.03 %; photons add as much
    assert blocks.std() < 1.5e-3


def test_data_over_model_scatters_by_photons_and_read_noise_alone(bench: Bench) -> None:
    bench.usual(frames=8)
    mean_e = 15000 * light_at(2000.0)
    data = exposed(bench, "G", 2000.0, mean_e)
    assert data.noise.gain is not None
    assert data.noise.read_noise is not None
    level = GAIN * 15000 * np.mean(light_at(2000.0))
    model = level * data.illumination
    model *= data.counts[data.mask].sum() / model[data.mask].sum()
    variance = (
        data.noise.gain * model
        + data.noise.read_noise**2
        + 1 / 12
        + (model * data.relative_std) ** 2
    )
    z = ((data.counts - model) / np.sqrt(variance))[data.mask]
    assert z.std() == pytest.approx(
        1.0, abs=4 / np.sqrt(2 * z.size) + 0.005
    )  # and half a per cent for the light's fit


def test_gain_and_read_noise_are_the_sensors(bench: Bench) -> None:
    bench.usual()
    data = exposed(bench, "B", 2000.0, 100.0)
    assert data.noise.gain is not None
    assert data.noise.gain_std is not None
    assert data.noise.read_noise is not None
    assert data.noise.read_noise_std is not None
    assert abs(data.noise.gain - GAIN) < 4 * data.noise.gain_std < 0.02
    assert abs(data.noise.read_noise - READ_NOISE) < 4 * data.noise.read_noise_std < 0.1
    assert data.findings == ()


def test_the_two_greens_keep_their_ratio(bench: Bench) -> None:
    bench.sensor.colour[1::2, 0::2] *= 0.97
    bench.usual()
    data = exposed(bench, "G", 2000.0, 100.0)
    ratio = (data.illumination / light_at(2000.0))[1::2, 0::2].mean() / (
        data.illumination / light_at(2000.0)
    )[0::2, 1::2].mean()
    assert ratio == pytest.approx(0.97, abs=1e-3)


def test_hot_dead_and_saturated_pixels_are_masked_and_others_kept(bench: Bench) -> None:
    bench.sensor.offset[20, 30] = 900.0
    bench.sensor.response[41, 50] = 0.3
    bench.usual()
    mean_e = np.full(SHAPE, 5000.0)
    mean_e[60:70, 60:70] = 60000.0
    data = exposed(bench, "R", 2000.0, mean_e)
    assert not data.mask[20, 30]
    assert not data.mask[60:70:2, 60:70:2].any()
    assert not data.mask[1::2].any()
    assert not data.mask[:, 1::2].any()
    assert data.mask[0::2, 0::2].sum() >= 90 * 120 - 1 - 25 - 2
    assert not data_of(bench, bench.session.frames[-1], "G").mask[41, 50]


def test_offset_that_pixels_have_of_their_own_is_taken_off(bench: Bench) -> None:
    bench.sensor.offset = 3.0 * bench.sensor.rng.standard_normal(SHAPE) + 7.0
    bench.usual(frames=8)
    data = exposed(bench, "R", 2000.0, 0.0)
    expected = np.sqrt(READ_NOISE**2 + 1 / 12) * np.sqrt(1 + 1 / 8)
    assert data.counts[data.mask].std() == pytest.approx(expected, rel=0.03)
    assert data.counts[data.mask].mean() == pytest.approx(
        0.0, abs=4 * expected / np.sqrt(data.mask.sum())
    )


def test_equal_offsets_are_not_made_unequal_by_the_darks_noise(bench: Bench) -> None:
    bench.usual(frames=4)
    calibration = calibration_of(bench)
    assert calibration.offset is not None
    assert calibration.offset.std() < 0.15 * READ_NOISE / np.sqrt(4)


def test_without_any_calibration_everything_is_assumed_and_said(bench: Bench) -> None:
    data = exposed(bench, "G", None, 1000.0)
    assert np.all(data.illumination == 1)
    assert np.all(data.relative_std == 0)
    assert (data.noise.gain, data.noise.read_noise) == (None, None)
    assert data.counts.mean() == pytest.approx(
        GAIN * 1000 * np.mean(bench.sensor.colour), rel=0.01
    )
    assert codes(data.findings) == ["no-dark-frames", "no-flat-frames"]


def test_flats_of_the_nearest_range_stand_in_and_that_is_said(bench: Bench) -> None:
    bench.usual(frames=2)
    data = exposed(bench, "G", 2150.0, 1000.0)
    (finding,) = data.findings
    assert finding.text == "no flat frames at 2150 mm: those at 2200 mm are taken instead"
    assert finding.numbers == {"range_mm": 2150.0, "taken_mm": 2200.0}


def test_one_flat_a_range_gives_light_but_neither_gain_nor_response(bench: Bench) -> None:
    bench.add("flat", 2000.0, 20000 * light_at(2000.0))
    data = exposed(bench, "G", 2000.0, 1000.0)
    assert data.noise.gain is None
    assert "gain-not-measured" in codes(data.findings)
    assert np.std(data.illumination[data.mask] / light_at(2000.0)[data.mask]) < 2e-3


def test_bias_frames_stand_in_for_darks_and_that_is_said(bench: Bench) -> None:
    bench.add("bias", None, 0.0, 4)
    data = exposed(bench, "G", 2000.0, 1000.0)
    assert "bias-instead-of-darks" in codes(data.findings)
    assert data.noise.read_noise == pytest.approx(READ_NOISE, rel=0.02)


def test_what_the_display_does_not_reach_is_not_used(bench: Bench) -> None:
    lit = np.zeros(SHAPE)
    lit[30:150, 40:200] = 1.0
    bench.add("dark", None, 0.0, 4)
    bench.add("flat", 2000.0, 20000 * light_at(2000.0) * lit, 4)
    data = exposed(bench, "G", 2000.0, 1000.0)
    assert not data.mask[:28].any()
    assert data.mask[50:130, 60:180].sum() > 0.48 * 80 * 120
    ratio = (data.illumination / light_at(2000.0) / bench.sensor.response)[data.mask]
    assert ratio.std() / ratio.mean() < 0.005
    assert "flats-partly-unlit" in codes(data.findings)


CUT = (slice(20, 150), slice(40, 190))
CORNERS = np.array([[30.0, 50.0], [30, 170], [130, 170], [130, 50]])


def cut_frames(bench: Bench) -> list[Frame]:
    """The session's photographs, of which only the cut was kept."""
    cut = []
    for frame in bench.session.frames:
        path = bench.folder / f"cut_{frame.file}"
        tifffile.imwrite(path, tifffile.imread(frame.path)[CUT])
        cut.append(replace(frame, path=path))
    return cut


def test_a_part_is_calibrated_as_if_the_camera_had_seen_it_alone(bench: Bench) -> None:
    bench.usual(frames=3)
    frame = bench.add("target", 2200.0, 15000 * light_at(2200.0))
    plan = bench.session.plan
    part = Needed(CUT, (CORNERS,))
    found = calibrate(bench.session.frames, plan, {2000.0: part, 2200.0: part})
    alone = [*cut_frames(bench)]
    origin = np.array([CUT[0].start, CUT[1].start])
    whole = (slice(0, 130), slice(0, 150))
    same = Needed(whole, (CORNERS - origin,))
    expected = calibrate(alone, plan, {2000.0: same, 2200.0: same})
    assert found.noise == expected.noise
    data = channel_data(
        found, frame, read_photograph(frame.path, plan.sensor, CUT), "G", CUT
    )
    crop = read_photograph(alone[-1].path, plan.sensor)
    truth = channel_data(expected, alone[-1], crop, "G", whole)
    for name in ("counts", "mask", "illumination", "relative_std"):
        np.testing.assert_array_equal(getattr(data, name), getattr(truth, name))
    assert found.response is not None
    assert found.response.shape == (130, 150)


def test_a_room_around_the_display_changes_nothing(bench: Bench) -> None:
    bench.add("dark", None, 0.0, 4)
    y, x = np.indices(SHAPE)
    room = 14000 * (1 + np.sin(x / 9) * np.cos(y / 7))  # in places as bright as the display
    display = np.zeros(SHAPE, bool)
    display[24:138, 42:182] = True
    lights = {
        2000.0: light_at(2000.0),
        2200.0: np.where(display, light_at(2200.0), room / 20000),
    }
    for range_mm, light in lights.items():
        bench.add("flat", range_mm, 20000 * light, 4)
    part = Needed.by_targets([CORNERS])
    found = calibrate(
        bench.session.frames, bench.session.plan, {2000.0: part, 2200.0: part}
    )
    cut = part.cut
    lit = np.isfinite(found.illumination[2200.0])
    # measured: 0.994; the room beside the display has its very brightness in places
    assert np.mean(lit == display[cut]) > 0.99
    ratio = (found.illumination[2200.0] / light_at(2200.0)[cut])[1::2, 0::2]
    # measured: 0.00038, and 0.00042 at 2000 mm, where there is no room
    assert np.nanstd(ratio) / np.nanmean(ratio) < 7e-4
    assert found.findings == ()


def test_flats_of_a_range_are_needed_where_its_targets_are(bench: Bench) -> None:
    bench.usual(frames=3)
    near, far = (
        Needed((slice(20, 160), slice(30, 210))),
        Needed((slice(60, 120), slice(80, 160))),
    )
    found = calibrate(bench.session.frames, bench.session.plan, {2000.0: near, 2200.0: far})
    assert np.isfinite(found.illumination[2000.0]).all()
    seen = np.isfinite(found.illumination[2200.0])
    assert seen[40:100, 50:130].all()
    assert seen.sum() == 60 * 80
    assert found.response is not None
    assert found.response.shape == (140, 180)


def test_memory_is_that_of_the_part_not_of_the_frames(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    kinds: dict[FrameKind, float] = {"dark": 600, "flat": 9000}
    bench = Bench(tmp_path)
    with bench.session:
        for kind, level in kinds.items():
            for k in range(3):
                counts = rng.poisson(level, (1600, 2400)).astype(np.uint16)
                path = tmp_path / f"{kind}{k}.tif"
                tifffile.imwrite(path, counts)
                bench.session.add_frame(path, path.name, kind, None)
    part = Needed((slice(800, 900), slice(1200, 1300)))
    tracemalloc.start()
    calibrate(bench.session.frames, bench.session.plan, {None: part})
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # measured: 1.7 MB, where a single frame has 7.7 and a mean of three has 31
    assert most < 3.4e6


def test_colours_that_the_plan_leaves_out_are_not_called_unlit(tmp_path: Path) -> None:
    bench = Bench(tmp_path, colours="G")
    with bench.session:
        bench.usual()
        assert calibration_of(bench).findings == ()


def test_frames_of_another_size_are_refused(bench: Bench) -> None:
    bench.usual(frames=2)
    tifffile.imwrite(bench.folder / "small.tif", np.full((90, 120), 900, np.uint16))
    frame = bench.session.add_frame(
        bench.folder / "small.tif", "small.tif", "target", 2000.0
    )
    with pytest.raises(DataError, match=r"small\.tif has 90×120 pixels"):
        data_of(bench, frame, "G")
    bench.session.add_frame(bench.folder / "small.tif", "small_dark.tif", "dark", None)
    with pytest.raises(DataError, match=r"small_dark\.tif is of another sensor"):
        calibration_of(bench)


def test_a_lost_file_is_named(bench: Bench) -> None:
    bench.usual(frames=2)
    bench.add("target", 2000.0, 100.0)
    frame = replace(bench.session.frames[-1], path=bench.folder / "lost.tif")
    with pytest.raises(RawError, match=r"lost\.tif"):
        data_of(bench, frame, "G")


def test_a_frame_that_is_saturated_everywhere_is_refused(bench: Bench) -> None:
    with pytest.raises(DataError, match="no usable pixel"):
        exposed(bench, "G", 2000.0, 1e6)


def test_a_particle_in_one_frame_does_not_reach_the_mean() -> None:
    rng = np.random.default_rng(3)
    stack = rng.normal(600, 2, (6, 40, 50)).round().astype(np.uint16)
    clean = clipped_mean(stack)
    assert (
        np.mean(clean != stack.mean(axis=0)) < 0.03
    )  # good values are hardly ever left out
    stack[2, 10, 10] = 9000
    assert clipped_mean(stack)[10, 10] == pytest.approx(clean[10, 10], abs=2.0)


@pytest.mark.parametrize("spread", [0.0, 0.5, 3.0])
def test_shrunk_values_err_by_their_posterior_deviation(spread: float) -> None:
    rng = np.random.default_rng(4)
    truth = 5 + spread * rng.standard_normal((100, 100))
    error = rng.uniform(0.5, 1.5, truth.shape)
    found, std = shrunk(truth + error * rng.standard_normal(truth.shape), error**2)
    assert np.mean((found - truth) ** 2) <= 1.05 * np.mean(std**2) + 2e-3
    assert np.mean((found - truth) ** 2) < np.mean(error**2)


def test_a_polynomial_light_comes_back_and_unequal_pixels_do_not_bend_it() -> None:
    rng = np.random.default_rng(5)
    truth = light_at(2000.0)
    flat = 8000 * truth * (1 + 0.01 * rng.standard_normal(SHAPE))
    found = smooth_illumination(flat, np.ones(SHAPE, dtype=bool))
    assert found.level == pytest.approx(8000 * truth.mean(), rel=1e-3)
    assert (
        np.max(np.abs(found.relative / truth * truth.mean() - 1)) < 3e-3
    )  # the corners, where least is averaged
