"""Parts that hardly do anything in the fits that have them."""

from __future__ import annotations

import pytest

from labkit.estimation.camera import Parts, idle
from labkit.estimation.stated import optics_of
from tests.optimum_samples import PLAN, optimum

OPTICS = optics_of(PLAN, "G")


@pytest.mark.parametrize(("unexplained", "is_idle"), [(4900.0, False), (5100.0, True)])
def test_a_part_is_idle_that_is_worth_less_than_its_share_of_what_is_not_explained(
    unexplained: float, is_idle: bool
) -> None:
    """Two fits whose numbers are 50 errors from zero: worth 1250 each."""
    optics = OPTICS.with_parts(["obstruction"])
    fits = [optimum(optics, 3200.0, square=0.5, unexplained=unexplained, explained=False)]
    assert (idle(fits * 2, Parts(["obstruction"])) == {"obstruction"}) == is_idle


def test_a_part_that_chance_gives_to_explained_fits_is_idle() -> None:
    optics = OPTICS.with_parts(["obstruction"])
    assert idle([optimum(optics, 3200.0, square=0.02)], Parts(["obstruction"]))
    assert not idle([optimum(optics, 3200.0, square=0.5)], Parts(["obstruction"]))
