"""Edges of charts found, grouped by place, and those that cannot be used."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from labkit.charts.chart_edges import chart_edges, grid, is_aligned
from labkit.edges.boxes import ChannelFrame, Place, lines_along
from labkit.edges.esfr import Plane
from labkit.edges.found_edges import DEEP, FoundEdge
from labkit.errors import DataError
from labkit.photographs.photograph import Photograph
from labkit.types import Floats
from tests.chart_scenes import PATCH, checkerboard, squares

WHITE = 16383.0


def channel(counts: Floats) -> ChannelFrame:
    noisy = counts + np.random.default_rng(1).normal(0, 20, counts.shape)
    black = np.zeros((2, 2))
    whole = noisy.clip(0, WHITE).astype(np.uint16)
    return ChannelFrame.of(Photograph(whole, black, WHITE, ("M",)), "M")


def drawn(
    shape: tuple[int, int], scene: object = squares, bright: float = 6000.0
) -> Floats:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    lit = (0.5 + scene(y, x)).clip(0, 1)  # type: ignore[operator]
    return np.asarray(cv2.GaussianBlur(1000 + (bright - 1000) * lit, (0, 0), 1.5))


def test_each_square_gives_its_four_edges_at_its_place() -> None:
    found = chart_edges(channel(drawn((3 * PATCH, 5 * PATCH))), (3, 5), 4)
    assert set(found.places) == {(r, c) for r in range(3) for c in range(5)}
    for cell, places in found.places.items():
        middles = np.array([place.found.middle for place in places if place.found])
        assert np.all(np.floor(middles / PATCH) == cell)
        turns = sorted({round(np.degrees(p.found.angle) % 90) for p in places if p.found})
        assert turns == [5]
        assert {round(np.degrees(p.found.angle)) % 180 for p in places if p.found} == {
            5,
            95,
        }
    assert (found.cut, found.clipped) == (0, 0)


def test_edges_that_the_frame_cuts_are_counted() -> None:
    picture = drawn((3 * PATCH, 5 * PATCH))
    cropped = picture[int(0.15 * PATCH) :]  # upper edges run along the border
    found = chart_edges(channel(cropped), (3, 5), 4)
    assert found.cut == 5
    whole = chart_edges(channel(picture), (3, 5), 4)
    number = [sum(map(len, of.places.values())) for of in (found, whole)]
    assert number[0] <= number[1] - 5


def test_clipped_edges_are_left_out_and_counted() -> None:
    picture = drawn((3 * PATCH, 5 * PATCH))
    picture[:, : 2 * PATCH] *= 3  # two columns of squares on a clipped ground
    found = chart_edges(channel(picture), (3, 5), 4)
    assert {column for _, column in found.places} == {2, 3, 4}
    assert found.clipped >= 2 * 3 * 4 - 3


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (np.full((300, 400), 3000.0), "no chart was found"),
        (drawn((2 * PATCH, 2 * PATCH)), "6 or more slanted squares"),
        (drawn((2 * PATCH, 3 * PATCH), bright=20000.0), "slanted squares.*24 are clipped"),
    ],
)
def test_a_chart_that_is_not_found_is_one_line(counts: Floats, words: str) -> None:
    with pytest.raises(DataError, match=words):
        chart_edges(channel(counts), (3, 3), 2)


def test_edges_beyond_the_requested_number_are_spare() -> None:
    few = chart_edges(channel(drawn((3 * PATCH, 3 * PATCH))), (3, 3), 1)
    more = chart_edges(channel(drawn((3 * PATCH, 3 * PATCH))), (3, 3), 2)
    assert {len(places) for places in few.places.values()} == {2}
    count = [sum(map(len, of.places.values())) + of.spare for of in (few, more)]
    assert count[0] == count[1]


def test_a_checkerboards_edges_end_before_its_corners() -> None:
    found = chart_edges(channel(drawn((4 * PATCH, 5 * PATCH), checkerboard)), (3, 3), 9)
    places = [p.found for every in found.places.values() for p in every if p.found]
    assert len(places) >= 20
    turn = np.radians(5.0)
    for place in places:
        row, column = place.middle
        along = (
            row * np.cos(turn) - column * np.sin(turn)
            if abs(np.cos(place.angle)) > 0.7
            else column * np.cos(turn) + row * np.sin(turn)
        )
        to_corner = PATCH / 2 - abs(along % PATCH - PATCH / 2)
        assert to_corner - place.length_px / 2 > 8  # 12 are trimmed off what LSD finds


@pytest.mark.parametrize(
    ("shape", "columns", "cells"),
    [((4000, 6000), 7, (5, 7)), ((6000, 4000), 3, (5, 3)), ((3000, 4000), 9, (7, 9))],
)
def test_cells_are_nearly_square_and_odd_in_number(
    shape: tuple[int, int], columns: int, cells: tuple[int, int]
) -> None:
    assert grid(shape, columns) == cells


@pytest.mark.parametrize(
    ("angle_deg", "aligned"),
    [(0.5, True), (-0.5, True), (90.8, True), (-179.3, True), (1.2, False), (45.0, False)],
)
def test_edges_along_rows_or_columns_are_told(angle_deg: float, aligned: bool) -> None:
    assert is_aligned(angle_deg) == aligned


def test_an_edge_at_the_border_of_a_later_plane_has_its_box_in_the_frame() -> None:
    # green begins at column 1: a cell of its last sample would end beyond the frame
    counts = np.full((120, 200), 1000, np.uint16)
    frame = ChannelFrame.of(Photograph(counts, np.zeros((2, 2)), WHITE, ("RG", "GB")), "G")
    place = frame.found_at(FoundEdge((0, 72, 60, 100), (30.0, 86.0), 0.0, 48.0, 1.0))
    assert place.box == (0, 145, 120, 200)
    assert frame.region(place, 0).counts.size > 1000
    # as many lines as the edge is long
    assert [plane.values.shape for plane in frame.planes(place)] == 2 * [(48, 25)]


@pytest.mark.parametrize("angle_deg", [3.0, 22.0, 40.0, 84.0, -130.0])
def test_the_lines_of_a_found_edge_run_along_it(angle_deg: float) -> None:
    angle = np.radians(angle_deg)
    row, column = np.mgrid[100:180.0, 200:280.0]
    across = (column - 239.3) * np.cos(angle) + (row - 141.2) * np.sin(angle)
    along = (row - 141.2) * np.cos(angle) - (column - 239.3) * np.sin(angle)
    found = FoundEdge((100, 200, 180, 280), (141.2, 239.3), angle, 60.0, 1.0)
    for values, most in ((across, DEEP + 1), (along, 30.5)):
        lines = lines_along(Plane(values, (100.0, 200.0)), found)
        assert np.abs(lines.values).max() < most
        assert len(lines.values) >= 15
    # the crossing is in the middle of each line
    crossing = np.argmin(
        np.abs(lines_along(Plane(across, (100.0, 200.0)), found).values), 1
    )
    assert np.ptp(crossing) <= 1


def test_pixels_of_a_box_are_those_of_the_whole_frame() -> None:
    rng = np.random.default_rng(1)
    black = np.array([[500.0, 510.0], [520.0, 530.0]])
    counts = rng.integers(600, 16000, (60, 80)).astype(np.uint16)
    photograph = Photograph(counts, black, 15000.0, ("RG", "GB"))
    for box in ((0, 0, 60, 80), (7, 12, 31, 45), (10, 11, 30, 80)):
        place = Place(box)
        light, usable, *_ = ChannelFrame.of(photograph, "B").read(place)
        assert np.array_equal(light, photograph.light[place.slices])
        expected = photograph.channel_mask("B") & ~photograph.saturated
        assert np.array_equal(usable, expected[place.slices])
