"""What the figures of the field draw, against closed forms."""

import numpy as np
import pytest
from matplotlib.text import Annotation

from labkit.field.curves import profiles
from labkit.field.flats import illumination
from labkit.field.places import line_end_mm
from labkit.field.surfaces import ASTIGMATISM, focus_um
from labkit.field.terms import lens_terms
from labkit.figure_style import channel_inks, round_length, styled
from labkit.optics.mtf import mtf
from labkit.photographs.photograph import Photograph
from labkit.report.field.maps import covering, even_levels, map_chart
from labkit.report.field.profiles import height_chart, inner_points, lines_of
from labkit.report.field.sampled import Grid, after_plane_um, mtf_over
from labkit.report.field.shapes import (
    COMA,
    Shapes,
    along_lines,
    coma_chart,
    ellipses,
    stamps_of,
)
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.tiled_samples import CURVATURE, FRAME, TILT, a_model

INKS = channel_inks(["R", "B"])


def test_a_grid_ends_at_the_edges_of_the_frame_and_middles_halve_their_fields() -> None:
    grid = Grid.edge_to_edge(FRAME, 6)
    assert grid.heights_mm.shape == (5, 7, 2)
    assert grid.places_px[0, 0] == pytest.approx([-0.5, -0.5])
    assert grid.places_px[-1, -1] == pytest.approx([3999.5, 5999.5])
    middles = Grid.middles(FRAME, 6)
    assert middles.each_px[0] == pytest.approx([499.5, 499.5])
    assert middles.step_mm == pytest.approx(4.78)


def test_between_its_places_a_map_is_smooth() -> None:
    grid = Grid.edge_to_edge(FRAME, 14)
    y, x = np.moveaxis(grid.heights_mm, -1, 0)
    fine, values = grid.smooth(x**2 - x * y)
    at = np.moveaxis(fine.heights_mm, -1, 0)
    assert values == pytest.approx(at[1] ** 2 - at[1] * at[0], abs=1e-9)


def test_the_best_plane_leaves_curvature_and_no_tilt() -> None:
    model = a_model()
    grid = Grid.edge_to_edge(FRAME, 24)
    left, std = after_plane_um(model, "R", grid)
    level = a_model()
    level.waves[:, 1:3, 0] = 0.0
    assert left == pytest.approx(after_plane_um(level, "R", grid)[0], abs=1e-9)
    y, x = np.moveaxis(grid.heights_mm / FRAME.radius_mm, -1, 0)
    # Noll 4 of the field is √3 (2 ρ² - 1)
    bowl = model.um_per_wave * CURVATURE * np.sqrt(3) * 2 * (x**2 + y**2)
    assert left == pytest.approx(bowl - bowl.mean(), abs=1e-9)
    assert std.min() > 0


def test_a_map_of_tangential_mtf_has_the_direction_of_each_place() -> None:
    model = a_model()
    grid = Grid.middles(FRAME, 3)
    value, std = mtf_over(model, "R", grid, 40.0, "tangential")
    assert value.shape == (2, 3)
    # the place in the middle of the upper row: its radius is along y
    upper = mtf(model.wavefront("R", grid.places_px[0, 1]), 40.0, "y")
    assert value[0, 1] == pytest.approx(float(upper.value))
    assert std[0, 1] == pytest.approx(float(upper.std))


def test_arrows_of_coma_point_right_for_noll_8_and_down_for_noll_7() -> None:
    shapes = Shapes.over(a_model(), "R", COMA)
    right, down = shapes.waves.mean(axis=0)
    assert (right, down) == pytest.approx((-0.02, 0.03))
    with styled():
        figure = coma_chart(shapes, INKS["R"], 0.1)
    arrows = figure.axes[0].texts
    assert len(arrows) == len(shapes.waves)
    (first, *_) = [text for text in arrows if isinstance(text, Annotation)]
    start, tip = np.array(first.xyann), np.array(first.xy)
    per_wave = 0.42 * shapes.grid.step_mm / 0.1
    assert tip - start == pytest.approx(per_wave * shapes.waves[0])


def test_lines_of_astigmatism_lie_where_the_path_is_longest() -> None:
    # Noll 6 has the cosine of twice the angle from x, Noll 5 the sine: greatest halfway between x and y
    ends = along_lines(np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0]]))
    half = 0.1 / np.sqrt(2)
    expected = np.array([[0.1, 0.0], [half, half], [0.0, 0.1]])
    assert np.abs(ends) == pytest.approx(expected, abs=1e-12)
    # of a lens with an axis the lines point to the middle of the frame, or circle it
    shapes = Shapes.over(a_model(), "R", ASTIGMATISM)
    lines, places = along_lines(shapes.waves), shapes.grid.each_mm[:, ::-1]
    across = lines[:, 0] * places[:, 1] - lines[:, 1] * places[:, 0]
    assert across == pytest.approx(np.zeros(len(places)), abs=1e-9)


