"""The focal surface through places, and the focus of a place by its photographs, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labkit.charts.focal_surface import (
    PlaceFocus,
    enlarged,
    focal_surface,
    law_misfit,
    place_focus,
    um_per_wave,
)
from labkit.charts.place_fit import PlaceFit
from labkit.edges.camera import camera_of
from labkit.optics.field import FieldFrame, FieldModel
from labkit.plan import Plan
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.chart_scenes import PLAN

OPTICS = camera_of(Plan.parse(PLAN, Path()), "M", None, 16383.0, None).optics
TRUTH = np.array([3.0, 2.4, -1.5, -0.006])
EXACT = Uncertain(8.0, 0.0)
PLACES = [np.array([y, x]) for y in (-8.0, 0.0, 8.0) for x in (-12.0, -6.0, 0.0, 6.0, 12.0)]


def fit(waves: Floats, law: Floats) -> PlaceFit:
    size = waves.size
    photographs = tuple(range(law.size))
    return PlaceFit(
        (0, 0), OPTICS, "M", (), (), photographs, law, waves, 1e-6 * np.eye(size)
    )


def focus(height_mm: Floats, um: float, std: float) -> PlaceFocus:
    return PlaceFocus(
        (0, 0), height_mm, np.full(3, um), std**2 * np.eye(3), sign_open=False
    )


def waves(defoci: Floats, noll5: float = 0.0, noll6: float = 0.0) -> Floats:
    modes = np.zeros(len(OPTICS.noll) - 1)
    modes[OPTICS.noll.index(5) - 1] = noll5
    modes[OPTICS.noll.index(6) - 1] = noll6
    return np.concatenate([defoci, modes])


def test_a_wave_of_defocus_moves_the_focus_as_in_the_model_of_the_field() -> None:
    model = FieldModel(
        FieldFrame((100, 100), 5.0),
        ("M",),
        (1,),
        (4,),
        np.zeros((1, 1, 1)),
        np.zeros((1, 1)),
        (550.0,),
        OPTICS.reference_nm,
        OPTICS.f_number,
    )
    assert um_per_wave(fit(waves(np.zeros(1)), np.zeros(1))) == pytest.approx(
        model.um_per_wave
    )


def test_two_ranges_give_the_sign_and_one_leaves_it_open() -> None:
    law = np.array([-0.2, 0.2])
    two = place_focus(fit(waves(law + 0.05), law), np.array([0.0, 5.0]))
    one = place_focus(fit(waves(np.array([0.05])), np.zeros(1)), np.array([0.0, 5.0]))
    for of, sign_open in ((two, False), (one, True)):
        assert of.sign_open == sign_open
        assert of.um[0] == pytest.approx(0.05 * um_per_wave(fit(waves(law), law)))
    assert str(one.of("medial")).startswith("±")


@pytest.mark.parametrize(
    ("height_mm", "noll5", "noll6"),
    [((0.0, 5.0), 0.0, 0.1), ((5.0, 0.0), 0.0, -0.1), ((5.0, 5.0), 0.1, 0.0)],
)
def test_t_is_the_focus_along_the_radius(
    height_mm: tuple[float, float], noll5: float, noll6: float
) -> None:
    """Along an azimuth, Noll 5 and 6 of 0.1 waves act as a defocus of 0.1 / sqrt(2)."""
    law = np.array([-0.2, 0.2])
    of = place_focus(fit(waves(law, noll5, noll6), law), np.array(height_mm))
    half = 0.1 / np.sqrt(2) * um_per_wave(fit(waves(law), law))
    assert of.um == pytest.approx([0.0, -half, half], abs=1e-6)
    assert of.t_minus_s.value == pytest.approx(2 * half)


def test_a_plane_with_curvature_is_recovered_and_pulls_are_unit_normals() -> None:
    rng = np.random.default_rng(4)
    off = []
    for _ in range(200):
        foci = []
        for place in PLACES:
            um = TRUTH[:3] @ [1, *place] + 1e3 * TRUTH[3] * place @ place
            foci.append(focus(place, um + rng.normal(0, 0.5), 0.5))
        surface = focal_surface(foci, "medial", EXACT)
        assert surface is not None
        off.append((surface.numbers - TRUTH) / np.sqrt(np.diag(surface.covariance)))
    # of 200 unit normals 1 ± 0.05; errors enlarged by chi2 above 1 make the pulls smaller
    assert np.std(off, axis=0) == pytest.approx(np.full(4, 0.93), abs=0.15)
    assert np.abs(np.mean(off, axis=0)).max() < 0.2


def test_the_f_numbers_error_is_one_of_the_scale() -> None:
    foci = [focus(place, float(2.4 * place[0]), 1e-3) for place in PLACES]
    surface = focal_surface(foci, "S", Uncertain(8.0, 0.16))
    assert surface is not None
    assert surface.number("tilt_rows_um_per_mm").std == pytest.approx(0.048, rel=0.01)


def test_places_on_a_line_or_too_few_determine_no_surface() -> None:
    line = [focus(np.array([0.0, x]), 0.0, 1.0) for x in np.linspace(-12, 12, 9)]
    assert focal_surface(line, "medial", EXACT) is None
    assert focal_surface(line[:4], "medial", EXACT) is None


def test_defoci_that_contradict_the_ranges_enlarge_errors() -> None:
    law = np.array([-0.2, 0.0, 0.2])
    wrong = place_focus(
        fit(waves(law + np.array([0.0, 0.02, 0.0])), law), np.array([0.0, 5.0])
    )
    factor, p = law_misfit([wrong])
    assert p < 1e-6
    # 0.02 off the line through three points leaves 0.02 * sqrt(2/3), of two degrees of freedom
    assert factor == pytest.approx(0.02 * np.sqrt(2 / 3) / 1e-3 / np.sqrt(2), rel=0.01)
    (larger,) = enlarged([wrong])
    assert larger.of("S").std == pytest.approx(factor * wrong.of("S").std)
