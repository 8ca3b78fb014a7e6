"""Distortion, lateral colour and a bent print by the tiles' places, against the numbers that made the places."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import kstest

from labkit.field.findings import geometry_findings
from labkit.field.geometry import FieldGeometry, fit_geometry
from labkit.field.tile_fit import chosen, fit_tiles
from labkit.field.tile_model import FIFTH
from labkit.field.tile_places import (
    CORNERS,
    TileGrid,
    TilePlace,
    corners_by_nodes,
    nodes,
    usual_covariance,
)
from labkit.key import Key
from labkit.types import Floats
from tests import tile_samples as field

POINT_MM = 1e-5
"""Side of a tile that is as good as a point."""

CORNER_PX = np.array([[511.0, 767.0]])

fit = partial(fit_geometry, field.FRAME, field.GRID, lens=field.LENS)


def fitted(
    std_px: float,
    seed: int,
    k1: float = 9e-4,
    centre_mm: Floats | tuple[float, float] = (0, 0),
) -> FieldGeometry:
    rng = np.random.default_rng(seed)
    model = field.model()
    numbers = field.numbers(model, rng, k1, tuple(centre_mm))
    return fit(field.observed(model, numbers, std_px, rng))


def test_the_corners_of_the_fit_are_those_of_the_nearest_homography() -> None:
    """A homography is its own nearest one; of a cube along x, linear least squares over the tile leaves 3/5 x."""
    near = np.array([[1.01, 0.02, 0.3], [-0.01, 0.99, -0.2], [0, 0, 1]])
    image = np.c_[nodes(), np.ones(len(nodes()))] @ near.T
    corners = (corners_by_nodes() @ image[:, :2].ravel()).reshape(4, 2)
    assert corners == pytest.approx(CORNERS @ near[:2, :2].T + near[:2, 2])
    cube = np.c_[np.zeros(len(nodes())), nodes()[:, 1] ** 3]
    corners = (corners_by_nodes() @ cube.ravel()).reshape(4, 2)
    assert corners == pytest.approx(0.6 * CORNERS * [0, 1])


def test_exact_places_give_the_numbers_that_made_them() -> None:
    found = fitted(1e-6, seed=1, centre_mm=(0.5, -0.25))
    assert found.k1_per_mm2.value == pytest.approx(9e-4, rel=1e-6)
    assert found.centre_px is not None
    assert found.centre_px[0] == pytest.approx(
        field.FRAME.places_px([0.5, -0.25]), abs=1e-3
    )
    for channel in "RB":
        scale = found.lateral_colour[channel].scale
        assert scale.value == pytest.approx(field.LATERAL[channel], rel=1e-4)
    assert found.residual_px < 2e-6
    assert found.percent(2.0).value == pytest.approx(9e-4 * 4 * 100, rel=1e-6)


def test_the_golden_field_s_places_give_its_distortion_and_lateral_colour() -> None:
    """The truth moves each range's picture after distortion by up to 4 px, so that one centre is wrong by 0.001 px RMS."""
    truth = field.truth()
    centres = {
        (t["range_mm"], t["channel"], tuple(t["tile"])): np.array(t["centre_px"])
        for t in truth["tiles"]
    }
    found = fit_geometry(
        field.FRAME,
        TileGrid(field.GRID.shape, field.GRID.pitch_mm, (POINT_MM, POINT_MM)),
        [
            TilePlace(Key(*key), at + POINT_MM * CORNERS, _of_the_middle(1e-3))
            for key, at in centres.items()
        ],
        field.LENS,
    )
    assert found.residual_px < 1.5e-3
    away_px = 0.5 * np.hypot(512, 768) * (found.percent(2.4).value / 100 - 9e-4 * 2.4**2)
    assert abs(away_px) < 0.01
    for channel in "RB":
        lateral_px, _ = found.lateral_px(channel, CORNER_PX)
        expected = truth["lateral"][channel] * (CORNER_PX - truth["axis_px"])
        assert np.abs(lateral_px - expected).max() < 2e-3


def through_a_pinhole(on_target: Floats, range_mm: float, tilt: Floats) -> Floats:
    """Return the image of places (n, 2) on a tilted target, mm, with distortion."""
    depth = range_mm + on_target @ np.tan(tilt)
    flat = 36.0 * on_target / depth[:, None]
    return np.asarray(flat * (1 + 9e-4 * (flat**2).sum(axis=1, keepdims=True)))


def linear_tiles(std_px: float, rng: np.random.Generator) -> list[TilePlace]:
    """Return tiles drawn by the linear map at their middles, as the golden field's are."""
    root = np.linalg.cholesky(usual_covariance())
    step_mm = 1e-3
    places = []
    for range_mm, tilt in zip(
        field.RANGES_MM, rng.uniform(-0.07, 0.07, (3, 2)), strict=True
    ):
        image = partial(through_a_pinhole, range_mm=range_mm, tilt=tilt)
        for tile in field.TILES:
            middle = field.GRID.places_mm(tile, np.zeros((1, 2)))
            step = step_mm * np.eye(2)
            by_mm = (image(middle + step) - image(middle - step)) / (2 * step_mm)
            away = field.GRID.places_mm(tile, CORNERS) - middle
            at = field.FRAME.places_px(image(middle) + away @ by_mm)
            error = std_px * (root @ rng.normal(size=8)).reshape(4, 2)
            places.append(TilePlace(Key(range_mm, "G", tile), at + error))
    return places


