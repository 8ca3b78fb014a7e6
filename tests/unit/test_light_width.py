"""How broad the light of a channel may be, from what its fits say of a width that their model lacks. Searches are played."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.analysis.session_parts import widest_light_nm
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Found
from labkit.estimation.scores import ScoreTest
from labkit.estimation.searches import Task
from labkit.plan import Plan
from labkit.spectra import TYPICAL, channel_light
from tests.optimum_samples import PLAN, Play, optimum, played, range_of

STD = 1e-3
"""Of each of four fits, in relative squares."""


def session(square: float, std: float = STD, channels: str = "G") -> Estimate:
    """Four ranges, each of whose fits calls for a relative square of the width."""
    score_test = ScoreTest(np.array([square / std**2]), np.array([[std**-2]]))

    def ends(task: Task) -> Found:
        return Found(
            (optimum(task.optics, range_of(task), scores={"spectrum": score_test}),)
        )

    return played(Play(ends), channels)


def test_the_bound_is_the_ninety_fifth_percentile_of_all_fits_together() -> None:
    drawn = 2e-4 + np.random.default_rng(1).normal(size=10**6) * STD / 2  # of four fits
    bound = widest_light_nm(session(2e-4), PLAN)
    assert bound == {"G": pytest.approx(550 * np.sqrt(np.percentile(drawn, 95)), rel=2e-3)}


def test_light_is_no_narrower_than_one_wavelength() -> None:
    """Where chance would have it so, the bound is that of one wavelength."""
    assert widest_light_nm(session(-1e-3), PLAN) == widest_light_nm(session(0.0), PLAN)


def test_fits_that_say_nothing_allow_what_can_be_modelled() -> None:
    assert widest_light_nm(session(0.0, std=1.0), PLAN) == {"G": pytest.approx(0.08 * 550)}


def test_of_light_that_the_plan_states_nothing_is_said() -> None:
    fits = session(2e-4, channels="GR")
    tables = PLAN.model_dump(mode="json", exclude_none=True)
    stated = [
        channel | ({"width_nm": 12.0} if channel["name"] == "G" else {})
        for channel in tables["channel"]
    ]
    assert [*widest_light_nm(fits, PLAN)] == ["G", "R"]
    assert [*widest_light_nm(fits, Plan.from_tables(tables | {"channel": stated}))] == ["R"]


NAMED = Plan.from_tables(
    {
        **PLAN.model_dump(mode="json", exclude_none=True),
        "channel": [{"name": "G", "light": "led"}],
    }
)


def test_a_named_light_s_width_counts_as_a_measurement() -> None:
    light = channel_light("led", TYPICAL, "G")
    nm, width, std = NAMED.channel[0].wavelength_nm, light.width.value, light.width.std
    square_std = 2 * width * std  # of the squared width
    unheard = widest_light_nm(session(0.0, std=1.0), NAMED)
    alone = np.sqrt(width**2 + 1.645 * square_std)
    assert unheard == {"G": pytest.approx(alone, abs=0.06)}  # limits are to a tenth
    # four fits that call for as much less as the light's own standard error, each with twice that error
    excess = square_std / nm**2
    heard = widest_light_nm(session(-excess, std=2 * excess), NAMED)
    both = width**2 - square_std / 2 + 1.645 * square_std / np.sqrt(2)
    assert heard == {"G": pytest.approx(np.sqrt(both), abs=0.06)}