def test_ellipses_of_errors_reach_one_standard_error_along_each_axis() -> None:
    ring = ellipses(np.array([[[4.0, 0.0], [0.0, 9.0]]]))[0]
    assert np.abs(ring).max(axis=0) == pytest.approx([2.0, 3.0])
    assert ring[0] == pytest.approx(ring[-1])


def test_stamps_of_a_frame_have_the_light_of_their_places() -> None:
    grid, stamps = stamps_of(a_model(), "R", 14.0)
    assert len(stamps) == grid.each_px.shape[0]
    focus = np.abs(focus_um(a_model(), "R", grid.each_px)[0])
    sharp, blurred = int(np.argmin(focus)), int(np.argmax(focus))
    assert stamps[sharp].max() > 2 * stamps[blurred].max()


@pytest.mark.parametrize(
    ("longest", "length"), [(0.049, 0.02), (0.05, 0.05), (7.0, 5.0), (0.0, 1.0)]
)
def test_a_scale_bar_has_a_round_length(longest: float, length: float) -> None:
    assert round_length(longest) == pytest.approx(length)


def test_contours_cover_all_values_with_round_levels() -> None:
    levels = covering([np.array([-31.0, 4.0]), np.array([12.0])])
    assert levels[0] <= -31 < levels[1]
    assert levels[-2] < 12 <= levels[-1]
    assert np.diff(levels) == pytest.approx(5.0)
    assert even_levels(1.0, 1.0)[0] < 1.0  # a map that is even everywhere
    # rounding alone has no contours: one step holds it all
    assert even_levels(-1e-16, 1e-15)[0] < -0.1


def test_the_arrow_of_tilt_points_where_the_sensor_recedes() -> None:
    model = a_model()
    grid = Grid.edge_to_edge(FRAME, 12)
    value, _ = focus_um(model, "R", grid.places_px)
    towards = lens_terms(model, "R").tilt.direction_deg
    assert towards.value == pytest.approx(np.degrees(np.arctan2(*TILT)))
    with styled():
        figure = map_chart(grid, value, "R", "µm", covering([value]), towards=towards)
        without = map_chart(
            grid, value, "R", "µm", covering([value]), towards=Uncertain(np.nan, 104.0)
        )
    (arrow,) = (text for text in figure.axes[0].texts if isinstance(text, Annotation))
    assert np.degrees(np.arctan2(*arrow.xy[::-1])) == pytest.approx(towards.value)
    assert not [text for text in without.axes[0].texts if isinstance(text, Annotation)]


def test_illumination_is_of_flats_above_darks_without_saturated_pixels() -> None:
    rows, columns = np.mgrid[:200, :300]
    height2 = (rows - 99.5) ** 2 + (columns - 149.5) ** 2
    light = 8000 * (1 - 0.3 * height2 / height2.max())
    rng = np.random.default_rng(5)

    def taken(mean: Floats) -> Photograph:
        counts = rng.poisson(mean + 40.0) + 512
        counts[50:60, 50:60] = 16383
        return Photograph(
            counts.astype(np.uint16), np.full((2, 2), 512.0), 16383.0, ("RG", "GB")
        )

    flats = [taken(light), taken(light)]
    darks = [taken(np.zeros_like(light))]
    found = illumination(flats, darks, ("R", "G", "B"), 5.0)
    assert set(found) == {"R", "G", "B"}
    for of in found.values():
        percent, std = of.corners_percent
        assert percent == pytest.approx(4 * [70.0], abs=1.0)
        # darks add 40 counts of 8000 with their noise
        assert np.all((std > 0.05) & (std < 0.5))
    assert illumination([], [], ("R",), 5.0) == {}


def test_lines_through_the_centre_end_at_edges_and_in_corners() -> None:
    ends = [line_end_mm(FRAME, azimuth) for azimuth in lines_of(FRAME)]
    half = np.array(FRAME.shape_px) / 2 * 4.78e-3
    assert ends == pytest.approx([half[1], half[0], FRAME.radius_mm, FRAME.radius_mm])
    inner = inner_points(FRAME)
    assert inner["bottom right"] == pytest.approx(
        FRAME.centre_px + 0.85 * np.array([2000, 3000])
    )


def test_curves_of_both_directions_have_their_bands_and_their_frequencies() -> None:
    pair = profiles(a_model(), "R", (10.0, 40.0), (90.0,), 5)
    with styled():
        axes = height_chart(pair, FRAME, INKS["R"]).axes[0]
    every = [np.asarray(line.get_ydata()) for line in axes.lines]
    curves = [values for values in every if values.size == 5]
    assert curves == [pytest.approx(row) for p in pair for row in p.mtf.value]
    assert len(axes.collections) == 4  # a band for each
    assert [text.get_text() for text in axes.texts] == ["10", "40"]
