"""Edges found in pictures whose edges are known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from labkit.edges.first_fits import rough_edge
from labkit.edges.found_edges import find_edges
from labkit.edges.region import Region
from labkit.errors import DataError
from labkit.types import Floats


def turned_square(angle_deg: float, side: float = 120.0, size: int = 240) -> Floats:
    """A bright square about the middle, turned from x towards y, blurred and noisy."""
    finer = 4
    y, x = (np.mgrid[0 : size * finer, 0 : size * finer] + 0.5) / finer - size / 2
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    inside = np.maximum(np.abs(x * c + y * s), np.abs(y * c - x * s)) < side / 2
    picture = (
        gaussian_filter(inside.astype(float), 1.5 * finer)
        .reshape(size, finer, size, finer)
        .mean(axis=(1, 3))
    )
    return np.asarray(
        400 + 3000 * picture + np.random.default_rng(1).normal(0, 30, picture.shape)
    )


def test_all_sides_of_a_square_are_found_with_their_normals_towards_the_light() -> None:
    found = find_edges(turned_square(12.0))
    angles = sorted({round(float(np.degrees(edge.angle)) / 2) * 2 % 360 for edge in found})
    assert 8 <= len(found) <= 12  # two or three pieces a side
    np.testing.assert_allclose(angles, [12, 102, 192, 282], atol=2)
    for edge in found:
        # inward, from the middle of the piece to the middle of the square
        inward = np.array([119.5 - edge.middle[1], 119.5 - edge.middle[0]])
        assert inward @ [np.cos(edge.angle), np.sin(edge.angle)] == pytest.approx(
            60, abs=1.5
        )
        assert edge.box[0] <= edge.middle[0] < edge.box[2]
        assert edge.box[1] <= edge.middle[1] < edge.box[3]


def test_boxes_of_a_plane_are_in_pixels_of_the_raw() -> None:
    whole, plane = (
        find_edges(turned_square(12.0)),
        [edge.on((1, 0), 2) for edge in find_edges(turned_square(12.0))],
    )
    assert [(2 * a + 1, 2 * b) for a, b in (e.middle for e in whole)] == [
        e.middle for e in plane
    ]


def test_noise_and_an_even_picture_have_no_edges() -> None:
    assert find_edges(np.random.default_rng(2).normal(1000, 30, (200, 200))) == []
    assert find_edges(np.full((100, 100), 7.0)) == []


def region(counts: Floats) -> Region:
    rows, columns = (
        a.ravel().astype(float) for a in np.mgrid[0 : counts.shape[0], 0 : counts.shape[1]]
    )
    return Region(
        rows,
        columns,
        counts.ravel(),
        ((counts.shape[0] - 1) / 2, (counts.shape[1] - 1) / 2),
    )


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (np.full((40, 40), 900.0), "equally bright"),
        (np.random.default_rng(3).normal(900, 20, (40, 40)), "explains"),
        (turned_square(0.0)[30:70, 30:70], "explains|sides"),  # a corner
        (turned_square(30.0, 8.0)[100:140, 100:140], "explains|sides"),  # a blob
        (turned_square(0.0)[100:140, 57:97], "both of its sides"),
    ],
)
def test_what_is_no_edge_is_refused_in_one_line(counts: Floats, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        rough_edge(region(counts)).refuse_no_edge()
    assert "\n" not in str(caught.value)


def test_a_rough_edge_is_where_the_edge_is() -> None:
    rough = rough_edge(region(turned_square(12.0)[100:140, 40:80]))
    rough.refuse_no_edge()
    edge = rough.edge.towards_light
    assert np.degrees(edge.angle) == pytest.approx(12.0, abs=0.5)
    away = (
        60 * np.cos(np.radians(12)) - 60
    )  # the cut's middle lies 60 pixels from the square's along x, the side 60 along its normal
    assert edge.distance_px == pytest.approx(away, abs=0.1)
    assert rough.width_px == pytest.approx(1.5, abs=0.2)
