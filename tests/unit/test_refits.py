"""From which optimum a refit with other parts begins; the searches themselves are played."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from labkit.estimation.local import Found, Guesses, Optimum
from labkit.estimation.refits import Refits
from labkit.estimation.scores import ScoreTest
from labkit.estimation.searches import Searches
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, Part
from labkit.types import Floats
from tests.optimum_samples import PLAN, RANGES_MM, observations, optimum

NONE = frozenset[str]()
SMEAR = frozenset({"smear"})
VEILED = frozenset({"veil"})
DIFFUSE = frozenset({"diffusion"})
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
    at_once: list[int] = field(default_factory=list)

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
        if wanted:
            self.turns.append(dict(wanted))
        return {k: Found((self.end(k, *one),)) for k, one in wanted.items()}

    def each(
        self, wanted: Sequence[tuple[int, Optics, Guesses]], doing: str
    ) -> list[Found]:
        self.at_once.append(len(wanted))
        return [self({k: (optics, guess)}, doing)[k] for k, optics, guess in wanted]

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        return self.ends[k]


def end_with(
    parts: frozenset[str], off: float, height: float, numbers: Sequence[float] | float = 0.0
) -> Optimum:
    """An optimum with some parts, off by some waves of defocus. numbers: of the parts."""
    optics = optics_of(PLAN, "G").with_parts(parts)
    square = np.array(numbers)
    return optimum(optics, RANGES_MM[0], off=(off, 0.0), height=height, square=square)


def calling_for(name: str, gain: float, end: Optimum) -> Optimum:
    """An optimum whose score test promises a gain by a part of one number."""
    test = ScoreTest(np.array([np.sqrt(2 * gain)]), np.eye(1))
    return replace(end, scores={name: test})


def fits_behind(part: Part, *off: float) -> dict[int, Optimum]:
    """Fits with a part of the rim, by observation, off by some waves of defocus."""
    fits = {}
    for k, waves in enumerate(off):
        one = end_with(frozenset({part.name}), waves, 0.0, part.values)
        fits[k] = replace(one, optics=replace(one.optics, parts=(part,)))
    return fits


OVAL = KNOWN["uneven_rim"].at([-0.1, 0.0, 0.02, 0.0])


def test_a_refit_without_a_part_begins_from_the_better_optimum_that_the_part_led_to() -> (
    None
):
    missed, better = end_with(NONE, 0.1, -100.0), end_with(SMEAR, 0.0, 0.0)
    search = Played({0: better})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: missed}, NONE, SMEAR)
    refits({0: missed}, NONE, NONE)
    np.testing.assert_allclose(search.begun, better.state.waves)


@pytest.mark.parametrize(
    ("promise", "reached", "kept"),
    [(24.0, -5.0, -10.0), (25.0, -5.0, -5.0), (25.0, -12.0, -10.0)],
)
def test_a_refit_is_made_again_from_an_optimum_that_promises_clearly_more(
    promise: float, reached: float, kept: float
) -> None:
    """An optimum with the smear alone, 20 below the refit with smear and veil, by a score test of the veil."""
    first = end_with(VEILED | SMEAR, 0.1, -10.0)
    smeared = calling_for("veil", promise, end_with(SMEAR, 0.0, -30.0))
    search = Played({0: first})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: end_with(VEILED, 0.1, -40.0)}, VEILED, VEILED | SMEAR)
    search.ends = {0: replace(first, log_likelihood=reached)}
    for _ in range(2):
        ends = refits({0: smeared}, SMEAR, VEILED | SMEAR)
        assert ends[0].log_likelihood == kept
    again = promise > 20.0 + SETTINGS.clear_gain
    assert len(search.turns) == (1 + again)
    if again:
        np.testing.assert_allclose(search.begun, smeared.state.waves)


def test_a_refit_is_made_again_from_the_likeliest_optimum_that_promises_more() -> None:
    """A far optimum promises more yet, which no score tells; a likelier one, with a part besides, promises nothing."""
    kept = end_with(VEILED | SMEAR, 0.1, -50.0)
    search = Played({0: kept})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: end_with(VEILED, 0.1, -60.0)}, VEILED, VEILED | SMEAR)
    near = calling_for("veil", 20.0, end_with(SMEAR, 0.2, -45.0))
    far = calling_for("veil", 9000.0, end_with(SMEAR | DIFFUSE, 0.3, -1000.0))
    numbers = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    richer = end_with(VEILED | SMEAR | OBSTRUCTED, 0.4, -40.0, numbers)
    refits.made[SMEAR | DIFFUSE] = {0: far}
    refits.made[VEILED | SMEAR | OBSTRUCTED] = {0: richer}
    refits({0: near}, SMEAR, VEILED | SMEAR)
    np.testing.assert_allclose(search.begun, near.state.waves)


def test_a_present_optimum_with_the_choice_is_no_reason_for_a_refit() -> None:
    present = end_with(SMEAR, 0.0, 0.0)
    search = Played({})
    refits = Refits(cast(Searches, search), PLAN)
    assert refits({0: present}, SMEAR, SMEAR) == {0: present}
    assert search.turns == []


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
    oval = fits_behind(OVAL, 0.0)[0]
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
    ovals = fits_behind(OVAL, 0.0, 1.0)
    far = max(ovals, key=lambda k: abs(ovals[k].waves[0]))
    search = Cut({})
    refits = Refits(cast(Searches, search), PLAN)
    ends = refits(ovals, UNEVEN, EYE)
    tried, later = search.turns[:4], search.turns[4:]
    assert [list(one) for one in tried] == [[far]] * 4
    eyes = np.array([one[far][0].parts[0].values for one in tried])
    # small and large circles, on either side
    assert eyes[:, 2].round(1).tolist() == pytest.approx([-0.2, 0.0, 0.1, 0.1])
    assert np.sign(eyes[:, 0]).tolist() == [-1, 1, 1, -1]
    assert [list(one) for one in later] == [[1 - far]] * 4
    assert search.at_once == [4, 4]
    optics, guess = later[1][1 - far]
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
    ovals = fits_behind(OVAL, 0.0, 1.0, 0.1, 0.2)
    search = Misled({}, observations=observations() * 2)
    refits = Refits(cast(Searches, search), PLAN)
    first = refits({k: ovals[k] for k in (0, FAR, 2)}, UNEVEN, EYE)
    assert all(end.optics.parts[0].values[0] > 0 for end in first.values())
    before = len(search.turns)
    later = refits({3: ovals[3]}, UNEVEN, EYE)
    assert len(search.turns) == before + 1
    assert later[3].optics.parts[0].values[0] > 0


class Promising(Cut):
    """The same, but the pupil has blades too, which fits on the right side call for; before, the wrong side explains more."""

    def __init__(self, more: float) -> None:
        super().__init__({}, observations=observations() * 2)
        self.more = more

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        end = super().end(k, optics, guess)
        wrong = optics.parts[0].values[0] < 0
        height = -100.0 + (self.more if wrong else 0.0)
        height += float(np.log(abs(end.waves[1])))  # as plausible as the other side's modes
        end = replace(end, log_likelihood=height)
        return calling_for("blades_7", 5.0 if wrong else 35.0, end)


@pytest.mark.parametrize(("more", "side"), [(1.0, 1), (2.0, -1)])
def test_of_two_sides_that_explain_alike_the_one_that_calls_for_blades_is_kept(
    more: float, side: int
) -> None:
    """more: what the wrong side explains more in each of three fits; 4.5 in all would be clear."""
    ovals = fits_behind(OVAL, 0.0, 1.0, 0.1)
    ends = Refits(cast(Searches, Promising(more)), PLAN)(ovals, UNEVEN, EYE)
    assert all(np.sign(end.optics.parts[0].values[0]) == side for end in ends.values())


class Stopped(Played):
    """Searches for an obstructed pupil: climbs from a cone narrower than the stated one end in a lesser optimum."""

    def end(self, k: int, optics: Optics, guess: Guesses) -> Optimum:
        slow = optics.f_number > 1.2 * PLAN.lens.f_number
        assert guess.state is not None
        return replace(
            end_with(NONE, 0.0, -99.0 if slow else 0.0),
            optics=optics,
            state=guess.state,
        )


def slow_fits(slower: float) -> dict[int, Optimum]:
    """Two fits whose cones are narrower than the stated one."""
    fits = {}
    for k, off in enumerate((0.0, 1.0)):
        clear = end_with(NONE, off, 0.0)
        cone = (slower + 0.01 * k) * PLAN.lens.f_number
        fits[k] = replace(clear, optics=replace(clear.optics, f_number=cone))
    return fits


def test_an_obstruction_begins_at_the_stated_cone_too_where_fits_are_far_from_it() -> None:
    slow = slow_fits(1.5)
    far = max(slow, key=lambda k: abs(slow[k].waves[0]))
    search = Stopped({})
    ends = Refits(cast(Searches, search), PLAN)(slow, NONE, OBSTRUCTED)
    begun = [turn[far] for turn in search.turns[:2]]
    cones = [optics.f_number for optics, _ in begun]
    assert cones == pytest.approx([slow[far].optics.f_number, PLAN.lens.f_number])
    waves = [guess.state.waves for _, guess in begun if guess.state is not None]
    rays = [cone * one for cone, one in zip(cones, waves, strict=True)]
    np.testing.assert_allclose(rays[0], rays[1], rtol=1e-12)
    there = slow[1 - far].optics.f_number / slow[far].optics.f_number
    assert ends[1 - far].optics.f_number == pytest.approx(there * PLAN.lens.f_number)


def test_an_obstruction_begins_at_the_fits_cone_alone_where_it_is_the_stated_one() -> None:
    search = Stopped({})
    near = slow_fits(1.05)
    Refits(cast(Searches, search), PLAN)(near, NONE, OBSTRUCTED)
    (turn,) = search.turns
    begun = [turn[k][0].f_number for k in turn]
    assert begun == pytest.approx([near[k].optics.f_number for k in near])


def test_an_eye_begins_from_a_rim_rather_than_from_likelier_blades() -> None:
    """Where a fit shows the cut, four circles like it begin; where none does, eight on all sides."""
    round_one, bladed = end_with(NONE, 0.0, -100.0), end_with(BLADES, 0.0, 10.0)
    oval = fits_behind(OVAL, 0.0)[0]
    search = Played({0: bladed})
    refits = Refits(cast(Searches, search), PLAN)
    refits({0: round_one}, NONE, BLADES)
    search.ends = {0: oval}
    refits({0: round_one}, NONE, UNEVEN)
    refits({0: round_one}, NONE, EYE)
    assert len(search.turns[2:]) == 4


def test_behind_a_cats_eye_blades_of_odd_number_begin_with_the_circle_opposite_too() -> (
    None
):
    eye = KNOWN["cats_eye"].at([-0.3, 0.1, 0.05])
    cut = fits_behind(eye, 0.0, 1.0)
    far = max(cut, key=lambda k: abs(cut[k].waves[0]))
    search = Cut({})
    refits = Refits(cast(Searches, search), PLAN)
    ends = refits(cut, EYE, EYE | BLADES)
    eyes = [(k, turn[k][0].parts[-1].values) for turn in search.turns for k in turn]
    sides = [(-0.3, 0.1, 0.05), (0.3, -0.1, 0.05)]
    # the other fit begins on the side of the one that shows the pupil best
    assert eyes == [(k, side) for k in (far, 1 - far) for side in sides]
    assert {end.optics.parts[-1].values for end in ends.values()} == {sides[1]}
    refits(cut, EYE, EYE | {"blades_6"})
    assert len(search.turns) == 5


def test_a_refit_that_was_made_from_the_same_optimum_is_not_made_again() -> None:
    search = Played({0: end_with(SMEAR, 0.0, 0.0)})
    refits = Refits(cast(Searches, search), PLAN)
    missed = end_with(NONE, 0.1, -100.0)
    first = refits({0: missed}, NONE, SMEAR)
    assert refits({0: missed}, NONE, SMEAR) == first
    assert len(search.turns) == 1
