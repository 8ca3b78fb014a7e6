"""Which optimum, with which sign, and whether it belongs: chosen among made-up Gaussians whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.estimation.candidate import Candidate, Observed
from labkit.estimation.laws import WAVELENGTH, WORKING_F_NUMBER
from labkit.estimation.lens_fit import LensFit, fit_lens
from labkit.estimation.lens_model import LensModel
from labkit.estimation.select import Options, Selection, _Choices, select
from labkit.key import Key
from labkit.types import Bools, Floats, Indices
from labkit.uncertain import Uncertain
from tests.lens_samples import (
    COLOURS,
    best_focus,
    laws,
    measured,
    measured_of,
    members,
    moved,
    over_the_field,
    reading,
    stated,
    turned,
    with_values,
)

MODES = {6: 0.02, 7: 0.03, 11: -0.04}
RANGES = (1900.0, 1980.0, 2060.0, 2140.0, 2220.0)
PLAN = stated(70.0, 2.8)


def session(
    channels: str = "RGB", ranges: Sequence[float] = RANGES, focus_mm: float = 2050.0
) -> list[Observed]:
    """70 mm f/2.8 with some astigmatism, coma and spherical aberration, each fit with errors as it says."""
    rng = np.random.default_rng(5)
    every = [
        one
        for one in members(ranges, focus_mm, 70.0, 2.8, 0.985, modes=MODES)
        if one.reading.key.channel in channels
    ]
    drawn = [
        rng.multivariate_normal(measured_of(one).values, measured_of(one).covariance)
        for one in every
    ]
    return [with_values(one, values) for one, values in zip(every, drawn, strict=True)]


def chosen(selection: Selection) -> Floats:
    """(n, values) of the chosen candidates, with their signs."""
    n = len(selection.observed)
    return np.array([selection.candidate(k).measured.values for k in range(n)])


def open_channels(selection: Selection) -> set[str]:
    """Channels with an observation whose sign is open."""
    places = np.flatnonzero(selection.open_signs)
    return {selection.observed[k].reading.key.channel for k in places}


def true(every: Sequence[Observed]) -> Floats:
    return np.array([measured_of(one).values for one in every])


def keys(every: Sequence[Observed], *places: int) -> list[Key]:
    return [every[k].reading.key for k in places]


# signs


@pytest.mark.parametrize("seed", range(6))
def test_signs_undo_a_random_choice_of_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.sort(rng.uniform(1900, 2200, 5)).tolist()
    every = session("GR", ranges, float(rng.uniform(1950, 2150)))
    flips = rng.choice([True, False], len(every))
    selection = select(
        [turned(one) if flip else one for one, flip in zip(every, flips, strict=True)], PLAN
    )
    np.testing.assert_allclose(chosen(selection), true(every))
    assert selection.members.all()
    assert not open_channels(selection)


def test_a_twin_has_its_even_modes_reversed() -> None:
    one = measured_of(session("G")[0])
    np.testing.assert_allclose(one.twin().values / one.values, [-1, -1, 1, -1, 1, 1])
    # defocus and the cone go together: with the sign of defocus
    assert one.twin().covariance[0, 4] == -one.covariance[0, 4] != 0
    np.testing.assert_array_equal(one.twin().twin().covariance, one.covariance)


def test_among_the_options_a_twin_has_the_covariance_of_its_signs() -> None:
    every = session("G")
    model = LensModel(
        tuple(one.reading for one in every), measured_of(every[0]).noll, (), PLAN
    )
    options = Options.of(every, model)
    for k, one in enumerate(every):
        for place, of in enumerate((measured_of(one), measured_of(one).twin())):
            np.testing.assert_array_equal(options.values[k, place], of.values)
            np.testing.assert_array_equal(options.covariance[k, place], of.covariance)


def test_all_ranges_on_one_side_of_focus_still_tell_it() -> None:
    every = session("G", (2100.0, 2200.0, 2300.0), 2000.0)
    selection = select([turned(one) for one in every], PLAN)
    np.testing.assert_allclose(chosen(selection), true(every))
    assert not open_channels(selection)


def test_one_range_leaves_the_sign_open() -> None:
    assert select(session("GR", (2100.0,), 2000.0), PLAN).open_signs.all()


def test_a_colour_of_one_range_leaves_the_signs_of_others_determined() -> None:
    every = [*session("R", (2140.0,)), *session("G")]
    assert not select(every, PLAN).open_signs[1:].any()


def test_ranges_too_close_together_leave_the_sign_open() -> None:
    every = session("GR", (30_000.0, 30_001.0), 28_000.0)
    assert open_channels(select(every, PLAN)) == {"R", "G"}


def test_at_one_range_colours_are_turned_alike() -> None:
    every = session("GR", (2100.0,), 2000.0)
    values = chosen(select([every[0], turned(every[1])], PLAN))
    assert np.sign(values[0, 0]) == np.sign(values[1, 0])


def test_a_colour_of_one_range_is_turned_as_another_is_there() -> None:
    red, green = session("R", (2140.0,)), session("G")
    every = [turned(red[0]), *green]
    np.testing.assert_allclose(chosen(select(every, PLAN)), true([*red, *green]))


# candidates


def with_likelier(one: Observed, waves: float, gain: float = 6.0) -> Observed:
    """The observation with a wrong optimum, elsewhere in every mode, that is likelier than the right one."""
    wrong = measured_of(moved(one, waves, modes=-waves))
    return replace(one, candidates=(Candidate(wrong, gain), *one.candidates))


def test_the_right_candidate_is_chosen_though_wrong_ones_are_likelier() -> None:
    every = session()
    wrong = {1: 0.09, 7: -0.06, 12: 0.3}
    selection = select(
        [
            with_likelier(one, wrong[k]) if k in wrong else one
            for k, one in enumerate(every)
        ],
        PLAN,
    )
    np.testing.assert_allclose(chosen(selection), true(every))
    assert selection.members.all()
    assert [int(selection.choice[k]) // 2 for k in range(15)] == [
        int(k in wrong) for k in range(15)
    ]


def test_the_likelier_of_two_candidates_that_the_session_allows_is_chosen() -> None:
    every = session()
    others = [
        replace(one, candidates=(*one.candidates, Candidate(measured_of(one), 1.0)))
        for one in every
    ]
    assert set(select(others, PLAN).choice // 2) == {1}


def test_the_penalised_likelihood_never_falls_from_round_to_round(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    every = [
        with_likelier(one, 0.1 + 0.02 * k) if k % 4 == 0 else one
        for k, one in enumerate(session("GR"))
    ]
    every[7] = moved(every[7], 0.5)
    proposals, heights = _Choices._proposals, list[float]()

    def noted(
        self: _Choices, lens: LensFit, choice: Indices, members: Bools
    ) -> tuple[Indices, Floats]:
        heights.append(self.fit(choice, members)[1])
        return proposals(self, lens, choice, members)

    monkeypatch.setattr(_Choices, "_proposals", noted)
    reached = select(every, PLAN).objective
    assert len(heights) > 2
    assert np.all(np.diff(heights) > 0)
    assert heights[-1] == pytest.approx(reached)
    assert heights[1] - heights[0] > 1000


def test_a_change_that_would_lower_the_likelihood_is_not_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def twins(
        self: _Choices, lens: LensFit, choice: Indices, members: Bools
    ) -> tuple[Indices, Floats]:
        return choice ^ 1, np.ones(len(choice))

    every = session()
    right = select(every, PLAN)
    monkeypatch.setattr(_Choices, "_proposals", twins)
    again = select(every, PLAN)
    assert again.objective == right.objective
    np.testing.assert_array_equal(again.choice, right.choice)


# observations that do not belong


def test_a_wrong_optimum_is_named_and_no_other() -> None:
    every = session()
    assert select(every, PLAN).outliers == []
    selection = select(
        [moved(one, 0.09) if k == 7 else one for k, one in enumerate(every)], PLAN
    )  # physics.md §15
    assert selection.outliers == keys(every, 7)
    focus = best_focus(selection.lens, every[7].reading.key.channel)
    assert focus.value == pytest.approx(2050.0, abs=4 * focus.std)


def test_a_few_wrong_optima_cost_no_law() -> None:
    for wrong in ([7], [7, 11]):
        off = [
            moved(one, 0.02, modes=-0.05) if k in wrong else one
            for k, one in enumerate(session())
        ]
        selection = select(off, PLAN)
        assert selection.outliers == keys(off, *wrong)
        assert selection.lens.model.laws.shared
        assert selection.lens.model.laws.paraxial
        assert selection.lens.p_value > 0.1


def test_of_two_camps_that_contradict_each_other_one_is_named_by_its_keys() -> None:
    """The lens was focused anew after some of the ranges: defocus follows one focus or another."""
    first, last = session("G", RANGES[:3]), session("G", RANGES[3:], 2090.0)
    selection = select([*first, *last], PLAN)
    outliers = set(selection.outliers)
    assert outliers in (
        {one.reading.key for one in first},
        {one.reading.key for one in last},
    )


def test_where_everyone_belongs_none_is_left_out_whatever_that_costs() -> None:
    every = [moved(one, 0.09) if k == 7 else one for k, one in enumerate(session())]
    selection = select(every, PLAN, everyone=True)
    assert selection.members.all()
    assert selection.lens.birge_ratio > 3
    assert selection.lens.model.laws.paraxial


def test_what_is_not_fitted_is_predicted() -> None:
    every = session()
    blind = [replace(one, candidates=()) if k == 7 else one for k, one in enumerate(every)]
    selection = select(blind, PLAN)
    assert selection.outliers == []
    predicted, covariance = selection.lens.predictions
    noise = covariance[7] + measured_of(every[7]).covariance
    off = predicted[7] - measured_of(every[7]).values
    assert off @ np.linalg.solve(noise, off) < 25  # chi-squared of six


def test_a_key_that_is_there_twice_is_named() -> None:
    every = session("G")
    with pytest.raises(ValueError, match="2060_G: observed twice"):
        select([*every, every[2]], PLAN)


def test_a_session_without_a_candidate_is_refused() -> None:
    with pytest.raises(ValueError, match="no observation has a candidate"):
        select([Observed(reading(2000.0, "G"))], PLAN)


# laws


def test_a_cone_of_another_lens_is_not_believed() -> None:
    ranges = np.linspace(470.0, 494.0, 5).tolist()
    exact: dict[str, Any] = {
        "focal_length": Uncertain(60.0, 1e-9, "mm"),
        "f_number": Uncertain(4.0, 0.002),
    }
    every, plan = (
        members(ranges, 482.0, 60.0, 4.0),
        stated(60.0, 4.0, **exact, range_zero_std_mm=0.1),
    )
    assert select(every, plan).lens.model.laws.paraxial
    slow = [moved(one, -0.04 * measured_of(one).values[0], 0.04) for one in every]
    mistaken = select(slow, plan).lens.model.laws.mistaken
    assert mistaken == (WAVELENGTH, ())  # of all colours: it looks the same
    breathing = [
        with_values(one, measured_of(one).values + np.array([0.0, 0.0, size]))
        for one, size in zip(
            slow, np.repeat([1e-3, -1e-3, 1e-3, -1e-3, 1e-3], 3), strict=True
        )
    ]
    selection = select(breathing, plan)
    assert selection.outliers == []
    assert not selection.lens.model.laws.paraxial
    # without sizes the pupils take a part of it upon them: 0.020 is left
    assert 0.01 < selection.lens.value(WORKING_F_NUMBER) < 0.04
    assert best_focus(selection.lens, "G").value == pytest.approx(482.0, abs=0.01)


def test_modes_that_change_from_range_to_range_are_not_held_to_be_the_same() -> None:
    every = session()
    assert select(every, PLAN).lens.model.laws.shared
    drifting = [moved(one, modes=1e-4 * (one.reading.range_mm - 2060.0)) for one in every]
    selection = select(drifting, PLAN)
    assert selection.outliers == []
    assert (
        selection.lens.model.laws.mode_scatter == 0.01
    )  # half decades: the drift is 0.011 RMS
    assert selection.lens.model.laws.paraxial


# scale


def tiles(side: int, rng: np.random.Generator) -> list[Observed]:
    """Three ranges and colours of tiles, whose defocus and modes are polynomials of the place."""
    every = []
    for tile in np.ndindex(side, side):
        for c in COLOURS:
            for r in RANGES[::2]:
                at = reading(r, c, tile, (side, side))
                field = over_the_field(np.random.default_rng(3), (4, *MODES), at.place)
                values = np.array(laws(r, 2060.0, 2060.0, 70.0, 2.8, 0.985))
                values[0] += field.pop(4)
                of = measured(values, field)
                drawn = replace(
                    of, values=rng.multivariate_normal(of.values, of.covariance)
                )
                every.append(Observed(at, (Candidate(drawn),)))
    return every


def test_among_tiles_every_wrong_optimum_is_named() -> None:
    """200 tiles, and one fit in twenty is wrong: two of a tile's three ranges are right."""
    rng = np.random.default_rng(7)
    every = tiles(14, rng)
    at = rng.choice(len(every) // 3, len(every) // 20, replace=False)
    wrong = {int(3 * group + rng.integers(3)): rng.normal(0, 0.3, 2) for group in at}
    off = [
        moved(one, wrong[k][0], modes=0.05 + abs(wrong[k][1])) if k in wrong else one
        for k, one in enumerate(every)
    ]
    selection = select([turned(one) if rng.random() < 0.5 else one for one in off], PLAN)
    assert sorted(selection.outliers) == sorted(keys(every, *wrong))


def test_signs_are_tested_only_if_they_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lenses = 0

    def counted(*arguments: Any) -> LensFit:
        nonlocal lenses
        lenses += 1
        return fit_lens(*arguments)

    monkeypatch.setattr("labkit.estimation.select.fit_lens", counted)
    selection = select(session("G"), PLAN)
    chosen = lenses
    assert not selection.open_signs.any()
    assert lenses > chosen
