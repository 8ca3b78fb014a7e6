"""The wavefront over the field, by closed forms and by the truth of an independent simulator."""

import json
from pathlib import Path

import numpy as np
import pytest

from labkit.optics.field import FieldFrame, FieldModel, field_terms
from labkit.results.field_entry import FieldEntry
from labkit.types import Floats

GOLDEN = Path(__file__).parents[3] / "shared" / "golden" / "truth-field-open.json"
FRAME = FieldFrame((512, 768), 5.2)
NOLL = tuple(range(4, 16))


def a_model(waves: Floats, std: float = 0.01) -> FieldModel:
    return FieldModel(
        FRAME,
        ("G",),
        field_terms(2),
        NOLL,
        waves,
        std**2 * np.eye(waves.size),
        (540.0,),
        450.0,
        4.0,
    )


def test_the_corners_of_the_frame_are_at_radius_one() -> None:
    corner = FRAME.heights_mm([-0.5, -0.5]) / FRAME.radius_mm
    assert np.hypot(*corner) == pytest.approx(1, abs=1e-12)
    assert FRAME.polynomials((1, 2, 3), FRAME.centre_px) == pytest.approx([1, 0, 0])
    right, down = FRAME.centre_px + np.array([[0, 100], [100, 0]])
    # Noll 2 is the cosine: along x; Noll 3 the sine: along y
    at = FRAME.polynomials((2, 3), [right, down])
    assert np.diag(at).min() > 0
    assert at - np.diag(np.diag(at)) == pytest.approx(np.zeros((2, 2)), abs=1e-12)
    assert FRAME.places_px(FRAME.heights_mm(down)) == pytest.approx(down)


def test_a_place_has_the_sum_of_all_terms_and_their_errors() -> None:
    waves = np.zeros((1, 6, 12))
    waves[0, 0, 3] = 0.03  # constant coma
    waves[0, 1, 0] = 0.1  # a tilt of focus along x
    model = a_model(waves)
    place = FRAME.places_px([0.0, 0.5 * FRAME.radius_mm])
    found, covariance = model.modes("G", place)
    # Noll 2 is 2ρ cos θ
    assert found[[0, 3]] == pytest.approx([0.1, 0.03])
    at = FRAME.polynomials(model.field, place)
    assert covariance[0, 0] == pytest.approx(1e-4 * at @ at)
    assert model.wavefront("G", place, model.um_per_wave).waves[0] == pytest.approx(1.1)


def test_a_tenth_of_a_wave_is_eight_f_numbers_squared_of_focus() -> None:
    peak_to_valley_um = 0.1 * 2 * np.sqrt(3) * 0.45
    assert 0.1 * a_model(np.zeros((1, 6, 12))).um_per_wave == pytest.approx(
        8 * 4.0**2 * peak_to_valley_um
    )


@pytest.mark.skipif(not GOLDEN.exists(), reason="needs ../shared")
def test_the_independent_simulators_lens_is_an_expansion_of_order_two() -> None:
    truth = json.loads(GOLDEN.read_text())
    tiles = [tile for tile in truth["tiles"] if tile["channel"] == "G"]
    at = FRAME.polynomials(field_terms(2), [tile["centre_px"] for tile in tiles]).T
    for j in map(str, NOLL[1:]):
        modes = np.array([tile["modes"][j] for tile in tiles])
        terms = np.linalg.lstsq(at, modes, rcond=None)[0]
        assert at @ terms == pytest.approx(modes, abs=1e-12)


@pytest.mark.parametrize(("order", "tilted", "curved"), [(0, 0, 0), (1, 1, 0), (2, 1, 1)])
def test_a_field_of_few_tiles_has_null_where_they_determine_nothing(
    order: int, tilted: bool, curved: bool
) -> None:
    terms = field_terms(order)
    model = FieldModel(
        FieldFrame((232, 232), 4.78),
        ("G",),
        terms,
        (4, 5),
        np.zeros((1, len(terms), 2)),
        np.eye(2 * len(terms)),
        (550.0,),
        450.0,
        2.8,
    )
    entry = FieldEntry.of_model(model)
    assert (entry.sensor_tilt_um_per_mm is not None) == tilted
    assert (entry.curvature_per_mm is not None) == curved
