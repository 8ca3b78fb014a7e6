"""Whole frames of the simulated camera: the panel in a room."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated import spread
from labkit.drivers.simulated.address import ordered
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.image import patches
from labkit.drivers.simulated.setup import in_a_room, settings_for, shared_bench
from labkit.drivers.simulated.world import BenchSettings, TrueLens, TruePose
from labkit.errors import PlanError
from labkit.plan import Plan
from labkit.types import Counts, Floats
from tests.plans import SMALL, plan_text, simulated

PLAN = Plan.parse(plan_text(SMALL, simulated([2000, 2100], 1950.0)), Path())
BLACK, GAIN, READ_NOISE = 600.0, 0.45, 2.5 * 0.45
SHAPE = 816, 1224
"""Of a frame of a megapixel."""


def settings(words: str = "sensor=1mp", seed: int = 3) -> BenchSettings:
    """A room's settings, with a halo cut short: a photograph of it takes a moment."""
    usual = replace(settings_for(PLAN, seed), halo_um=60.0)
    return in_a_room(usual, PLAN, ordered(f"simulated:seed={seed},{words}"))


def bench(words: str = "sensor=1mp", seed: int = 3) -> Bench:
    return show(Bench(settings(words, seed)))


def show(made: Bench) -> Bench:
    """Return a bench that stands at a station, with the carpet on its panel."""
    made.turn_screw(50.0)
    made.stand(50.0)
    made.light(carpet())
    return made


@pytest.fixture(scope="module")
def lit() -> Bench:
    """A bench that shows the carpet in a bright room; its photographs are told apart by their names."""
    return bench()


