"""The target's tilt by perspective, by ray tracing through a pinhole, and the sensor's tilt without it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from labkit.field.findings import tilt_findings
from labkit.field.geometry import fit_geometry
from labkit.field.target_tilt import TargetTilts, sensor_tilt, target_tilts
from labkit.field.tile_places import CORNERS, TilePlace
from labkit.key import Key
from tests import tile_samples as field


def traced(range_mm: float, down_rad: float, right_rad: float) -> list[TilePlace]:
    """Return the places of tiles on a plane, lower and right sides tilted away, through a pinhole on the frame's axis."""
    image_mm = field.LENS.pupil_to_image_mm(range_mm)
    places = []
    for row, column in field.TILES:
        on_target = field.GRID.places_mm((row, column), CORNERS)
        depth = range_mm + on_target @ np.tan([down_rad, right_rad])
        corners = field.FRAME.places_px(image_mm * on_target / depth[:, None])
        places.append(TilePlace(Key(range_mm, "G", (row, column)), corners))
    return places


def test_a_leaning_target_is_measured_by_its_perspective() -> None:
    places = [*traced(1180.0, 0.02, -0.01), *traced(1260.0, 0.0, 0.03)]
    tilts = target_tilts(
        fit_geometry(field.FRAME, field.GRID, places, field.LENS), field.LENS
    )
    expected = np.degrees([[0.02, -0.01], [0.0, 0.03]])
    found = [[angle.value for angle in both] for both in tilts.angles_deg]
    assert np.array(found) == pytest.approx(expected, abs=1e-6)


def test_the_target_s_share_of_focus_is_that_of_imaging_its_points() -> None:
    """Points of the target 10 mm apart on the sensor, each to its own image."""
    tilts = target_tilts(
        fit_geometry(field.FRAME, field.GRID, traced(1180.0, 0.0, 0.02), field.LENS),
        field.LENS,
    )
    image_mm = field.LENS.image_distance_mm(1180.0)
    heights = np.array([-1e-3, 1e-3])
    # the ray x = -h / image z meets the plane z = r + tan(tilt) x, in the picture's orientation
    slope = np.tan(0.02)
    depth = 1180.0 / (1 - slope * heights / image_mm)
    nearer_um = -1e3 * np.diff(field.LENS.image_distance_mm(depth))[0]
    focus = tilts.focus_um_per_mm[0]
    assert focus == pytest.approx([0, nearer_um / np.ptp(heights)], rel=1e-4, abs=1e-6)


def some_tilts(std: float) -> TargetTilts:
    depth = np.array([[2e-3, -1e-3], [-1e-3, -2e-3], [0.0, 1e-3]])
    ranges = field.RANGES_MM
    um = 1e3 * (35 / (np.array(ranges) - 35)) ** 2 * np.array(ranges)
    return TargetTilts(ranges, depth, std**2 * np.eye(6), np.full(3, 36.0), um)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_ranges_tell_a_leaning_target_from_a_leaning_sensor(share: float) -> None:
    """Pulls over 300 sessions, the focal length 2 % off; where focus does not follow the perspective, the tilt is right."""
    rng = np.random.default_rng(1)
    errors = 0.05
    tilt = np.array([2.4, -1.5])
    pulls, contradicted = [], 0
    for _ in range(300):
        tilts = some_tilts(1e-5)
        depth = tilts.depth_per_mm + 1e-5 * rng.normal(size=(3, 2))
        slopes = tilt + share * tilts.focus_um_per_mm + errors * rng.normal(size=(3, 2))
        um = tilts.um * (1 + 0.04 * rng.normal())
        seen = replace(tilts, depth_per_mm=depth, um=um, um_relative_std=0.04)
        found = sensor_tilt(slopes, errors**2 * np.eye(6), seen)
        pulls.append((found.value - tilt) / np.sqrt(np.diag(found.covariance)))
        contradicted += found.perspective_contradicted
        assert not found.unknown
        codes = [finding.code for finding in tilt_findings(found)]
        assert codes == ["perspective-contradicted"] * found.perspective_contradicted
    assert kstest(np.ravel(pulls), "norm").pvalue > 0.05
    # one in a hundred by chance: 3 of 300, and 4 standard deviations
    assert contradicted == 300 if share == 0 else contradicted <= 10


def test_what_one_range_or_one_tilt_leaves_unknown_is_said() -> None:
    tilts = some_tilts(1e-5)
    one = TargetTilts(
        (1180.0,), np.array([[2e-3, 0]]), 1e-10 * np.eye(2), np.ones(1), tilts.um[:1]
    )
    found = sensor_tilt(np.array([[3.0, 1.0]]), 1e-4 * np.eye(2), one)
    assert found.value == pytest.approx([3 - one.focus_um_per_mm[0, 0], 1])
    assert "a second range" in found.unknown[0]
    assert [finding.code for finding in tilt_findings(found)] == ["tilt-untested"]
    alike = TargetTilts(
        tilts.ranges_mm, np.full((3, 2), 1e-3), tilts.covariance, np.ones(3), tilts.um
    )
    slopes = 1 + alike.focus_um_per_mm
    assert "tilted alike" in sensor_tilt(slopes, 0.05**2 * np.eye(6), alike).unknown[0]
    unknown = TargetTilts(
        (None,), np.zeros((1, 2)), np.eye(2), np.ones(1), np.array([np.nan])
    )
    with pytest.raises(ValueError, match="needs the ranges"):
        sensor_tilt(np.zeros((1, 2)), np.eye(2), unknown)


def test_pulls_of_the_target_s_tilt_are_unit_normal() -> None:
    model = field.model(("G",))
    pulls = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        numbers = field.numbers(model, rng)
        found = fit_geometry(
            field.FRAME, field.GRID, field.observed(model, numbers, 0.02, rng), field.LENS
        )
        tilts = target_tilts(found, field.LENS)
        back = [np.linalg.inv(model.matrix(numbers, k))[2] for k in range(3)]
        true = np.array([-row[:2] / row[2] for row in back])
        errors = np.sqrt(np.diag(tilts.covariance)).reshape(-1, 2)
        pulls.append((tilts.depth_per_mm - true) / errors)
    assert kstest(np.ravel(pulls), "norm").pvalue > 0.05
