"""The simulated lens over the frame: against closed forms, another simulator's truth, and superposed points of light."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.field import Distortion, FieldTerms, um_per_wave
from labkit.drivers.simulated.image import fine_grid
from labkit.drivers.simulated.optics import REFERENCE_NM
from labkit.drivers.simulated.pupil import ROUND_PUPIL
from labkit.drivers.simulated.scene import photograph, render, transform
from labkit.drivers.simulated.spread import psf_and_halo
from labkit.drivers.simulated.view import cone
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueGrid,
    TrueLens,
    TruePanel,
    TruePose,
    TrueRail,
    TrueSensor,
)
from labkit.types import Floats32

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
LENS = TrueLens(
    35.0, 4.0, 1.05, {"G": 540.0}, {"G": 1226.0}, aberration_waves=0.0, vignetting=0.0
)
WILD = FieldTerms(
    field_curvature_per_mm=-0.08,
    sensor_tilt_um_per_mm=(24.0, -15.0),
    coma_waves=(0.1, -0.07),
    coma_per_mm=0.2,
    astigmatism_per_mm=(0.03, -0.08),
    astigmatism_per_mm2=0.2,
)
"""A small frame of this lens changes as much as a large one of a usual lens."""

SMALL = BenchSettings(
    lens=LENS,
    sensor=TrueSensor(
        rows=96, cols=144, pitch_um=5.2, pattern="mono", hot_pixels=0, dead_pixels=0
    ),
    panel=TruePanel(pixels=(300, 400), pitch_mm=0.2, unevenness=0.0, contrast=1e9),
    rail=TrueRail(range_at_zero_mm=1200.0, scatter_mm=0.0),
    pose=TruePose(0.0, 0.0, 0.0, 0.0),
    halo_um=80.0,
    samples_per_pixel=6,
)


def with_field(terms: FieldTerms, settings: BenchSettings = SMALL) -> BenchSettings:
    return replace(settings, lens=replace(settings.lens, field_terms=terms))


def dots(*places: tuple[int, int]) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """A picture for the whole panel, dark but for some of its pixels."""
    picture = np.zeros(SMALL.panel.pixels, dtype=np.uint8)
    for row, col in places:
        picture[row, col] = 255
    return picture


def centroid(light: Floats32) -> tuple[float, float]:
    y, x = np.indices(light.shape)
    return float((y * light).sum() / light.sum()), float((x * light).sum() / light.sum())


def test_a_tilted_sensor_moves_best_focus_in_proportion_to_the_place() -> None:
    bench = Bench(with_field(FieldTerms(sensor_tilt_um_per_mm=(24.0, -15.0))))
    view = bench.view

    def image_mm(place: tuple[float, float]) -> float:
        """Where the image of the range that is sharp at a place lies, by the thin lens."""
        sharp_mm = brentq(
            lambda mm: replace(view, range_mm=mm).waves("G", place)[4], 1000.0, 1500.0
        )
        return 1 / (1 / 35.0 - 1 / sharp_mm)

    for row, col in ((10.0, 20.0), (80.0, 71.5), (47.5, 140.0), (90.0, 5.0)):
        tilted = 1e-3 * 5.2e-3 * (24.0 * (row - 47.5) - 15.0 * (col - 71.5))
        moved = image_mm((row, col)) - image_mm((47.5, 71.5))
        # a cone of f/4.1 has spheres, and a wave of tilt counts as a paraboloid's: 1.1 % apart
        assert moved == pytest.approx(tilted, rel=0.02)


@pytest.mark.skipif(not GOLDEN.exists(), reason="no golden sessions here")
def test_modes_are_those_of_the_golden_fields_simulator() -> None:
    truth = json.loads((GOLDEN / "truth-field-open.json").read_text())
    terms = FieldTerms(
        field_curvature_per_mm=truth["curvature_per_mm"],
        sensor_tilt_um_per_mm=tuple(truth["tilt_um_per_mm"]),
        coma_waves=(0.03, -0.02),
        coma_per_mm=0.022,
        astigmatism_per_mm=(0.006, -0.010),
        astigmatism_per_mm2=0.016,
    )
    tiles = [t for t in truth["tiles"] if (t["range_mm"], t["channel"]) == (1220.0, "G")]
    away = {}
    for tile in tiles:
        down, right = np.subtract(tile["centre_px"], truth["axis_px"]) * 5.2e-3
        ours = terms.waves(
            (down, right), 540.0, um_per_wave(cone(LENS), REFERENCE_NM), 38.0
        )
        away[tuple(tile["tile"])] = [tile["modes"][str(j)] - ours[j] for j in range(4, 9)]
    # what is left is the same in all tiles: defocus of the range, and nothing else
    assert len(away) == 6
    np.testing.assert_allclose(list(away.values()), [away[0, 0]] * 6, atol=1e-12)
    np.testing.assert_allclose(away[0, 0][1:], 0.0, atol=1e-12)


def test_distortion_moves_places_by_the_cube_of_their_distance() -> None:
    k1 = 0.08
    places = []
    for terms in (
        FieldTerms(),
        FieldTerms(k1_per_mm2=k1, distortion_centre_mm=(0.05, -0.1)),
    ):
        bench = Bench(with_field(terms))
        bench.light(dots((120, 160)))
        places.append(centroid(bench.irradiance("G")))
    centre = np.array([47.5, 71.5]) + np.array([0.05, -0.1]) / 5.2e-3
    away = places[0] - centre
    expected = centre + away * (1 + k1 * (away @ away) * 5.2e-3**2)
    assert np.hypot(*(expected - places[0])) > 0.2
    # the dot's light that leaves the frame pulls a centroid by a few thousandths of a pixel
    np.testing.assert_allclose(places[1], expected, atol=0.01)


@pytest.mark.parametrize("k1", [-3e-6, 2e-5, 1e-4])
def test_distortion_is_undone_exactly(k1: float) -> None:
    lens = Distortion(k1, (71.5, 40.0))
    x, y = np.meshgrid(np.linspace(-20, 100, 9), np.linspace(-20, 70, 7))
    back = lens.straight(*lens.distorted(x, y))
    assert k1 * 100**2 < 1.1
    np.testing.assert_allclose(back, (x, y), atol=1e-9)


def test_flats_do_not_see_aberrations() -> None:
    even, wild = (Bench(with_field(terms)) for terms in (FieldTerms(), WILD))
    for bench in (even, wild):
        bench.light(np.full(SMALL.panel.pixels, 255, dtype=np.uint8))
    np.testing.assert_array_equal(even.expose(0.02, 100, "a"), wild.expose(0.02, 100, "a"))


def test_light_falls_with_the_fourth_power_of_the_cosine() -> None:
    light = FieldTerms(cos4=1.0, axis_mm=(0.2, -0.1)).light((5, 7), 2.0, ROUND_PUPIL, 30.0)
    down, right = 4.0 - 0.2, -6.0 + 0.1
    angle = np.arctan(np.hypot(down, right) / 30.0)
    assert light[4, 0] == pytest.approx(np.cos(angle) ** 4, rel=1e-12)


def test_a_cats_eye_leaves_the_overlap_of_two_circles() -> None:
    terms = FieldTerms(cats_eye_per_mm=(0.3, 1.0))
    light = terms.light((1, 9), 0.5, ROUND_PUPIL, 30.0)[0]
    apart = 0.3 * 0.5 * np.abs(np.arange(9) - 4)
    lens = 2 * np.arccos(apart / 2) - apart / 2 * np.sqrt(4 - apart**2)
    np.testing.assert_allclose(light, lens / np.pi, atol=2e-4)
    pupil = terms.pupil((0.0, -1.0), ROUND_PUPIL)
    assert pupil.cats_eye == pytest.approx((0.3, 1.0, 180.0))


def of_one_point(bench: Bench, dot: tuple[int, int]) -> Floats32:
    """The picture of a dot alone, all of its light spread by the PSF of its own place."""
    bench.light(dots(dot))
    view = bench.view
    grid = fine_grid(view)
    place = view.place((dot[1] + 0.5 - 200) * 0.2, (dot[0] + 0.5 - 150) * 0.2)
    psf, halo = psf_and_halo(view.through(place), "G", view.waves("G", place), grid)
    scene = transform(render(bench._glass(None), view.to_pixels(), grid), grid)
    total = np.float32(psf.sum() + halo.sum())
    return np.asarray(photograph(scene, psf, 1.0, halo) / total)


@pytest.mark.parametrize(("patch_px", "worst"), [(96.0, 0.012), (48.0, 0.002)])
def test_a_picture_in_patches_is_the_sum_of_points_each_with_its_own_psf(
    patch_px: float, worst: float
) -> None:
    """The points are off the knots, where PSFs are exact. What remains at 48 pixels is that light takes the PSF of where it
    arrives, not of where it belongs; this lens changes ten times as fast as that of golden field-open."""
    bench = Bench(replace(with_field(WILD), patch_px=patch_px))
    points = [(125, 160), (130, 245), (150, 200), (180, 155), (172, 240)]
    superposed = sum(of_one_point(bench, dot) for dot in points)
    bench.light(dots(*points))
    apart = np.abs(bench.irradiance("G") - superposed).max() / np.max(superposed)
    assert worst / 2 < apart < worst


def test_a_tile_is_seen_through_the_lens_at_its_centre() -> None:
    grid = TrueGrid((1, 2), 14.0)
    bench = Bench(replace(with_field(WILD), grid=grid))
    view = bench.view
    picture = np.zeros(SMALL.panel.pixels, dtype=np.uint8)
    for tile in range(2):
        left = 200 + round((tile - 0.5) * 70) - 22
        picture[128:172, left : left + 44] = np.random.default_rng(1).integers(
            0, 255, (44, 44)
        )
    bench.light(picture)
    drawn = bench.irradiance("G")
    grid_px = fine_grid(view)
    scene = transform(render(bench._glass(None), view.to_pixels(), grid_px), grid_px)
    for tile in range(2):
        row, col = view.tile_place((0, tile))
        psf, halo = psf_and_halo(view.settings, "G", view.waves("G", (row, col)), grid_px)
        even = photograph(scene, psf, 1.0, halo) / (psf.sum() + halo.sum())
        inside = slice(int(row) - 15, int(row) + 15), slice(int(col) - 15, int(col) + 15)
        # single precision, and far light that is that of the axis
        np.testing.assert_allclose(drawn[inside], even[inside], atol=1e-3)


def test_the_truth_names_each_tile_its_place_and_its_modes() -> None:
    settings = with_field(replace(WILD, k1_per_mm2=0.02), SMALL)
    bench = Bench(replace(settings, grid=TrueGrid((2, 3), 8.0)))
    bench.light(dots((150, 200)))
    bench.expose(0.02, 100, "a")
    truth = json.loads(bench.truth.to_json())
    assert truth["field_terms"]["sensor_tilt_um_per_mm"] == [24.0, -15.0]
    (visit,) = truth["visits"]
    assert [tile["tile"] for tile in visit["tiles"]] == [
        [r, c] for r in range(2) for c in range(3)
    ]
    last = visit["tiles"][-1]
    down, right = 4.0, 8.0  # mm on the panel
    per_mm = (
        np.array(visit["target_to_pixels"])[0, 0]
        / np.array(visit["target_to_pixels"])[2, 2]
    )
    ideal = per_mm * np.array([down, right])
    moved = ideal * (1 + 0.02 * (ideal @ ideal) * 5.2e-3**2)
    np.testing.assert_allclose(
        last["centre_px"], [moved[0] + 47.5, moved[1] + 71.5], rtol=1e-9
    )
    height = moved * 5.2e-3
    assert last["modes_waves"]["7"] == pytest.approx(0.1 + 0.2 * height[0])


def test_a_tilted_target_is_in_another_range_at_each_tile() -> None:
    settings = replace(
        SMALL, pose=TruePose(20.0, 0.0, 0.0, 0.0), grid=TrueGrid((1, 2), 40.0)
    )
    view = Bench(settings).view
    yaw = np.radians(view.aim.tilt_deg[1])
    for tile, right in ((0, -20.0), (1, 20.0)):
        found = view.waves("G", view.tile_place((0, tile)))[4]
        range_mm = view.range_mm - right * np.sin(yaw) * np.cos(
            np.radians(view.aim.tilt_deg[0])
        )
        assert found == pytest.approx(view.defocus("G", range_mm), abs=1e-9)
