"""Which camera parts a session takes in: those that its fits need, by what they say and by climbs that are played."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from labkit.estimation.camera import (
    CameraChoice,
    Parts,
    cost,
)
from labkit.estimation.local import Optimum
from labkit.estimation.scores import ScoreTest
from labkit.estimation.stated import optics_of
from labkit.results.model import PartTried
from tests.optimum_samples import PLAN, optimum

OPTICS = optics_of(PLAN, "G")
FITS = 5


def score_test(gain: float, sign: float = 1.0) -> ScoreTest:
    """For one number that is called for, or for one that no camera has."""
    return ScoreTest(np.array([sign * np.sqrt(2 * gain)]), np.eye(1))


def with_scores(**gains: float) -> Optimum:
    return optimum(
        OPTICS, 3200.0, scores={name: score_test(gain) for name, gain in gains.items()}
    )


@dataclass
class Fits:
    """Five fits whose likelihoods are known with every choice of parts.

    Attributes
    ----------
    heights : log-likelihood of each, by its parts, in any order; 0 for others
    called : what each fit's score tests promise for parts that it lacks
    squares : numbers of its parts, 0.5 for others
    unexplained : log-likelihood that each fit's residuals lack; 0 where they are noise
    explaining : parts with which residuals are noise
    refits : what was climbed
    """

    heights: Mapping[tuple[str, ...], float]
    called: Mapping[str, float]
    squares: Mapping[str, float] = field(default_factory=dict)
    unexplained: float = 0.0
    explaining: Parts | None = None
    refits: list[tuple[int, Parts]] = field(default_factory=list)

    def end(self, parts: Parts) -> Optimum:
        optics = OPTICS.with_parts(parts)
        height = next(
            (of for names, of in self.heights.items() if Parts(names) == parts), 0.0
        )
        scores = {
            name: score_test(gain)
            for name, gain in self.called.items()
            if name not in parts
        }
        lacking = max(self.unexplained - height, 0.0)
        explained = self.unexplained == 0.0 or parts == self.explaining
        made = optimum(
            optics,
            3200.0,
            square=0.5,
            height=height,
            scores=scores,
            explained=explained,
            unexplained=lacking,
        )
        values = made.measured.values.copy()
        for k, label in enumerate(optics.camera_labels, 2):
            values[k] = self.squares.get(label.split(".")[0], 0.5)
        return replace(made, measured=replace(made.measured, values=values))

    def refit(self, places: Sequence[int], parts: Parts) -> dict[int, Optimum]:
        self.refits.append((len(places), parts))
        return {k: self.end(parts) for k in places}

    def chosen(self, *wanted: str) -> tuple[set[str], CameraChoice]:
        choice = CameraChoice(self.refit, Parts(wanted), ["G"] * FITS)
        ends = {k: self.end(Parts()) for k in range(FITS)}
        return set(choice.chosen(ends, Parts())), choice


# choices


def test_a_part_that_the_fits_need_is_taken_in() -> None:
    fits = Fits({("smear",): 100.0}, {"smear": 40.0})
    names, choice = fits.chosen()
    assert names == {"smear"}
    assert choice.missing == ()
    # all fits have the same numbers
    assert choice.tried == [PartTried("smear", 500.0, adopted=True)]


def test_the_fits_that_show_most_of_a_part_decide_before_all_others_are_climbed() -> None:
    fits = Fits({("smear",): 100.0, ("veil",): -1.0}, {"smear": 40.0, "veil": 50.0})
    fits.chosen()
    assert fits.refits[:3] == [
        (3, Parts(["veil"])),
        (3, Parts(["smear"])),
        (2, Parts(["smear"])),
    ]


@pytest.mark.parametrize(("gain", "taken"), [(9.0, set()), (11.0, {"diffusion"})])
def test_a_part_that_gains_less_than_it_costs_is_not_taken_in(
    gain: float, taken: set[str]
) -> None:
    price = cost(Parts(["diffusion"]))
    # the three fits that show most of it decide first: they alone must gain its price
    fits = Fits({("diffusion",): gain * price / 30}, {"diffusion": 10.0})
    assert fits.chosen()[0] == taken


def test_modes_that_gain_what_chance_gives_to_each_fit_are_not_taken_in() -> None:
    """Five fits gain 3.5 each, 17.5 together, which is more than six numbers cost."""
    group = Parts(["modes_16_21"])
    assert 5 * 3.5 > cost(group) > 5 * 3.5 - 4 * 3.0
    names, _ = Fits({("modes_16_21",): 3.5}, {"modes_16_21": 4.0}).chosen()
    assert not names


def test_a_part_that_the_fits_do_not_call_for_is_not_climbed_with() -> None:
    fits = Fits({("veil",): 100.0}, {"veil": 1.9})  # five of them promise 9.5
    names, choice = fits.chosen()
    assert names == set()
    assert fits.refits == []
    (tried,) = choice.tried
    assert tried.gain == pytest.approx(9.5)
    assert not tried.adopted


def test_a_commoner_part_takes_the_place_of_one_that_explains_no_more() -> None:
    fits = Fits(
        {("smear",): 100.0, ("low_pass_filter",): 99.5},
        {"smear": 40.0, "low_pass_filter": 30.0},
    )
    assert fits.chosen()[0] == {"low_pass_filter"}
    fits = Fits(
        {("smear",): 100.0, ("low_pass_filter",): 90.0},
        {"smear": 40.0, "low_pass_filter": 30.0},
    )
    assert fits.chosen()[0] == {"smear"}


def test_a_cats_eye_takes_the_place_of_an_uneven_rim_that_explains_less() -> None:
    heights: dict[tuple[str, ...], float] = {("uneven_rim",): 100.0, ("cats_eye",): 150.0}
    assert Fits(heights, {"uneven_rim": 60.0}).chosen()[0] == {"cats_eye"}
    heights = {("uneven_rim",): 100.0, ("cats_eye",): 90.0}
    assert Fits(heights, {"uneven_rim": 60.0}).chosen()[0] == {"uneven_rim"}


class BladesBehindAnEye(Fits):
    """Fits whose scores show seven blades only once the model has the cat's eye in front of them."""

    def end(self, parts: Parts) -> Optimum:
        end = super().end(parts)
        if parts != Parts({"cats_eye"}):
            return end
        return replace(end, scores={**end.scores, "blades_7": score_test(40.0)})


