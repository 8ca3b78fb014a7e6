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


def test_copies_of_a_photograph_count_once_and_are_named() -> None:
    one, other = frame("a.dng", "1"), frame("b.dng", "2")
    kept, again = distinct([one, other, frame("c.dng", "1"), frame("d.dng", "1")])
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
        distinct([frame("a.dng", "1"), again])
