"""The modes of a lens: from range to range, from colour to colour, and weak ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.laws import WEAK_MODE, Laws
from labkit.estimation.lens_fit import fit_families, fit_lens
from labkit.types import Floats
from tests.lens_samples import (
    MODE_STD,
    NEAR,
    lens_of,
    measured_of,
    members,
    moved,
    stated,
    with_values,
)


def test_a_mode_that_scatters_is_between_its_measurement_and_the_others() -> None:
    plan, scatter = stated(60.0, 4.0), 2e-3
    of_one_colour = members(NEAR, 482.0, 60.0, 4.0, modes={7: 0.02})[::3]
    every = [moved(one, modes=1e-3 * k) for k, one in enumerate(of_one_colour)]
    fit = lens_of(every, plan, Laws(mode_scatter=scatter))
    common = fit.solved.predicted[4, 1]
    value, covariance = fit.posterior(4)
    share = scatter**2 / (scatter**2 + MODE_STD**2)
    assert value[1] == pytest.approx(common + share * (0.024 - common), abs=1e-9)
    # what the measurement leaves of the scatter, and a share of the common mode's error, of 5 fits
    of_common = (1 - share) ** 2 * (scatter**2 + MODE_STD**2) / 5
    assert covariance[1, 1] == pytest.approx((1 - share) * scatter**2 + of_common, rel=0.01)


@pytest.mark.parametrize(("apart", "gain"), [(0.0, 0.74), (5e-3, 1.0)])
def test_colours_differ_by_as_much_as_the_photographs_tell(
    apart: float, gain: float
) -> None:
    """Modes of an order that all colours share are known better than by one colour, others as well; errors are true."""
    rng, of_colour = np.random.default_rng(5), MODE_STD / np.sqrt(len(NEAR))
    differences = apart * rng.normal(size=(3, 4))
    errors, pulls, chi2 = list[Floats](), list[Floats](), list[float]()
    for _ in range(40):
        every = members(NEAR, 482.0, 60.0, 4.0, modes=dict.fromkeys((7, 8, 9, 10), 0.02))
        noise = MODE_STD * rng.normal(size=(len(every), 4))
        for k, one in enumerate(every):
            values = measured_of(one).values.copy()
            values[1:5] += differences[k % 3] + noise[k]
            every[k] = with_values(one, values)
        fit = lens_of(every, stated(60.0, 4.0))
        chi2.append(fit.chi2)
        for k in range(3):
            value, covariance = fit.posterior(k)
            errors.append(value[1:5] - 0.02 - differences[k])
            pulls.append(errors[-1] / np.sqrt(np.diag(covariance)[1:5]))
    assert np.std(errors) == pytest.approx(gain * of_colour, rel=0.1)
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)
    # of the four modes' values, less four common modes and a standard deviation: all other values have no noise
    assert np.mean(chi2) == pytest.approx(15 * 4 - 5, abs=3)
    others = 15 * 3 - 5
    assert fit.degrees_of_freedom == pytest.approx(15 * 4 - 5 + others, abs=0.1)


def test_a_weak_mode_is_drawn_to_0() -> None:
    """By its own variance, and each colour's difference from the common mode by as much."""
    weak, every = 1e-3, members(NEAR, 482.0, 60.0, 4.0, modes={7: 0.02, 22: 2e-3})
    plain = lens_of(every, stated(60.0, 4.0))
    model = replace(plain.model, weak={22: weak}, spread={})
    fit = fit_lens(model, plain.measured)
    values, covariance = fit.posterior(0)
    # mean of a colour's fits, and of all colours, by their errors and the priors
    of_colour = weak**2 + MODE_STD**2 / len(NEAR)
    share = 3 * weak**2 / (of_colour + 3 * weak**2)
    common = share * 2e-3
    own = weak**2 / of_colour * (2e-3 - common)
    assert values[2] == pytest.approx(common + own, rel=1e-4)
    assert covariance[2, 2] < MODE_STD**2 / len(NEAR)
    assert values[1] == pytest.approx(0.02, rel=1e-4)


@pytest.mark.parametrize(("waves", "share"), [(3e-4, 0.87), (2e-3, 0.97)])
def test_weak_modes_of_an_order_have_the_likeliest_variance(
    waves: float, share: float
) -> None:
    """As measured: the likeliest variance allows for noise, 2.6e-4 waves, which these modes do not have."""
    order, rng = range(29, 37), np.random.default_rng(4)
    modes = dict(zip(order, waves * rng.normal(size=8), strict=True))
    plain = lens_of(members(NEAR, 482.0, 60.0, 4.0, modes=modes), stated(60.0, 4.0))
    model = replace(plain.model, weak=dict.fromkeys(order, 0.01), spread={})
    seventh = WEAK_MODE, 0, 7, False
    fit = fit_families(model, plain.measured)
    drawn = float(np.sqrt(np.mean(np.square([*modes.values()]))))
    assert fit.model.spread[seventh] == pytest.approx(share * drawn, rel=0.03)
    of_nothing = replace(plain.measured, covariance=1e4 * plain.measured.covariance)
    assert seventh not in fit_families(model, of_nothing).model.spread
