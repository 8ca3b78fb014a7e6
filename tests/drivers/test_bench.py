"""The simulated world: noise, rail, panel, seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueLens,
    TruePanel,
    TrueRail,
    TrueSensor,
)

SMALL = BenchSettings(
    lens=TrueLens(f_number=8.0),
    sensor=TrueSensor(rows=60, cols=80, hot_pixels=3, dead_pixels=2),
    panel=TruePanel(pixels=(500, 600)),
    halo_um=200.0,
)


def white(bench: Bench) -> None:
    bench.light(np.full(bench.settings.panel.pixels, 255, dtype=np.uint8))


def stop_at(bench: Bench, position_mm: float) -> None:
    bench.turn_screw(position_mm)
    bench.stand(position_mm)


def test_the_same_seed_gives_the_same_photograph_and_another_another() -> None:
    pictures = []
    for seed in (4, 4, 5):
        bench = Bench(replace(SMALL, seed=seed))
        stop_at(bench, 40.0)
        white(bench)
        pictures.append(bench.expose(0.02, 100, "a"))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.any(pictures[0] != pictures[2])


def test_frames_of_other_names_differ_by_shot_and_read_noise() -> None:
    bench = Bench(SMALL)
    white(bench)
    first, second = (bench.expose(0.02, 100, name).astype(float) for name in ("a", "b"))
    electrons = (first - 600) / 0.45
    expected = 2 * 0.45**2 * (electrons + 2.5**2)  # of the difference
    steady = (electrons > 5000) & (first < 16000)
    ratio = np.mean((first - second)[steady] ** 2 / expected[steady])
    # the mean of 4800 squared normals has a relative error of 2 %; allow four
    assert ratio == pytest.approx(1, abs=4 * np.sqrt(2 / steady.sum()))


def test_white_fills_two_thirds_of_the_scale_and_iso_multiplies_counts() -> None:
    bench = Bench(SMALL)
    white(bench)
    green = bench.expose(0.02, 100, "a")[::2, 1::2]
    assert np.median(green) == pytest.approx(600 + 10350, rel=0.15)
    doubled = bench.expose(0.01, 200, "b")[::2, 1::2]
    assert np.median(doubled) == pytest.approx(np.median(green), rel=0.01)


def test_too_much_light_stops_at_the_white_level() -> None:
    bench = Bench(SMALL)
    white(bench)
    assert bench.expose(0.2, 100, "a").max() == 16383


def test_a_covered_lens_leaves_black_level_read_noise_and_hot_pixels() -> None:
    bench = Bench(SMALL)
    white(bench)
    bench.covered = True
    dark = bench.expose(0.02, 100, "a").astype(float)
    assert np.median(dark) == 600
    assert np.sum(dark > 700) == 3
    # rounding to whole counts adds 1/12 to the variance
    assert np.std(dark[dark < 700]) == pytest.approx(
        np.sqrt((2.5 * 0.45) ** 2 + 1 / 12), rel=0.05
    )


def test_a_grey_panel_is_as_bright_as_its_gamma_says() -> None:
    bench = Bench(SMALL)
    bench.light(np.full(SMALL.panel.pixels, 128, dtype=np.uint8))
    grey = bench.expose(0.02, 100, "a")[::2, 1::2].astype(float) - 600
    white(bench)
    full = bench.expose(0.02, 100, "b")[::2, 1::2].astype(float) - 600
    expected = 1 / 800 + (1 - 1 / 800) * (128 / 255) ** 2.2
    assert np.median(grey) / np.median(full) == pytest.approx(expected, rel=0.01)


def test_flats_show_the_same_shading_with_and_without_the_blur() -> None:
    bench = Bench(SMALL)
    stop_at(bench, 40.0)
    white(bench)
    quick = bench._uniform()
    np.testing.assert_allclose(quick, bench.irradiance("G"), rtol=2e-4)


def test_the_carriage_lags_by_the_play_when_driven_down() -> None:
    bench = Bench(replace(SMALL, rail=TrueRail(play_mm=0.15, scatter_mm=0.0)))
    bench.turn_screw(100.0)
    assert bench.position_mm == pytest.approx(100.0)
    bench.turn_screw(90.0)
    assert bench.position_mm == pytest.approx(90.15)


def test_stops_scatter_as_much_as_the_rail_does() -> None:
    bench = Bench(SMALL)
    bench.turn_screw(100.0)
    errors = []
    for _ in range(400):
        bench.stand(100.0)
        errors.append(bench.position_mm - 100.0)
    # the standard deviation of 400 draws has 3.5 % relative error; allow four of them
    assert np.std(errors) == pytest.approx(0.02, rel=0.14)


def test_the_truth_names_the_stop_by_its_plan_and_by_what_it_was() -> None:
    bench = Bench(SMALL)
    stop_at(bench, 63.2)
    bench.light(np.full((20, 20), 255, dtype=np.uint8))
    bench.expose(0.02, 100, "a")
    (visit,) = bench.truth.visits
    assert visit.range_mm == 3013.2
    assert visit.actual_range_mm == bench.range_mm != visit.range_mm
    assert set(visit.defocus_waves) == {"R", "G", "B"}
    np.testing.assert_allclose(
        np.linalg.norm(list(bench.truth.modes_waves["G"].values())), 0.07
    )


def test_a_picture_larger_than_the_panel_is_refused() -> None:
    with pytest.raises(ValueError, match="larger than the panel"):
        Bench(SMALL).light(np.zeros((501, 10), dtype=np.uint8))
