"""The pupil's rim over the frame, against circles that are drawn by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import Circle

from labkit.analysis.measured_camera import optics_behind
from labkit.estimation.stated import optics_of
from labkit.imaging.parts import UnevenField, Vignetted
from labkit.imaging.parts.field_rim import CLEAR_SIZE, MOST_ALONG
from labkit.imaging.parts.rim import MOST_SHIFT
from labkit.optics.field import FieldFrame
from labkit.optics.rim import ROUND, Diaphragm, FieldRim, Place, Rim, Vignetting
from labkit.plan import Plan
from labkit.report.field.shapes import pupils_chart
from labkit.results.model import Placement
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.field_samples import a_field
from tests.plans import PORTRAIT
from tests.results_samples import PLAN, a_wavefront, some_results
from tests.unit.test_cone import OPTICS

CORNER: Place = (-0.6, 0.8)
MIDDLE: Place = (0.0, 0.0)
SQUARE = np.array([[0.0, 0], [0, 12], [12, 12], [12, 0]])
ELEMENT = Vignetting(0.5, 0.02, -0.03, 1.1)


def radii(rim: Rim, angles: Floats) -> Floats:
    """The outline by bisection of what is inside."""
    low, high = np.zeros_like(angles), np.full_like(angles, 3.0)
    for _ in range(40):
        middle = (low + high) / 2
        clear = rim.inside(middle * np.cos(angles), middle * np.sin(angles))
        low, high = np.where(clear, middle, low), np.where(clear, high, middle)
    return low


@pytest.mark.parametrize("place", [CORNER, (0.3, -0.2), MIDDLE])
def test_the_pupil_is_what_two_circles_share(place: Place) -> None:
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    away = radii(ELEMENT.onto(ROUND, place), angles)
    x, y = away * np.cos(angles), away * np.sin(angles)
    right, down = 0.02 + 0.5 * place[1], -0.03 + 0.5 * place[0]
    outside = np.maximum(np.hypot(x, y) - 1, np.hypot(x - right, y - down) - 1.1)
    np.testing.assert_allclose(outside, 0, atol=1e-9)


def test_an_element_that_lies_outside_the_pupil_cuts_nothing() -> None:
    blades = Rim((Diaphragm(7),))
    assert ELEMENT.onto(blades, MIDDLE) is blades
    assert ELEMENT.onto(blades, CORNER).area < 0.95


def test_the_rim_over_the_frame_has_what_all_places_share() -> None:
    blades = Rim((Diaphragm(7),))
    over = FieldRim(blades, ELEMENT, (0.1, 0.0))
    assert over.at(MIDDLE).cuts == blades.cuts
    # cos 2t about the image height, whose direction is that of 0.8 right and 0.6 up
    y, x = CORNER
    expected = 0.1 * (x * x - y * y), 0.1 * 2 * x * y, 0.0, 0.0
    assert over.at(CORNER).uneven == pytest.approx(expected)
    assert over.at(CORNER).cuts[0] == blades.cuts[0]


def test_a_wavefront_of_the_field_has_the_rim_of_its_place() -> None:
    model = replace(a_field(), rim=FieldRim(vignetting=ELEMENT))
    rows, columns = model.frame.shape_px
    corner = model.wavefront("G", (0, columns - 1)).rim
    y, x = model.frame.relative((0, columns - 1))
    assert corner == ELEMENT.onto(ROUND, (float(y), float(x)))
    assert model.wavefront("G", ((rows - 1) / 2, (columns - 1) / 2)).rim.is_round


def test_only_tiles_are_tested_for_a_rim_over_the_frame() -> None:
    assert "uneven_field" not in OPTICS.lacking
    assert "uneven_field" in replace(OPTICS, place=CORNER).lacking
    tile = replace(OPTICS, place=CORNER).with_parts({"uneven_field"})
    assert tile.parts == (UnevenField(place=CORNER),)
    # a lens has one of them
    assert "uneven_rim" not in tile.lacking


def test_a_plan_may_state_the_circle() -> None:
    plan = Plan.from_tables({**PORTRAIT, "field": {"cats_eye": [0.5, 1.1]}})
    (given,) = optics_of(plan, "G", CORNER).given
    assert given == Vignetted(0.5, growth=1.1 - CLEAR_SIZE, place=CORNER)
    assert optics_of(plan, "G", CORNER).rim.area < 0.9
    # a frame without tiles is a place in the middle
    assert optics_of(plan, "G").rim.is_round


def test_a_cut_begins_with_circles_on_both_sides_that_an_uneven_field_is_like() -> None:
    """The harmonics of a pupil that a circle cuts, seen from a corner, lead back to the circle; steps are 0.1 and 0.1."""
    true = Vignetted(0.4, growth=1.1 - CLEAR_SIZE, place=CORNER)
    angles = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    rim = true.onto(ROUND)
    about = np.array(rim.centre)
    away = radii(rim, angles)
    x, y = away * np.cos(angles) - about[0], away * np.sin(angles) - about[1]
    outline = np.interp(angles, np.arctan2(y, x), np.hypot(x, y), period=2 * np.pi)
    turn = angles - np.arctan2(*CORNER)
    second, third = (float(2 * np.cos(k * turn) @ outline / outline.sum()) for k in (2, 3))
    uneven = UnevenField(second, third, CORNER)
    *_, first, other = Vignetted(place=CORNER).starts([uneven])
    assert first.along == pytest.approx(0.4, abs=0.1)
    assert first.growth == pytest.approx(true.growth, abs=0.1)
    assert other.along < 0
    # a tile in the middle shows nothing of it
    assert Vignetted(place=MIDDLE).starts([replace(uneven, place=MIDDLE)]) == (
        Vignetted(place=MIDDLE),
    )


def test_tiles_begin_with_the_circle_of_another_tile() -> None:
    found = Vignetted(0.5, 0.01, 0.02, -0.4, CORNER)
    (begun,) = Vignetted(place=(0.1, 0.2)).starts([found])
    assert begun == replace(found, place=(0.1, 0.2))


def test_numbers_stay_where_the_circle_holds_the_pupils_middle() -> None:
    wild = Vignetted(place=CORNER).at((9.0, 3.0, 0.0, -5.0))
    assert wild.at_bound
    assert wild.along <= MOST_ALONG
    circle = wild.vignetting.circle(CORNER)
    assert circle.shift <= MOST_SHIFT * circle.size * (1 + 1e-12)
    assert not Vignetted(0.5, growth=-0.4, place=CORNER).at_bound


def test_a_camera_measured_by_tiles_has_the_rim_of_the_tiles_place() -> None:
    part = Vignetted(0.5, growth=1.1 - CLEAR_SIZE)
    found = part.quantities([Uncertain(value, 0.01) for value in part.values])
    corner, middle = (
        a_wavefront(
            tile=(0, k),
            placement=Placement((at, at), (24, 24), (at + 6 + SQUARE)[np.newaxis]),
        )
        for k, at in enumerate((0, 244))
    )
    frame = FieldFrame((512, 512), PLAN.sensor.pixel_pitch_um)
    results = some_results(
        wavefronts=(corner, middle), field=a_field(frame=frame), model_parts=found
    )
    assert optics_behind(results, PLAN, corner).rim.area < 0.85
    assert optics_behind(results, PLAN, middle).rim.is_round


def test_pupils_are_drawn_cut_in_the_corners_and_whole_in_the_middle() -> None:
    model = replace(a_field(), rim=FieldRim(vignetting=ELEMENT))
    (axes,) = pupils_chart(model).axes
    widths = []
    for clear, full in zip(axes.patches[::2], axes.patches[1::2], strict=True):
        assert isinstance(full, Circle)
        outline = np.asarray(clear.get_path().vertices)
        widths.append(float(np.ptp(outline[:, 0])) / (2 * full.get_radius()))
    assert len(widths) > 20
    assert widths[0] < 0.95
    assert widths[len(widths) // 2] == pytest.approx(1, abs=1e-3)
