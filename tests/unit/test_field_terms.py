"""Tilt, curvature, astigmatism and coma of a field, by Seidel's closed forms and an independent simulator's truth."""

import json
from dataclasses import replace

import numpy as np
import pytest

from labkit.field.surfaces import best_plane, focus_um
from labkit.field.symmetry import BY_SYMMETRY, Part, part_matrix, share
from labkit.field.terms import lens_terms
from labkit.optics.field import FieldModel, field_terms
from labkit.optics.zernike import zernike
from labkit.types import Floats
from tests.field_samples import (
    FRAME,
    GOLDEN_FIELD,
    NOLL,
    a_field,
    drawn,
    golden_field,
    of_path,
)

COMA, ASTIGMATISM, CURVATURE = 0.11, 0.05, -0.04
"""Seidel's coefficients: waves at the pupil's rim, for each mm or mm² of image height."""

COMA_AT = np.array([-0.3, 0.5])
SURFACE_AT = np.array([0.2, -0.15])
"""Where the lens's coma and its surfaces are centred, down and right, mm."""


def decentred(x: Floats, y: Floats, p: Floats, q: Floats) -> Floats:
    square = p**2 + q**2
    coma = COMA * ((x - COMA_AT[1]) * p + (y - COMA_AT[0]) * q) * square
    away = x - SURFACE_AT[1], y - SURFACE_AT[0]
    astigmatism = ASTIGMATISM * (away[0] * p + away[1] * q) ** 2
    curvature = CURVATURE * (away[0] ** 2 + away[1] ** 2) * square
    return np.asarray(coma + astigmatism + curvature)


def test_a_decentred_lens_by_its_seidel_sums_is_recovered() -> None:
    model = of_path(decentred)
    terms = lens_terms(model, "G")
    mm_per_wave = 1e-3 * model.um_per_wave / (2 * np.sqrt(3))  # of x², on the pupil's rim
    assert terms.sagittal_curvature.value == pytest.approx(mm_per_wave * CURVATURE)
    assert terms.tangential_curvature.value == pytest.approx(
        mm_per_wave * (CURVATURE + ASTIGMATISM)
    )
    medial = mm_per_wave * (CURVATURE + ASTIGMATISM / 2)
    assert terms.curvature.value == pytest.approx(medial)
    assert terms.curvature_radius_mm.value == pytest.approx(1 / (2 * medial))
    assert terms.astigmatism.value == pytest.approx(mm_per_wave * ASTIGMATISM)
    assert terms.tilt.slope.value == pytest.approx(-2e3 * medial * SURFACE_AT)
    assert terms.level_at.value == pytest.approx(SURFACE_AT)
    # ρ³ cos θ is Z8 / (3 √8) and a tilt
    assert terms.linear_coma.value == pytest.approx(COMA / (3 * np.sqrt(8)))
    assert terms.coma.value == pytest.approx(-COMA * COMA_AT / (3 * np.sqrt(8)))
    assert terms.coma_free_at.value == pytest.approx(COMA_AT)


def test_linear_and_constant_astigmatism_are_those_of_a_shifted_square() -> None:
    terms = lens_terms(of_path(decentred), "G")
    shift = complex(SURFACE_AT[1], SURFACE_AT[0])
    per_square = ASTIGMATISM / (2 * np.sqrt(6))  # of ρ² cos 2θ: (H - shift)²
    linear = -2 * shift * per_square
    constant = shift**2 * per_square
    assert terms.linear_astigmatism.value == pytest.approx([linear.imag, linear.real])
    assert terms.constant_astigmatism.value == pytest.approx([constant.imag, constant.real])


@pytest.mark.skipif(not GOLDEN_FIELD.exists(), reason="needs ../shared")
def test_the_independent_simulators_numbers_are_recovered() -> None:
    truth = json.loads(GOLDEN_FIELD.read_text())
    terms = lens_terms(golden_field(), "G")
    assert terms.tilt.slope.value == pytest.approx(truth["tilt_um_per_mm"], rel=1e-9)
    assert terms.curvature.value == pytest.approx(truth["curvature_per_mm"], rel=1e-9)
    # its generator's, as the tiles' modes show them
    assert terms.coma.value == pytest.approx([0.03, -0.02])
    assert terms.linear_coma.value == pytest.approx(0.022)
    assert terms.linear_astigmatism.value == pytest.approx([0.006, -0.01])
    assert terms.spherical.value == pytest.approx(0.04)


def test_a_tilt_of_a_minute_of_arc_is_a_slope_of_one_in_3438() -> None:
    slope = 1e3 * np.tan(np.deg2rad(1 / 60))  # um/mm, down
    model = a_field(f_number_std=0.01)
    model.waves[0, 2, 0] = slope / model.um_per_wave * FRAME.radius_mm / 2
    tilt = lens_terms(model, "G").tilt
    height_mm, width_mm = 512 * 5.2e-3, 768 * 5.2e-3
    assert tilt.angle.down.value == pytest.approx(1, rel=1e-6)
    assert tilt.angle.right.value == pytest.approx(0)
    assert tilt.direction_deg.value == pytest.approx(90)
    assert tilt.over_frame.value == pytest.approx(slope * height_mm)
    across = {name: number.value for name, number in tilt.across.items()}
    assert across["left to right"] == pytest.approx(0)
    assert across["bottom left to top right"] == pytest.approx(-slope * height_mm)
    # 1e-3 waves of c, which is 2 / R; the cone's 0.25 % twice, of the slope itself
    own = 2e-3 / FRAME.radius_mm * model.um_per_wave
    assert tilt.slope.down.std == pytest.approx(np.hypot(own, 0.005 * slope))
    assert tilt.across["left to right"].std == pytest.approx(own * width_mm)


