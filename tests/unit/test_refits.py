"""From which optimum a refit with other parts begins; the searches themselves are played."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from labkit.estimation.local import Found, Guesses, Optimum
from labkit.estimation.refits import Refits
from labkit.estimation.searches import Searches
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.types import Floats
from tests.optimum_samples import PLAN, RANGES_MM, observations, optimum

NONE = frozenset[str]()
SMEAR = frozenset({"smear"})
UNEVEN = frozenset({"uneven_rim"})
EYE = frozenset({"cats_eye"})
BLADES = frozenset({"blades_5"})
OBSTRUCTED = frozenset({"obstruction"})
HIGHER = frozenset({"modes_16_21", "modes_22_28"})


@dataclass
class Played:
    """Searches that end where they are told to, and keep what they were asked for."""

    ends: Mapping[int, Optimum]
    turns: list[dict[int, tuple[Optics, Guesses]]] = field(default_factory=list)
    observations: Any = field(default_factory=observations)
    ranges_mm: list[float] = field(default_factory=list)

    @property
    def wanted(self) -> dict[int, tuple[Optics, Guesses]]:
        return self.turns[-1]

    @property
    def begun(self) -> Floats:
        """The wavefront from which the first observation was climbed last."""
        _, guess = self.wanted[0]
        assert guess.state is not None
        return guess.state.waves

    def __call__(
        self, wanted: Mapping[int, tuple[Optics, Guesses]], doing: str
    ) -> dict[int, Found]:
        self.turns.append(dict(wanted))
        return {k: Found((self.end(k, *one),)) for k, one in wanted.items()}

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        return self.ends[k]


def end_with(parts: frozenset[str], off: float, height: float) -> Optimum:
    """An optimum with some parts, off by some waves of defocus."""
    optics = optics_of(PLAN, "G").with_parts(parts)
    return optimum(optics, RANGES_MM[0], off=(off, 0.0), height=height)


def test_a_refit_without_a_part_begins_from_the_better_optimum_that_the_part_led_to() -> (
    None
):
    missed, better = end_with(NONE, 0.1, -100.0), end_with(SMEAR, 0.0, 0.0)
    search = Played({0: better})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: missed}, NONE, SMEAR)
    refits({0: missed}, NONE, NONE)
    np.testing.assert_allclose(search.begun, better.state.waves)


def test_modes_are_added_to_a_fit_with_the_obstruction_though_all_modes_explain_more() -> (
    None
):
    """Modes begin at zero and lose nothing; an obstruction begins far from zero, below the likelihood that it is added to."""
    obstructed, likelier = end_with(OBSTRUCTED, 0.0, -100.0), end_with(HIGHER, 0.1, 0.0)
    search = Played({0: obstructed})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: obstructed}, NONE, OBSTRUCTED)
    refits({0: likelier}, HIGHER, OBSTRUCTED | {"modes_16_21"})
    np.testing.assert_allclose(search.begun[:2], obstructed.state.waves)


def test_a_cats_eye_begins_from_the_uneven_rim_in_whose_place_it_is_fitted() -> None:
    round_one = end_with(NONE, 0.0, -100.0)
    uneven = KNOWN["uneven_rim"].at([-0.1, 0.0, 0.02, 0.0])
    oval = end_with(UNEVEN, 0.0, 0.0)
    oval = replace(oval, optics=replace(oval.optics, parts=(uneven,)))
    search = Played({0: oval})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: round_one}, NONE, UNEVEN)
    refits({0: round_one}, NONE, EYE)
    optics, guess = search.turns[-2][0]
    (eye,) = optics.parts
    assert eye.name == "cats_eye"
    assert np.hypot(eye.values[0], eye.values[1]) > 0.09
    # the same pupil: its unit is now the full pupil's radius
    assert optics.rim.area < 0.95
    assert guess.state is not None
    wider = optics.rim.area**-0.5
    assert optics.f_number * wider == pytest.approx(oval.optics.f_number, rel=1e-12)
    # the same wavefront over the clear part: 2e-3 measured
    assert guess.state.waves[1] == pytest.approx(oval.state.waves[1] * wider**2, rel=4e-3)


class Cut(Played):
    """Searches for a pupil cut on its right: a circle on the left is made up for by a large wavefront."""

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        eye = [part for part in optics.parts if part.name == "cats_eye"]
        wrong = bool(eye) and eye[0].values[0] < 0
        end = end_with(NONE, 0.0, -99.0 if wrong else -100.0)
        assert guess.state is not None
        waves = np.array([guess.state.waves[0], 0.5 if wrong else 0.02])
        return replace(end, optics=optics, state=replace(end.state, waves=waves))


def test_both_sides_are_tried_far_from_focus_and_other_fits_begin_with_the_better_one() -> (
    None
):
    uneven = KNOWN["uneven_rim"].at([-0.1, 0.0, 0.02, 0.0])
    ovals = {}
    for k, off in enumerate((0.0, 1.0)):
        oval = end_with(UNEVEN, off, 0.0)
        ovals[k] = replace(oval, optics=replace(oval.optics, parts=(uneven,)))
    far = max(ovals, key=lambda k: abs(ovals[k].waves[0]))
    search = Cut({})
    refits = Refits(cast(Searches, search), PLAN)
    ends = refits(ovals, UNEVEN, EYE)
    sides = [one[far][0].parts[0].values[0] for one in search.turns[:2]]
    assert list(search.turns[0]) == list(search.turns[1]) == [far]
    assert min(sides) < 0 < max(sides)
    assert list(search.turns[2]) == [1 - far]
    optics, guess = search.turns[2][1 - far]
    assert ends[far].optics.parts == optics.parts
    assert guess.beside is not None
    assert guess.state is not None
    there, waves = guess.beside
    assert there.parts == ends[far].optics.parts
    # of the better side, and as far from it in defocus and cone as before
    wider = (ovals[far].optics.f_number / ends[far].optics.f_number) ** 2
    apart = ovals[1 - far].waves[0] - ovals[far].waves[0]
    assert waves[0] - ends[far].waves[0] == pytest.approx(wider * apart, rel=1e-12)
    assert waves[1] == ends[far].waves[1] != guess.state.waves[1]
    assert all(end.optics.parts[0].values[0] > 0 for end in ends.values())


class Misled(Cut):
    """The same, but the fit far from focus is misled: there the wrong side is likelier."""

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        end = super().end(k, optics, guess)
        wrong = optics.parts[0].values[0] < 0
        height = 10.0 if wrong and k == FAR else -10.0 if wrong else 0.0
        return replace(end, log_likelihood=end.log_likelihood + height)


FAR = 1


def test_all_fits_together_decide_for_a_side_and_later_ones_keep_it() -> None:
    uneven = KNOWN["uneven_rim"].at([-0.1, 0.0, 0.02, 0.0])
    ovals = {}
    for k, off in enumerate((0.0, 1.0, 0.1, 0.2)):
        oval = end_with(UNEVEN, off, 0.0)
        ovals[k] = replace(oval, optics=replace(oval.optics, parts=(uneven,)))
    search = Misled({}, observations=observations() * 2)
    refits = Refits(cast(Searches, search), PLAN)
    first = refits({k: ovals[k] for k in (0, FAR, 2)}, UNEVEN, EYE)
    assert all(end.optics.parts[0].values[0] > 0 for end in first.values())
    before = len(search.turns)
    later = refits({3: ovals[3]}, UNEVEN, EYE)
    assert len(search.turns) == before + 1
    assert later[3].optics.parts[0].values[0] > 0


def test_an_obstruction_begins_at_the_stated_f_number_with_the_same_rays() -> None:
    clear = end_with(NONE, 0.0, 0.0)
    cone = 1.5 * clear.optics.f_number
    slow = replace(clear, optics=replace(clear.optics, f_number=cone))
    search = Played({0: slow})
    Refits(cast(Searches, search), PLAN)({0: slow}, NONE, OBSTRUCTED)
    optics, _ = search.wanted[0]
    assert optics.f_number == pytest.approx(PLAN.lens.f_number)
    rays = PLAN.lens.f_number * search.begun
    np.testing.assert_allclose(rays, cone * slow.state.waves, rtol=1e-12)


def test_behind_a_cats_eye_blades_of_odd_number_begin_with_the_circle_opposite_too() -> (
    None
):
    eye = KNOWN["cats_eye"].at([-0.3, 0.1, 0.05])
    cut = end_with(EYE, 0.0, 0.0)
    cut = replace(cut, optics=replace(cut.optics, parts=(eye,)))
    search = Cut({})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: cut}, EYE, EYE | BLADES)
    eyes = [turn[0][0].parts[-1].values for turn in search.turns]
    assert eyes == [(-0.3, 0.1, 0.05), (0.3, -0.1, 0.05)]
    refits({0: cut}, EYE, EYE | {"blades_6"})
    assert len(search.turns) == 3


def test_a_refit_that_was_made_from_the_same_optimum_is_not_made_again() -> None:
    search = Played({0: end_with(SMEAR, 0.0, 0.0)})
    refits = Refits(cast(Searches, search), PLAN)
    missed = end_with(NONE, 0.1, -100.0)
    first = refits({0: missed}, NONE, SMEAR)
    assert refits({0: missed}, NONE, SMEAR) == first
    assert len(search.turns) == 1
