"""A session is fitted with the target as large as its display drew it."""

from pathlib import Path

import pytest

from labkit.errors import SessionError
from labkit.plan import Plan
from labkit.session.completed_plan import with_shown_size
from labkit.session.session import Session
from tests.plans import PORTRAIT, plan_text

TEXT = plan_text(PORTRAIT, {"target": {"order": 5, "size_mm": 46.8}})
DRAWN_MM = 486 * 25.4 / 264
"""Two pixels a cell, of a panel of 264 pixels an inch."""


@pytest.fixture
def session(tmp_path: Path) -> Session:
    with Session.create(tmp_path / "night", TEXT, tmp_path) as session:
        session.log("began", shown_size_mm=[DRAWN_MM, DRAWN_MM])
    return Session.open(tmp_path / "night")


def test_the_size_is_that_of_whole_panel_pixels(session: Session) -> None:
    shown = with_shown_size(session, session.plan)
    assert shown.target.size_mm == pytest.approx(DRAWN_MM, rel=1e-12)
    assert shown.replace(target={"size_mm": 46.8}) == session.plan


def test_a_plan_with_a_measured_size_is_taken_at_its_word(session: Session) -> None:
    measured = session.plan.replace(target={"size_mm": 46.77})
    assert with_shown_size(session, measured) is measured


def test_a_target_that_no_display_showed_is_as_the_plan_says(tmp_path: Path) -> None:
    Session.create(tmp_path / "paper", TEXT, tmp_path).close()
    session = Session.open(tmp_path / "paper")
    assert with_shown_size(session, session.plan) == Plan.parse(TEXT)


@pytest.mark.parametrize("size", [[46.8], "46.8", [46.8, 0], [46.8, None]])
def test_a_journal_with_a_size_that_is_none_is_refused(
    tmp_path: Path, size: object
) -> None:
    with Session.create(tmp_path / "night", TEXT, tmp_path) as session:
        session.log("began", shown_size_mm=size)
    with pytest.raises(SessionError, match="line 2 cannot be used"):
        Session.open(tmp_path / "night")


def test_a_grid_is_as_far_apart_as_it_was_shown(tmp_path: Path) -> None:
    grid = {"target": {"order": 5, "size_mm": 46.8, "grid": [2, 3], "pitch_mm": 70.0}}
    text = plan_text(PORTRAIT, grid)
    with Session.create(tmp_path / "night", text, tmp_path) as session:
        session.log("began", shown_size_mm=[DRAWN_MM, DRAWN_MM], shown_pitch_mm=69.93)
    session = Session.open(tmp_path / "night")
    shown = with_shown_size(session, session.plan).target
    assert (shown.size_mm, shown.pitch_mm) == pytest.approx((DRAWN_MM, 69.93))
    measured = session.plan.replace(target={"pitch_mm": 70.01})
    assert with_shown_size(session, measured).target.pitch_mm == 70.01