@pytest.mark.parametrize(
    ("height", "taken"), [(180.0, {"cats_eye", "blades_7"}), (95.0, {"uneven_rim"})]
)
def test_a_cats_eye_is_compared_with_the_blades_that_its_own_fits_call_for(
    height: float, taken: set[str]
) -> None:
    """Alone it explains less than an uneven rim that stands for both."""
    heights: dict[tuple[str, ...], float] = {
        ("uneven_rim",): 100.0,
        ("cats_eye",): 90.0,
        ("cats_eye", "blades_7"): height,
    }
    assert BladesBehindAnEye(heights, {"uneven_rim": 60.0}).chosen()[0] == taken


def test_a_cats_eye_that_a_fit_does_not_need_is_taken_out_whatever_its_numbers() -> None:
    """The first fits without it were wrong; refits from the optima that it led to are as likely without it."""
    fits = Fits({("uneven_rim",): 100.0, ("cats_eye",): 150.0}, {"uneven_rim": 60.0})

    def refit(places: Sequence[int], parts: Parts) -> dict[int, Optimum]:
        fits.heights = {**fits.heights, (): 149.0}
        return fits.refit(places, parts)

    ends = {k: fits.end(Parts()) for k in range(FITS)}
    assert CameraChoice(refit, Parts(), ["G"] * FITS).chosen(ends, Parts()) == set()