def test_tiles_that_the_distortion_does_not_bend_have_its_numbers_too() -> None:
    """A bent tile is larger by k1 times its half side squared, 2e-4 or 0.005 px here: as a print's error of size."""
    places = linear_tiles(0.002, np.random.default_rng(9))
    found = fit(places)
    assert (found.k2_per_mm4, found.bend) == (None, None)
    corner_mm = field.FRAME.radius_mm
    away_mm = corner_mm * (found.percent(corner_mm).value / 100 - 9e-4 * corner_mm**2)
    assert abs(away_mm) / 5.2e-3 < 0.004
    assert found.residual_px < 0.0007


def _of_the_middle(std_px: float) -> Floats:
    """Return a covariance (8, 8) of corners of which the middle alone is known."""
    y, x = CORNERS.T
    none = np.zeros(4)
    # the linear map, and convergence
    pairs = [(y, none), (x, none), (none, y), (none, x), (y * y, y * x), (x * y, x * x)]
    loose = np.stack([np.stack(pair, axis=1).ravel() for pair in pairs], axis=1)
    middle = np.kron(np.ones((4, 1)), np.eye(2))
    return np.asarray(std_px**2 * middle @ middle.T + 1e6 * loose @ loose.T)


def test_a_bent_print_is_found_and_a_flat_one_is_not() -> None:
    rng = np.random.default_rng(5)
    model = field.model()
    saddle = fit(
        field.observed(model, field.numbers(model, rng, bend=(1e-4, -1e-4, 0)), 0.02, rng)
    )
    assert saddle.bend is not None
    assert saddle.bend.p_value < 1e-6
    assert [each.code for each in geometry_findings(saddle)] == ["target-bent"]
    down, right, _ = saddle.bend.curvatures_per_mm
    # the saddle is well known, the dome is not: at these ranges it looks like distortion
    assert down - right == pytest.approx(2e-4, rel=0.1)
    assert saddle.k1_per_mm2.std > 10 * fitted(0.02, seed=5).k1_per_mm2.std
    flat = [fitted(0.02, seed) for seed in range(12)]
    assert all(found.bend is None for found in flat)
    assert kstest([found.bend_p_value for found in flat], "uniform").pvalue > 0.01


def test_a_tile_that_contradicts_the_others_is_named_and_left_out() -> None:
    rng = np.random.default_rng(6)
    model = field.model()
    numbers = field.numbers(model, rng)
    places = list(field.observed(model, numbers, 0.02, rng))
    places[7] = TilePlace(places[7].key, places[7].corners_px + 1.0)
    found = fit(places)
    assert found.outliers == (places[7].key,)
    assert [each.key for each in geometry_findings(found)] == [places[7].key]
    assert abs(found.k1_per_mm2.value - 9e-4) < 4 * found.k1_per_mm2.std


def test_one_tile_leaves_distortion_unknown_and_says_so() -> None:
    rng = np.random.default_rng(7)
    model = field.model(("G",), (1180.0,))
    places = field.observed(model, field.numbers(model, rng), 0.02, rng)
    found = fit(places[:1])
    assert "the distortion" in found.unknown
    assert found.centre_px is None
    (finding,) = geometry_findings(found)
    assert "do not determine the target's tilt, the distortion" in finding.text
    whole = fit(places)
    assert "the distortion" not in whole.unknown
    with pytest.raises(ValueError, match="no tile"):
        fit(())


def test_k2_is_taken_in_where_the_places_ask_for_it() -> None:
    rng = np.random.default_rng(8)
    model = field.model()
    numbers = field.numbers(model, rng)
    assert fit(field.observed(model, numbers, 0.01, rng)).k2_per_mm4 is None
    numbers[model.shared][list(FIFTH)] = 2e-4
    fifth = fit(field.observed(model, numbers, 0.01, rng)).k2_per_mm4
    assert fifth is not None
    assert fifth.std < 2e-5
    assert abs(fifth.value - 2e-4) < 4 * fifth.std


def test_pulls_are_unit_normal() -> None:
    """40 sessions of 33 numbers."""
    model = field.model()
    everything = chosen(model, fifth=False, bend=False)
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        numbers = field.numbers(model, rng)
        places = field.observed(model, numbers, 0.02, rng)
        found = fit_tiles(
            replace(model, places=places), everything, np.zeros(len(places), bool)
        )
        errors = np.sqrt(np.diag(found.covariance))[everything]
        pulls.append((found.numbers - numbers)[everything] / errors)
    lens = np.stack(pulls)[:, -9:].ravel()
    assert kstest(lens, "norm").pvalue > 0.05
    # the std of 40 × 33 correlated pulls has some 3 % of error
    assert np.std(pulls) == pytest.approx(1, abs=0.1)
