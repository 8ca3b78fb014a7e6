"""What a session predicts of each observation by all others, and by all other ranges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.laws import Laws
from labkit.estimation.lens_fit import fit_lens, predicted_by_other_stations
from tests.lens_samples import (
    lens_of,
    members,
    moved,
    stated,
)

FAR_MM, NEAR_MM = (3000.0, 3200.0), tuple(np.linspace(470.0, 494.0, 5).tolist())


def test_a_range_at_a_wrong_optimum_is_predicted_by_the_other_ranges() -> None:
    """Of three colours at two ranges, the farther range's fits all have a mode that is off."""
    every = members(FAR_MM, 3100.0, 60.0, 4.0, modes={5: 0.02})
    near = [one.reading.range_mm == FAR_MM[0] for one in every]
    off = [
        one if here else moved(one, modes=0.05)
        for here, one in zip(near, every, strict=True)
    ]
    fit = lens_of(off, stated(60.0, 4.0))
    by_ranges = predicted_by_other_stations(fit)
    # measured 2.4e-10: the modes' priors pull
    np.testing.assert_allclose(
        by_ranges[:, 1], np.where(near, 0.07, 0.02), rtol=0, atol=5e-10
    )


@pytest.mark.parametrize(
    "of", [Laws(), Laws(mode_scatter=0.01)], ids=["shared", "scattered"]
)
def test_a_prediction_is_that_of_an_estimate_without_the_observation(of: Laws) -> None:
    plan, every = stated(60.0, 4.0), members(NEAR_MM, 482.0, 60.0, 4.0, modes={7: 0.02})
    every = [moved(one, 3e-4 * (-1) ** k, modes=2e-3 * k) for k, one in enumerate(every)]
    whole = lens_of(every, plan, of)
    others = fit_lens(
        whole.model, replace(whole.measured, used=np.arange(15) != 4), whole.solved.point
    )
    (predicted, covariance), (alone, spread) = whole.predictions, others.predictions
    std = np.sqrt(np.diag(spread[4]))
    np.testing.assert_allclose(predicted[4] / std, alone[4] / std, atol=5e-5)
    np.testing.assert_allclose(
        covariance[4] / np.outer(std, std), spread[4] / np.outer(std, std), atol=5e-4
    )
