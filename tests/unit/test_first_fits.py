"""Which tiles of a field are fitted first, and from where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.estimate import observed
from labkit.estimation.first_fits import (
    beside,
    best_predicted,
    clearest,
    in_other_colour,
    nearest_fitted,
    spread,
    telling,
    wrong_near_focus,
)
from labkit.estimation.local import Found
from labkit.estimation.observation import Observation
from labkit.estimation.select import select
from labkit.estimation.stated import Stated, optics_of
from labkit.imaging.parts import CatsEye
from labkit.imaging.warp import Pose
from tests.optimum_samples import (
    NOISE,
    PLAN,
    RANGES_MM,
    observations,
    optimum,
    true_values,
)

TILE_PX = 100


def tile(column: int, channel: str = "G", range_mm: float = 1180.0) -> Observation:
    """A tile of a row of ten, without photographs."""
    corners = 30.0 + 40 * np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    return Observation(
        range_mm,
        range_mm,
        channel,
        ("a.dng",),
        (),
        (Pose.from_corners(corners, (10.0, 10.0)),),
        NOISE,
        ((0, 0),),
        1,
        origin_px=(0, TILE_PX * column),
        tile=(0, column),
        photograph_px=(TILE_PX, 10 * TILE_PX),
    )


ROW = [tile(column) for column in range(10)]


def test_a_tile_begins_from_its_nearest_fitted_neighbour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Observation, "shape", (TILE_PX, TILE_PX))
    assert nearest_fitted(ROW, [1, 5], 4) == 5
    assert nearest_fitted(ROW, [1, 5], 2) == 1


def test_a_neighbour_is_of_the_same_channel_and_range() -> None:
    others = [tile(3), tile(3, "R"), tile(3, range_mm=1260.0)]
    assert nearest_fitted(others, [1, 2], 0) is None


def test_another_colour_of_the_station_tells_a_cats_eye_if_it_is_explained() -> None:
    seen, optics = observations("GR"), optics_of(PLAN, "G")
    eye, plain = CatsEye(0.3, 0.0, 0.0), optimum(optics, RANGES_MM[0])
    cut = replace(plain, optics=replace(optics, parts=(eye,)))
    assert in_other_colour(seen, {0: cut}, 1) is cut
    assert in_other_colour(seen, {0: cut}, 0) is None
    assert in_other_colour(seen, {0: cut}, 3) is None
    unexplained = replace(cut, verdict=replace(cut.verdict, accepted=False))
    assert in_other_colour(seen, {0: unexplained}, 1) is None
    assert in_other_colour(seen, {0: plain}, 1) is None


def test_the_most_alike_fit_is_moved_by_the_predicted_difference() -> None:
    seen, optics = observations("G"), optics_of(PLAN, "G")
    off = {1: 0.004, 2: -0.002}
    found = {
        k: Found((optimum(optics, RANGES_MM[k], off=(0.0, waves)),))
        for k, waves in off.items()
    }
    every = [observed(one, found.get(k)) for k, one in enumerate(seen)]
    rows = {k: k for k in range(len(seen))}
    selection = select(every, Stated.of(PLAN))
    assert selection.members[[1, 2]].all()
    for k, near in ((0, 1), (3, 2)):
        alike = beside(seen, rows, selection, k, optics)
        assert alike is not None
        there, waves = alike
        defocus, astigmatism, cone, _ = true_values(RANGES_MM[k])
        np.testing.assert_allclose(waves[0], defocus, atol=0.01)
        assert waves[1] == pytest.approx(astigmatism + off[near], abs=1e-9)
        assert np.log(there.f_number) == pytest.approx(cone, abs=1e-3)


def test_no_fit_of_another_colour_is_moved() -> None:
    seen = observations("GR", RANGES_MM[:1])
    found = Found((optimum(optics_of(PLAN, "G"), RANGES_MM[0]),))
    selection = select([observed(seen[0], found), observed(seen[1], None)], Stated.of(PLAN))
    assert beside(seen, {0: 0, 1: 1}, selection, 1, optics_of(PLAN, "R")) is None


def test_tiles_next_to_fitted_ones_come_first_and_one_of_a_new_colour() -> None:
    observations = [*ROW, tile(4, "R"), tile(5, "R")]
    stds = {k: abs(k - 4.9) for k in range(10) if k != 5} | {10: 0.9, 11: 0.1}
    assert best_predicted(observations, [5], stds, 3) == [4, 6, 3, 11]


def test_the_clearest_photographs_of_a_tile_are_farthest_from_focus() -> None:
    observations = [tile(3), tile(3, range_mm=1260.0), tile(4)]
    assert clearest(observations, {0: -0.1, 1: 0.3, 2: 0.0}) == [1, 2]


def test_tiles_spread_over_each_photograph_decide_about_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    long = [tile(column, range_mm=r) for r in (1180.0, 1260.0) for column in range(33)]
    # middle and ends, then each time the middle of the longest gap
    nine = [0, 4, 8, 12, 16, 20, 24, 28, 32]
    monkeypatch.setattr(Observation, "place", property(lambda one: (0.0, one.tile[1] - 16)))
    assert spread(long, range(66)) == [*nine, *(33 + column for column in nine)]


def test_all_photographs_of_one_target_decide_about_parts() -> None:
    seen = observations("GRB")
    assert spread(seen, range(len(seen))) == [*range(len(seen))]


FAR_MM, OTHER_END_MM, NEAR_MM = 2600.0, 3500.0, 3010.0
"""-2.6, +2.4 and 0.06 waves of defocus."""


Anchor = tuple[float, bool]
"""Range in mm, and whether the fit is explained."""


def found_of(*anchors: Anchor) -> dict[int, Found]:
    optics = optics_of(PLAN, "G")
    return {
        k: Found((optimum(optics, range_mm, explained=explained),))
        for k, (range_mm, explained) in enumerate(anchors)
    }


@pytest.mark.parametrize(
    ("first", "second", "tell"),
    [
        ((FAR_MM, True), (NEAR_MM, True), [0]),
        ((FAR_MM, False), (NEAR_MM, False), [0]),
        ((FAR_MM, False), (NEAR_MM, True), [0]),
        ((NEAR_MM, True), (NEAR_MM, False), []),
        ((FAR_MM, True), (OTHER_END_MM, False), [0]),
        ((NEAR_MM, False), (NEAR_MM, False), [0, 1]),
    ],
)
def test_anchors_far_from_focus_tell_what_the_camera_has(
    first: Anchor, second: Anchor, tell: list[int]
) -> None:
    assert telling(found_of(first, second)) == tell


@pytest.mark.parametrize(
    ("first", "second", "wrong"),
    [
        ((FAR_MM, True), (NEAR_MM, False), [1]),
        ((FAR_MM, True), (NEAR_MM, True), []),
        ((FAR_MM, False), (NEAR_MM, False), []),
        ((FAR_MM, True), (OTHER_END_MM, False), []),
    ],
)
def test_an_unexplained_anchor_near_focus_is_wrong_beside_an_explained_one_far_from_it(
    first: Anchor, second: Anchor, wrong: list[int]
) -> None:
    assert wrong_near_focus(found_of(first, second)) == wrong