@pytest.mark.parametrize(
    ("together", "taken"), [(103.5, {"low_pass_filter", "diffusion"}), (103.0, {"smear"})]
)
def test_two_commoner_parts_take_the_place_of_one_where_they_explain_more(
    together: float, taken: set[str]
) -> None:
    """They cost 10 more, which the three fits that show most of them must gain; neither explains as much alone."""
    heights = {
        ("low_pass_filter",): 90.0,
        ("diffusion",): 80.0,
        ("smear",): 100.0,
        ("low_pass_filter", "diffusion"): together,
    }
    fits = Fits(heights, {"smear": 40.0, "low_pass_filter": 30.0, "diffusion": 30.0})
    assert fits.chosen()[0] == taken


def test_a_part_is_held_against_commoner_ones_again_when_another_was_taken_in() -> None:
    """Without the veil a smear explains more than a filter with diffusion does."""
    heights = {
        ("smear",): 100.0,
        ("smear", "veil"): 200.0,
        ("low_pass_filter", "diffusion"): 99.0,
        ("veil", "low_pass_filter", "diffusion"): 250.0,
    }
    called = {"smear": 100.0, "veil": 40.0, "low_pass_filter": 1.0, "diffusion": 1.0}
    assert Fits(heights, called).chosen()[0] == {"veil", "low_pass_filter", "diffusion"}


def test_a_part_that_has_nothing_left_to_do_is_taken_out() -> None:
    """A smear explains most until the veil is there, with which its numbers are within their errors."""
    heights = {("smear",): 100.0, ("smear", "veil"): 200.0, ("veil",): 199.0}
    fits = Fits(heights, {"smear": 100.0, "veil": 40.0}, squares={"smear": 0.005})
    assert fits.chosen()[0] == {"veil"}


def test_one_fit_that_needs_a_part_keeps_it_in() -> None:
    fits, eye = Fits(heights={("cats_eye",): 50.0}, called={}), Parts(["cats_eye"])
    ends = {k: fits.end(eye) for k in range(FITS)}
    assert CameraChoice(fits.refit, Parts(), ["G"] * FITS).chosen(ends, eye) == eye
    assert fits.refits == [(1, Parts())]


def test_a_part_that_explains_too_little_is_named_as_missing() -> None:
    """Residuals lack 1000 of each fit's log-likelihood: a part that gains less than a quarter stands for another lack."""
    fits = Fits({("smear",): 200.0}, {"smear": 300.0}, unexplained=1000.0)
    names, choice = fits.chosen()
    assert names == set()
    assert choice.missing == ("smear",)
    assert [fit.optics.parts[0].name for fit in choice.with_missing.values()] == [
        "smear"
    ] * FITS


def test_a_part_that_was_missing_before_another_was_taken_in_is_not_named() -> None:
    """Its fits lack what was taken in: with other modes they cannot be compared."""
    fits = Fits({("smear",): 200.0}, {"smear": 300.0}, unexplained=1000.0)
    choice = fits.chosen()[1]
    later = Fits({("modes_16_21",): 900.0}, {"modes_16_21": 900.0}, unexplained=1000.0)
    choice.refit = later.refit
    ends = {k: later.end(Parts()) for k in range(FITS)}
    before = choice.missing
    assert before == ("smear",)
    assert choice.chosen(ends, Parts()) == {"modes_16_21"}
    assert choice.missing == ()
    assert choice.with_missing == {}


def test_an_obstruction_that_explains_too_little_is_not_named() -> None:
    """It is fitted whatever its score promises; another part that promised as little would not be."""
    fits = Fits({("obstruction",): 200.0}, {"obstruction": 40.0}, unexplained=1000.0)
    names, choice = fits.chosen()
    assert fits.refits[-1] == (FITS - 3, Parts(["obstruction"]))
    assert names == set()
    assert choice.missing == ()


def test_a_part_that_explains_a_fair_share_of_what_is_left_is_taken_in() -> None:
    names, choice = Fits({("smear",): 300.0}, {"smear": 300.0}, unexplained=1000.0).chosen()
    assert names == {"smear"}
    assert choice.missing == ()


