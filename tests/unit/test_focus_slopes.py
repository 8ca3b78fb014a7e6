"""How defocus changes within a channel, by the longitudinal colour of all channels at the stations that they share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.results.model import Wavefront
from labkit.results.tables import focus_slopes
from tests.results_samples import a_wavefront, full_results, some_results

NM = {"R": 650.0, "G": 550.0, "B": 450.0}
CURVE = np.polynomial.Polynomial([0.4, -2e-3, 3e-6])  # of nm


def lit(channel: str, range_mm: float, away: float, **changed: object) -> Wavefront:
    nm = NM[channel]
    return a_wavefront(
        range_mm, channel, away + float(CURVE(nm)), wavelength_nm=nm, **changed
    )


def test_three_colours_lie_on_a_parabola_at_every_station() -> None:
    every = [lit(c, r, away) for c in NM for r, away in ((3000.0, -0.3), (3200.0, 0.9))]
    slopes = focus_slopes(every)
    assert slopes == pytest.approx({c: CURVE.deriv()(nm) for c, nm in NM.items()})


def test_two_colours_lie_on_a_line_and_one_says_nothing() -> None:
    two = [lit("R", 3000.0, 0.0), lit("B", 3000.0, 0.0)]
    line = (CURVE(650.0) - CURVE(450.0)) / 200
    assert focus_slopes(two) == pytest.approx({"R": line, "B": line})
    assert focus_slopes([lit("R", 3000.0, 0.0), lit("B", 3200.0, 0.0)]) == {}


def test_a_wavefront_whose_sign_is_open_says_nothing() -> None:
    two = [lit("R", 3000.0, 0.0), lit("B", 3000.0, 0.0, sign_open=True)]
    assert focus_slopes(two) == {}


def test_results_say_what_the_tables_and_the_colours_tell() -> None:
    results = full_results()
    content = results.as_json()
    light = results.named_lights["B"]
    assert content["light"] == {
        "B": {
            "name": "led-panel",
            "filters": "typical",
            "mean_nm": {"value": 450.0, "std": light.mean.std},
            "width_nm": light.width.as_json(),
        }
    }
    assert content["focus_waves_per_nm"].keys() == {"R", "B"}
    alone = replace(results, wavefronts=results.wavefronts[:1])
    assert alone.as_json()["focus_waves_per_nm"] == {}
    assert some_results().named_lights == {}
