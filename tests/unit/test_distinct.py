"""A photograph counts once, under however many names."""

from pathlib import Path

import pytest

from labkit.errors import SessionError
from labkit.session.frame import Frame, distinct
from labkit.types import FrameKind


def frame(
    name: str, content: str, kind: FrameKind = "target", range_mm: float | None = 3000.0
) -> Frame:
    return Frame(
        name, kind, range_mm, content, None, "2026-01-01T00:00:00+00:00", Path(name)
    )


def noisy(frame: Frame) -> bool:
    return False


def test_copies_of_a_photograph_count_once_and_are_named() -> None:
    one, other = frame("a.dng", "1"), frame("b.dng", "2")
    kept, again = distinct([one, other, frame("c.dng", "1"), frame("d.dng", "1")], noisy)
    assert kept == (one, other)
    assert [finding.numbers for finding in again] == [
        {"file": name, "same_as": "a.dng"} for name in ("c.dng", "d.dng")
    ]
    assert again[0].text == "c.dng is the same photograph as a.dng: it counts once"


@pytest.mark.parametrize(
    ("again", "says"),
    [
        (
            frame("b.dng", "1", range_mm=3100.0),
            "a target at 3000 mm or a target at 3100 mm",
        ),
        (frame("b.dng", "1", "dark", None), "a target at 3000 mm or a dark"),
    ],
)
def test_a_photograph_that_stands_for_two_is_refused(again: Frame, says: str) -> None:
    with pytest.raises(SessionError, match=says):
        distinct([frame("a.dng", "1"), again], noisy)


def constant(frame: Frame) -> bool:
    return True


def test_flats_without_noise_are_clipped_and_no_copies() -> None:
    flats = [frame("a.dng", "1", "flat"), frame("b.dng", "1", "flat", range_mm=3100.0)]
    with pytest.raises(SessionError, match=r"a\.dng and b\.dng are clipped"):
        distinct(flats, constant)


def test_darks_without_noise_are_all_kept() -> None:
    darks = tuple(frame(f"{k}.dng", "1", "dark", None) for k in range(3))
    assert distinct(darks, constant) == (darks, ())