def test_a_part_that_the_plan_wants_is_not_asked_for_again() -> None:
    fits = Fits({("smear",): 100.0}, {"smear": 40.0})
    assert fits.chosen("smear")[0] == set()
    assert fits.refits == []


def test_a_choice_that_was_refused_is_not_climbed_with_again() -> None:
    """A veil alone gains nothing; once the smear is there it does, and leaves the smear nothing to do."""
    heights = {("veil",): -1.0, ("smear",): 100.0, ("smear", "veil"): 200.0}
    fits = Fits(heights, {"veil": 100.0, "smear": 40.0}, squares={"smear": 0.005})
    assert fits.chosen()[0] == {"smear", "veil"}
    assert [parts for _, parts in fits.refits].count(Parts(["veil"])) == 1


def test_a_part_that_explains_fits_is_taken_in_whatever_its_share() -> None:
    """Residuals with it are noise alone."""
    fits = Fits(
        {("smear",): 200.0},
        {"smear": 300.0},
        unexplained=1000.0,
        explaining=Parts(["smear"]),
    )
    assert fits.chosen()[0] == {"smear"}


def test_a_fit_whose_climb_is_lost_stays_as_it_was() -> None:
    fits = Fits({("smear",): 100.0}, {"smear": 40.0})

    def refit(places: Sequence[int], parts: Parts) -> dict[int, Optimum]:
        return {k: fit for k, fit in fits.refit(places, parts).items() if k != 4}

    choice = CameraChoice(refit, Parts(), ["G"] * FITS)
    ends = {k: fits.end(Parts()) for k in range(FITS)}
    assert choice.chosen(ends, Parts()) == {"smear"}
    assert choice.tried == [PartTried("smear", 400.0, adopted=True)]


def test_an_obstruction_is_tried_by_a_fit_where_its_score_promises_little() -> None:
    fits = Fits(
        heights={("obstruction",): 990.0, ("veil",): 300.0},
        called={"veil": 300.0, "obstruction": 40.0},
        unexplained=1000.0,
        explaining=Parts(["obstruction"]),
    )
    parts, _ = fits.chosen()
    assert parts == {"obstruction"}
    # it comes first, and a veil is not fitted in its place
    assert fits.refits[0][1] == Parts(["obstruction"])


@pytest.mark.parametrize(("promised", "first"), [(700.0, "obstruction"), (800.0, "veil")])
def test_what_promises_nearly_all_comes_before_an_obstruction(
    promised: float, first: str
) -> None:
    fits = Fits(
        heights={("obstruction",): 100.0, ("veil",): 990.0},
        called={"veil": promised, "obstruction": 20.0},
        unexplained=1000.0,
        explaining=Parts(["veil"]),
    )
    parts, _ = fits.chosen()
    assert parts == {"veil"}
    assert fits.refits[0][1] == Parts([first])


def test_where_fits_are_explained_an_obstruction_needs_a_score_as_others_do() -> None:
    fits = Fits(heights={("obstruction",): 3.0}, called={"obstruction": 1.0})
    assert fits.chosen()[0] == set()
    assert fits.refits == []


# numbers of blades


@dataclass
class Misled(Fits):
    """Fits that call for six blades as long as their model lacks the rest of the rim, and then for seven."""

    def end(self, parts: Parts) -> Optimum:
        rest = "uneven_rim" in parts
        called = {"blades_7": 60.0, "blades_6": 5.0} if rest else self.called
        return Fits(self.heights, called).end(parts)


def test_the_number_of_blades_is_asked_again_with_the_rest_of_the_rim() -> None:
    fits = Misled(
        {
            ("blades_6",): 30.0,
            ("uneven_rim",): 25.0,
            ("blades_6", "uneven_rim"): 60.0,
            ("blades_7", "uneven_rim"): 90.0,
        },
        {"blades_6": 40.0, "uneven_rim": 30.0, "blades_7": 5.0},
    )
    chosen, _ = fits.chosen()
    assert chosen == {"blades_7", "uneven_rim"}
    asked = [parts for _, parts in fits.refits]
    assert asked.index(Parts({"blades_6"})) < asked.index(Parts({"uneven_rim"}))