def turned(model: FieldModel, angle: float) -> Floats:
    """Path differences at places and points of the pupil that were all turned by an angle."""
    height = np.linspace(0.2, 2.0, 5)
    first = np.array([0.3, 1.1, -2.0, 0.7, 2.9]) + angle
    places = FRAME.places_px(height[:, None] * np.stack([np.sin(first), np.cos(first)], 1))
    modes = np.array([zernike(j, np.array(0.8), np.array(0.4 + angle)) for j in model.noll])
    return np.asarray(model.modes("G", places)[0] @ modes)


def random_field(order: int) -> FieldModel:
    shape = (1, len(field_terms(order)), len(NOLL))
    return a_field(np.random.default_rng(3).normal(size=shape), order=order)


def part_of(model: FieldModel, part: Part) -> FieldModel:
    """A field of one channel with one part of its coefficients alone."""
    waves = part_matrix(model.field, model.noll, part) @ model.waves.ravel()
    return replace(model, waves=waves.reshape(model.waves.shape))


@pytest.mark.parametrize("order", [2, 4])
def test_a_lens_with_an_axis_looks_the_same_when_turned(order: int) -> None:
    symmetric = part_of(random_field(order), "symmetric")
    assert turned(symmetric, 1.0) == pytest.approx(turned(symmetric, 0.0))
    assert np.abs(turned(symmetric, 0.0)).max() > 0.1


@pytest.mark.parametrize("order", [2, 4])
def test_misalignment_turns_as_a_vector(order: int) -> None:
    misaligned = part_of(random_field(order), "misaligned")
    start, quarter = turned(misaligned, 0.0), turned(misaligned, np.pi / 2)
    angle = 0.7
    expected = np.cos(angle) * start + np.sin(angle) * quarter
    assert turned(misaligned, angle) == pytest.approx(expected)


def test_the_parts_are_orthogonal_and_add_up() -> None:
    matrices = [part_matrix(field_terms(3), NOLL, part) for part in BY_SYMMETRY]
    assert sum(matrices) == pytest.approx(np.eye(len(NOLL) * 10))
    for matrix in matrices:
        assert matrix @ matrix == pytest.approx(matrix, abs=1e-12)


def test_pure_noise_is_called_misaligned_as_often_as_its_p_value_says() -> None:
    rng = np.random.default_rng(5)
    model = a_field()
    found = [
        share(replace(model, waves=drawn(model, rng).waves), "G", "misaligned").p_value
        for _ in range(400)
    ]
    # the mean of 400 uniform numbers has a standard error of 0.0144, a share of 5 % one of 0.011
    assert np.mean(found) == pytest.approx(0.5, abs=0.05)
    assert np.mean(np.array(found) < 0.05) == pytest.approx(0.05, abs=0.04)


def test_a_bent_surface_leaves_its_sagitta_and_a_plane_leaves_nothing() -> None:
    flat = a_field()
    flat.waves[0, :3, 0] = 0.1, -0.2, 0.3
    plane = best_plane(flat, "G")
    assert plane.rms.value == pytest.approx(0, abs=1e-9)
    bent = a_field()
    bent.waves[0, 3, 0] = 0.05
    left = best_plane(bent, "G")
    corner_um = lens_terms(bent, "G")
    sagitta_um = corner_um.at_corner_um(corner_um.curvature).value
    assert left.peak_to_valley.value == pytest.approx(sagitta_um)
    assert left.tilt.value == pytest.approx([0, 0], abs=1e-9)
    # x² + y² over a rectangle 2a by 2b has a variance of 4 (a⁴ + b⁴) / 45
    a, b = 512 / 2, 768 / 2
    rms = sagitta_um * np.sqrt(4 * (a**4 + b**4) / 45) / (a**2 + b**2)
    assert left.rms.value == pytest.approx(rms)


def test_errors_of_the_best_plane_are_those_of_drawn_fields() -> None:
    model = golden_field() if GOLDEN_FIELD.exists() else of_path(decentred)
    rng = np.random.default_rng(8)
    planes = [best_plane(drawn(model, rng), "G") for _ in range(800)]
    stated = best_plane(model, "G")
    # the standard deviation of 800 draws has an error of 2.5 %
    for name in ("rms", "peak_to_valley"):
        values = [getattr(plane, name).value for plane in planes]
        assert np.std(values) == pytest.approx(getattr(stated, name).std, rel=0.1)


def test_modes_that_were_not_fitted_are_not_determined() -> None:
    model = FieldModel(
        FRAME, ("G",), (1,), (4, 5, 6), np.zeros((1, 1, 3)), np.eye(3), (540.0,), 450.0, 4.0
    )
    terms = lens_terms(model, "G")
    assert str(terms.curvature) == "not determined mm/mm²"
    assert str(terms.tilt.slope.magnitude) == "not determined um/mm"
    with pytest.raises(ValueError, match="no channel R: it has G"):
        lens_terms(model, "R")


def test_a_plane_says_nothing_of_what_a_plane_leaves() -> None:
    for order in (0, 1):
        assert str(best_plane(a_field(order=order), "G").rms) == "not determined um"


def test_sagittal_and_tangential_focus_change_places_a_quarter_turn_on() -> None:
    model = a_field()
    model.waves[0, 0, 2] = 0.1  # Noll 6: cosine of twice the angle, everywhere
    right, down = FRAME.places_px([[0.0, 1.0], [1.0, 0.0]])
    apart_um = 0.1 / np.sqrt(2) * model.um_per_wave
    assert focus_um(model, "G", right, "tangential")[0] == pytest.approx(apart_um)
    assert focus_um(model, "G", down, "sagittal")[0] == pytest.approx(apart_um)
