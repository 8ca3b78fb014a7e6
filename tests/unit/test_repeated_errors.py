"""Errors of averages where a model error is the same in every fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.lens_samples import (
    COLOURS,
    lens_of,
    measured_of,
    members,
    stated,
    with_measured,
)


def test_a_model_error_that_every_fit_has_is_within_the_errors_of_an_average() -> None:
    # a quarter of a mode's variance is noise, the rest one error that all three ranges of a colour share
    rng, noise_std, error_std = np.random.default_rng(5), 0.5e-3, 0.87e-3
    z = []
    for _ in range(40):
        shared = {colour: error_std * rng.standard_normal() for colour in COLOURS}
        every = []
        for one in members((950.0, 1000.0, 1060.0), 1000.0, 60.0, 4.0, modes={8: 0.05}):
            of = measured_of(one)
            model = np.zeros_like(of.covariance)
            model[1, 1] = error_std**2
            whole = of.covariance.copy()
            whole[1, 1] = noise_std**2 + error_std**2
            values = of.values.copy()
            values[1] += shared[one.reading.key.channel] + noise_std * rng.standard_normal()
            changed = replace(of, values=values, covariance=whole, model=model)
            every.append(with_measured(one, changed))
        values, errors = lens_of(every, stated(60.0, 4.0)).posterior(0)
        z.append((values[1] - 0.05) / np.sqrt(errors[1, 1]))
    # 40 draws know a standard deviation to 11 %; 0.89 measured, 1.54 with independent errors
    assert 0.6 < np.std(z) < 1.2