def test_a_number_of_blades_that_nothing_contradicts_is_asked_once() -> None:
    fits = Fits({("blades_6",): 30.0}, {"blades_6": 40.0})
    chosen, _ = fits.chosen()
    assert chosen == {"blades_6"}
    assert Parts() not in [parts for _, parts in fits.refits]


@dataclass
class Astray(Fits):
    """Fits that end with cat's eye and blades at a wrong optimum until the eye was fitted alone."""

    def refit(self, places: Sequence[int], parts: Parts) -> dict[int, Optimum]:
        if parts == Parts({"cats_eye"}):
            self.heights = {**self.heights, ("cats_eye", "blades_6"): 70.0}
        return super().refit(places, parts)


def test_a_choice_is_fitted_again_after_fits_without_its_blades() -> None:
    fits = Astray({("cats_eye",): 40.0}, {"blades_6": 20.0})
    both = Parts({"cats_eye", "blades_6"})
    wrong: dict[tuple[str, ...], float] = {("cats_eye", "blades_6"): 60.0}
    ends = {k: Fits(wrong, {}).end(both) for k in range(FITS)}
    choice = CameraChoice(fits.refit, Parts(), ["G"] * FITS)
    assert choice.chosen(ends, both) == both
    alone = [parts for _, parts in fits.refits].index(Parts({"cats_eye"}))
    again = [count for count, parts in fits.refits[alone:] if parts == both]
    assert again == [3, 2]  # all fits


# what a choice promises


@dataclass
class Mimicked(Fits):
    """Fits that modes explain nearly as well as blades do; modes gain beside the blades, and blades do not beside modes."""

    def end(self, parts: Parts) -> Optimum:
        beside = {Parts({"blades_5"}): {"modes_16_21": 150.0}, Parts(): self.called}
        return Fits(
            self.heights,
            beside.get(parts, {}),
            unexplained=self.unexplained,
            explaining=self.explaining,
        ).end(parts)


def test_modes_that_mimic_blades_do_not_keep_them_out() -> None:
    fits = Mimicked(
        {
            ("modes_16_21",): 1000.0,
            ("blades_5",): 950.0,
            ("blades_5", "modes_16_21"): 1100.0,
        },
        {"modes_16_21": 900.0, "blades_5": 800.0},
        unexplained=1100.0,
        explaining=Parts({"blades_5", "modes_16_21"}),
    )
    chosen, _ = fits.chosen()
    assert chosen == {"blades_5", "modes_16_21"}
    asked = [parts for count, parts in fits.refits if count == 2]
    assert asked[0] == Parts({"blades_5"})  # all fits are refitted with the blades first


# unphysical numbers


def test_a_part_with_unphysical_numbers_is_not_taken_in_whatever_it_gains() -> None:
    fits = Fits({("veil",): 30.0}, {"veil": 40.0}, {"veil": -0.5})
    chosen, choice = fits.chosen()
    assert chosen == set()
    # it is a sign of something that the model lacks, and errors have to hold what it moves
    assert choice.missing == ("veil",)


def test_a_part_whose_numbers_became_unphysical_leaves_the_model() -> None:
    fits = Fits({("veil",): 30.0}, {}, {"veil": -0.5})
    choice = CameraChoice(fits.refit, Parts(), ["G"] * FITS)
    ends = {k: fits.end(Parts({"veil"})) for k in range(FITS)}
    assert choice.chosen(ends, Parts({"veil"})) == set()


def test_a_rim_may_have_negative_numbers() -> None:
    fits = Fits({("uneven_rim",): 30.0}, {"uneven_rim": 40.0}, {"uneven_rim": -0.5})
    chosen, _ = fits.chosen()
    assert chosen == {"uneven_rim"}
