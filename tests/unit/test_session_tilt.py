"""The slope of focus at each range of a session, by tiles whose slopes were made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from labkit.field.geometry import FieldGeometry, fit_geometry
from labkit.field.session_tilt import focus_slopes, session_tilt
from labkit.field.target_tilt import target_tilts
from labkit.field.tile_places import tile_places
from labkit.optics.field import FieldModel
from labkit.results import Placement, Wavefront
from labkit.types import Floats
from tests import tile_samples as field
from tests.field_samples import a_field
from tests.results_samples import a_wavefront

STD_WAVES = 0.002
SLOPES = np.array([[2.4, -1.5], [1.0, 0.5], [-0.7, 2.0]])


def a_bowl() -> FieldModel:
    """Return a field with curvature, coma and some slope."""
    waves = np.zeros((1, 6, 12))
    waves[0, 1:4, 0] = 0.01, 0.02, -0.05
    waves[0, 0, 3] = 0.03
    return a_field(waves)


def tiles(slopes: Floats, rng: np.random.Generator) -> list[Wavefront]:
    """Return fits of all tiles at three ranges, each with a focus and a slope of its own; the target is tilted differently."""
    model = a_bowl()
    places = field.model(("G",))
    numbers = field.numbers(places, rng)
    fits = []
    for place in field.observed(places, numbers, 0.001, rng):
        station = field.RANGES_MM.index(place.key.range_mm or 0.0)
        placement = Placement((0, 0), (512, 768), place.corners_px[None])
        height = field.FRAME.heights_mm(placement.centre_px)
        waves, _ = model.modes("G", placement.centre_px)
        bowl = model.waves[0, 1:3, 0] * 2 / field.FRAME.radius_mm
        slope = slopes[station] / model.um_per_wave - bowl[::-1]
        waves[0] += 0.3 * (station - 1) + slope @ height + STD_WAVES * rng.normal()
        fits.append(
            a_wavefront(
                place.key.range_mm,
                "G",
                noll=model.noll,
                waves=waves,
                covariance=STD_WAVES**2 * np.eye(12),
                tile=place.tile,
                placement=placement,
                residuals=None,
            )
        )
    return fits


def test_each_range_has_its_slope() -> None:
    """Pulls over 60 sessions of three ranges."""
    pulls = []
    for seed in range(60):
        found = focus_slopes(tiles(SLOPES, np.random.default_rng(seed)), a_bowl())
        assert found.ranges_mm == field.RANGES_MM
        errors = np.sqrt(np.diag(found.covariance)).reshape(-1, 2)
        pulls.append((found.um_per_mm - SLOPES) / errors)
    # errors grow where six tiles scatter more than their fits say, which is by chance here
    assert np.std(pulls) == pytest.approx(0.9, abs=0.1)
    assert kstest(np.ravel(pulls) / np.std(pulls), "norm").pvalue > 0.05


def test_the_error_of_the_cone_is_common_to_all_ranges() -> None:
    """A focus in µm is that of the wavefront times the f-number squared: 1 % of 4 is 2 % of every slope."""
    fits = tiles(SLOPES, np.random.default_rng(2))
    sure = focus_slopes(fits, a_bowl())
    unsure = focus_slopes(fits, replace(a_bowl(), f_number_std=0.04))
    moved = 0.02 * sure.um_per_mm.ravel()
    assert unsure.um_per_mm == pytest.approx(sure.um_per_mm)
    assert unsure.covariance - sure.covariance == pytest.approx(np.outer(moved, moved))


def test_errors_contain_those_of_the_surface_s_shape() -> None:
    """A cubic term of the focal surface looks like a slope: all ranges have its error in common."""
    fits = tiles(SLOPES, np.random.default_rng(3))
    bowl = a_bowl()
    known = a_field(np.zeros((1, 10, 12)), std=0.0, order=3)
    known.waves[:, :6] = bowl.waves
    at, std = known.index("G", 7, 4), 0.004
    covariance = np.zeros((120, 120))
    covariance[at, at] = std**2
    other = known.waves.copy()
    other.ravel()[at] += std
    sure = focus_slopes(fits, known)
    unsure = focus_slopes(fits, replace(known, covariance=covariance))
    moved = (
        focus_slopes(fits, replace(known, waves=other)).um_per_mm - sure.um_per_mm
    ).ravel()
    assert np.linalg.norm(moved) > 0.1
    assert unsure.covariance - sure.covariance == pytest.approx(np.outer(moved, moved))


def test_fewer_than_three_tiles_in_a_plane_have_no_slope() -> None:
    fits = tiles(SLOPES, np.random.default_rng(1))
    row = [fit for fit in fits if fit.tile is not None and fit.tile[0] == 0]
    assert focus_slopes(row, a_bowl()).ranges_mm == ()


def _geometry(fits: list[Wavefront]) -> FieldGeometry:
    return fit_geometry(field.FRAME, field.GRID, tile_places(fits), field.LENS)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_a_session_tells_the_sensor_s_tilt_from_the_target_s(share: float) -> None:
    """The target is tilted by 3° or so, which is 1.5 µm/mm of focus."""
    rng = np.random.default_rng(4)
    geometry = _geometry(tiles(SLOPES, np.random.default_rng(4)))
    tilts = target_tilts(geometry, field.LENS).focus_um_per_mm
    assert np.abs(tilts).max() > 1
    fits = tiles(np.array([2.4, -1.5]) + share * tilts, rng)
    found = session_tilt(fits, a_bowl(), _geometry(fits), field.LENS)
    assert found is not None
    errors = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.value - [2.4, -1.5]) < 3 * errors)
    assert np.all(errors < 0.3)
    assert found.perspective_contradicted == (share == 0)
    without = "perspective" if share == 0 else "the target's tilt"
    assert found.words.startswith(f"sensor tilt without {without}, by the tiles: 2.")
    stated = found.as_json()
    assert stated["share_of_perspective"]["value"] == pytest.approx(share, abs=0.3)