def carpet() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Squares of some 40 pixels of the sensor altogether."""
    cells = np.indices((9, 9)).sum(axis=0) % 2
    return np.asarray(255 * np.kron(cells, np.ones((10, 10))), dtype=np.uint8)


def white() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    return np.full(PLAN_PANEL, 255, dtype=np.uint8)


PLAN_PANEL = settings_for(PLAN, 3).panel.pixels


def green(counts: Counts) -> Floats:
    return counts[::2, 1::2].astype(float) - BLACK


@pytest.mark.parametrize(
    ("words", "shape"),
    [
        ("6mp", (2000, 3000)),
        ("24mp", (4000, 6000)),
        ("45mp", (5480, 8216)),
        ("100mp", (8168, 12248)),
    ],
)
def test_a_whole_frame_has_the_ordered_size_and_the_format_of_cameras(
    words: str, shape: tuple[int, int]
) -> None:
    sensor = settings(f"sensor={words}").sensor
    assert (sensor.rows, sensor.cols) == shape
    assert sensor.rows * sensor.cols == pytest.approx(1e6 * float(words[:-2]), rel=0.002)


@pytest.mark.parametrize(
    "word", ["sensor=24", "sensor=0.5mp", "sensor=151mp", "room=pink,sensor=6mp"]
)
def test_a_wrong_size_or_room_is_refused_with_what_is_allowed(word: str) -> None:
    with pytest.raises(
        PlanError, match=r"sensor=24mp \(a whole frame of 1 to 150 megapixels\)"
    ):
        ordered(f"simulated:{word}")


def test_a_room_without_a_whole_frame_is_refused() -> None:
    with pytest.raises(PlanError, match="room=dark needs a whole frame: add sensor=24mp"):
        ordered("simulated:room=dark")


def test_the_address_makes_the_room() -> None:
    lease = shared_bench(DeviceContext(), "simulated:seed=3,sensor=1mp", PLAN)
    assert lease.part.expose(0.02, 100, "a").shape == SHAPE
    lease.close()


def test_one_seed_is_one_room_and_another_seed_another(lit: Bench) -> None:
    first = lit.expose(0.02, 100, "a")
    again, other = (bench(seed=seed).expose(0.02, 100, "a") for seed in (3, 4))
    np.testing.assert_array_equal(first, again)
    far = slice(0, 200)
    assert np.abs(green(first)[far] - green(other)[far]).mean() > 200


def test_the_target_is_rendered_as_on_a_sensor_that_just_holds_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # light is followed as far on both
    monkeypatch.setattr(spread, "FARTHEST_PX", 60)
    # seen from aside, a tilted panel has another perspective
    upright = TruePose(tilt_deg=0.0)
    made = show(Bench(replace(settings(), pose=upright)))
    cut = made.settings.fine
    assert made._picture().shape == made.settings.fine_shape
    # a sensor of the fine pixels alone, whose aim points where the frame's does
    middle = [(part.start + part.stop - 1) / 2 for part in cut]
    of_frame = made.view.middle
    room = made.settings.room
    assert room
    aside = [of_frame[i] + room.target_px[i] - middle[i] for i in (0, 1)]
    rows, cols = made.settings.fine_shape
    alone = replace(
        made.settings,
        sensor=replace(
            made.settings.sensor, rows=rows, cols=cols, hot_pixels=0, dead_pixels=0
        ),
        room=replace(room, target_px=(aside[0], aside[1])),
    )
    other = show(Bench(alone))
    apart = other._picture() - made._picture()
    # the points that average a sample with an edge lie elsewhere in it; measured: 7.9e-4, RMS 5.4e-5
    assert np.abs(apart).max() < 1.6e-3
    assert np.sqrt(np.mean(apart**2)) < 1.1e-4


def test_a_psf_that_changes_over_the_frame_is_that_of_the_targets_place_in_the_frame() -> (
    None
):
    varying = replace(TrueLens(), field_terms=FieldTerms(field_curvature_per_mm=-0.01))
    made = Bench(replace(settings(), lens=varying, patch_px=64.0))
    rows, cols = made.settings.fine
    places = [place for patch in patches(made.view) for place, _ in patch.blends if place]
    for axis, part in enumerate((rows, cols)):
        along = [place[axis] for place in places]
        # from the first pixel's outer edge to the last one's
        assert (min(along), max(along)) == (part.start - 0.5, part.stop - 0.5)


@pytest.mark.parametrize("words", ["sensor=1mp", "sensor=1mp,room=dark"])
def test_the_border_of_the_fine_pixels_is_black_and_has_no_step(words: str) -> None:
    made = bench(words)
    counts = green(made.expose(0.02, 100, "a"))
    rows, cols = made.settings.fine
    for seam in (rows.start // 2, rows.stop // 2):
        inside = slice(cols.start // 2 + 2, cols.stop // 2 - 2)
        above = np.median(counts[seam - 6 : seam, inside])
        below = np.median(counts[seam : seam + 6, inside])
        # a panel of contrast 800 sends 13 counts, and the carpet's halo one or two
        assert abs(above - below) <= 2
        assert max(above, below) < 20


def test_the_border_of_the_fine_pixels_is_far_outside_of_what_a_fit_cuts_out() -> None:
    made = bench()
    corners = 4.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    places = np.array([made.view.place(x, y) for x, y in corners])
    margin = max(10.0, 0.06 * np.ptp(places, axis=0).max())
    for part, at in zip(made.settings.fine, places.T, strict=True):
        assert part.start < at.min() - margin - 10
        assert part.stop > at.max() + margin + 10


def test_a_window_is_brighter_than_the_panel_and_the_bezel_black() -> None:
    made = bench()
    made.light(white())
    seen = green(made.expose(0.02, 100, "a"))
    panel = np.median(
        seen[tuple(slice(p.start // 2, p.stop // 2) for p in made.settings.fine)]
    )
    assert np.mean(seen > 1.3 * panel) > 0.05
    down, right = (round(at / 2) for at in made.view.place(0.0, -22.0))
    assert seen[down, right] < 0.01 * panel


def test_a_dark_room_is_nearly_black_around_the_panel(lit: Bench) -> None:
    seen = green(bench("sensor=1mp,room=dark").expose(0.02, 100, "a"))
    bright = green(lit.expose(0.02, 100, "a"))
    # a wall of 0.28 times 0.003 sends ten counts
    assert np.median(seen) < 20 < 0.02 * np.median(bright)


def test_noise_is_of_photons_and_reading_in_the_room_too(lit: Bench) -> None:
    first, second = (lit.expose(0.02, 100, name).astype(float) for name in ("a", "b"))
    light = (first + second) / 2 - BLACK
    expected = 2 * (GAIN * np.maximum(light, 0) + READ_NOISE**2 + 1 / 12)
    steady = light < 12000
    for low, high in ((-5, 300), (300, 3000), (3000, 12000)):
        part = steady & (low <= light) & (light < high)
        ratio = np.mean((first - second)[part] ** 2) / np.mean(expected[part])
        # the mean of n squared normals has a relative error of sqrt(2 / n); allow four of them,
        # and 1 % for the selection by the noisy light itself
        assert ratio == pytest.approx(1, abs=4 * np.sqrt(2 / part.sum()) + 0.01)


def test_a_covered_lens_sees_no_room() -> None:
    made = bench()
    made.covered = True
    dark = made.expose(0.02, 100, "a").astype(float)
    assert dark.shape == SHAPE
    assert np.median(dark) == BLACK
    hot = dark > BLACK + 100
    assert hot.sum() == made.settings.sensor.hot_pixels
    assert np.std(dark[~hot]) == pytest.approx(np.sqrt(READ_NOISE**2 + 1 / 12), rel=0.01)


def test_the_response_of_pixels_is_the_same_in_each_photograph() -> None:
    made = bench()
    made.light(white())
    # what light and room have at large is taken away
    first, second = (green(made.expose(0.02, 100, name)) for name in "ab")
    panel = np.ix_(*(range(part.start // 2, part.stop // 2) for part in made.settings.fine))
    smooth = [
        one[panel] - cv2.medianBlur(one[panel].astype("f4"), 5) for one in (first, second)
    ]
    usual = np.abs(smooth[0]) < 0.05 * np.median(first[panel])
    # a response of 0.7 %, and in each photograph noise of 1 in sqrt(23000) = 0.66 %; the median of 25
    # pixels adds a twentieth of both
    seen = np.corrcoef(smooth[0][usual], smooth[1][usual])[0, 1]
    # the correlation of 4000 pairs has an error of (1 - r²) / sqrt(4000) = 0.011; allow four
    assert seen == pytest.approx(0.7**2 / (0.7**2 + 0.66**2), abs=0.045)
