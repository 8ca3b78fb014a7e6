"""A lens that is touched between two ranges, and one that is not; numbers by the laws written out in tests/lens_samples.py."""

from __future__ import annotations

import pytest

from labkit.estimation.split import parting
from tests.lens_samples import members, moved, stated

STATIONS = (3000.0, 3060.0, 3120.0, 3180.0, 3240.0, 3300.0)


@pytest.mark.parametrize("before", [2, 3, 4])
def test_the_station_is_named_after_which_the_focus_was_changed(before: int) -> None:
    touched = [
        *members(STATIONS[:before], 3150.0, 70.0, 2.8),
        *members(STATIONS[before:], 3165.0, 70.0, 2.8),
    ]
    assert parting(touched, STATIONS, stated(70.0, 2.8)) == before


def test_ranges_taken_in_another_order_are_parted_in_time() -> None:
    order = (3300.0, 3000.0, 3240.0, 3060.0, 3180.0, 3120.0)
    touched = [
        *members(order[:3], 3150.0, 70.0, 2.8),
        *members(order[3:], 3165.0, 70.0, 2.8),
    ]
    assert parting(touched, order, stated(70.0, 2.8)) == 3


def test_a_lens_left_alone_is_not_parted() -> None:
    alone = members(STATIONS, 3150.0, 70.0, 2.8)
    assert parting(alone, STATIONS, stated(70.0, 2.8)) is None
    jittered = [moved(m, waves=3e-4 * (-1) ** k) for k, m in enumerate(alone)]
    assert parting(jittered, STATIONS, stated(70.0, 2.8)) is None


def test_two_stations_are_too_few_to_tell() -> None:
    touched = [
        *members(STATIONS[:1], 3150.0, 70.0, 2.8),
        *members(STATIONS[1:2], 3165.0, 70.0, 2.8),
    ]
    assert parting(touched, STATIONS[:2], stated(70.0, 2.8)) is None
