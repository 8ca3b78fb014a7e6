"""What leads the report: the lens without defocus, its colour with correlated errors, and the place in the field."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.report.contents import answer
from labkit.report.curves import at_best_focus
from labkit.report.html import write_report
from labkit.report.photographs import Photographs, place_table
from labkit.report.table import Card
from labkit.results import Placement, Results
from tests.results_samples import FOCUS, a_wavefront, some_results, written

FRAME = Photographs(size_px=(3001, 4001))
CORNERS = np.array([[[1000, 1400], [1000, 1600], [1200, 1600], [1200, 1400]]], float)


def cards(results: Results, photographs: Photographs = FRAME) -> dict[str, Card]:
    return {
        card.title: card for card in answer(results, at_best_focus(results), photographs)
    }


def printed(card: Card) -> dict[str, list[str]]:
    return {
        label: [
            f"{each.value}{each.error}".replace("\N{NO-BREAK SPACE}", " ")
            for each in numbers
        ]
        for label, numbers in card.rows
    }


def test_the_wavefront_is_in_nanometres_and_in_waves_of_its_own_light() -> None:
    rms = cards(some_results())["RMS wavefront without defocus"]
    # modes of 0.03 and 0.04 waves of 450 nm; red is of 650 nm: 0.05 · 450/650
    assert printed(rms)["R"] == ["22.50 ± 0.56", "0.03462 ± 0.00087"]
    assert printed(rms)["B"] == ["22.50 ± 0.56", "0.0500 ± 0.0013"]
    assert rms.head == ("nm", "waves")
    assert "R 650 nm, B 450 nm" in rms.note


def test_what_leads_is_what_each_channel_has_without_its_defocus() -> None:
    results = some_results()
    best = results.nearest_focus("R").best
    each = cards(results)
    (strehl,) = printed(each["Strehl ratio without defocus"])["R"]
    assert strehl == str(best.strehl)
    assert printed(each["MTF50 without defocus"])["R"] == [
        str(replace(best.mtf50(d), unit="")) for d in ("x", "y")
    ]


def test_colour_has_the_error_of_a_difference_of_what_errs_alike() -> None:
    errors = np.array([0.42, 0.37])
    alike = np.eye(3)
    alike[:2, :2] = np.outer(errors, errors) * np.array([[1.0, 0.99], [0.99, 1.0]])
    focus = replace(FOCUS, covariance=alike)
    colour = cards(some_results(focus=focus))["Longitudinal colour"]
    # sqrt(0.42² + 0.37² − 2 · 0.99 · 0.42 · 0.37) = 0.075, where independent errors made 0.56
    assert printed(colour)["B − R"][0] == "+0.470 ± 0.075"
    assert colour.head == ("range, mm", "on the sensor, µm")


def test_one_colour_has_no_longitudinal_colour() -> None:
    one = Results.longitudinal_colour(some_results(focus=None))
    assert one == ()
    assert "Longitudinal colour" not in cards(some_results(focus=None))


def test_the_place_is_how_far_the_targets_middle_was_from_the_frames() -> None:
    placed = a_wavefront(placement=Placement((990, 1390), (220, 220), CORNERS))
    results = some_results(wavefronts=(placed,), focus=None)
    card = cards(results)["Place in the field"]
    # 400 rows and 500 columns of 4.78 µm from the middle; the half diagonal is 2500.7 pixels
    assert card.big == "3.06 mm off centre"
    assert "26\N{NO-BREAK SPACE}% of the half diagonal" in card.note
    assert "All numbers are of this one place." in card.note
    assert place_table(results, FRAME).rows[0].cells[-2:] == ("3.06", "25.6")


@pytest.mark.parametrize("found", [Photographs(), FRAME])
def test_a_place_that_nobody_knows_is_not_given(found: Photographs) -> None:
    placement = None if found is FRAME else Placement((0, 0), (9, 9), CORNERS)
    results = some_results(wavefronts=(a_wavefront(placement=placement),), focus=None)
    assert cards(results, found)["Place in the field"].big == "not known"


@pytest.mark.slow
def test_the_lens_leads_and_best_focus_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})
    html = write_report(written(tmp_path)).read_text()
    titles = (
        "Strehl ratio without defocus",
        "RMS wavefront without defocus",
        "MTF50 without defocus",
        "Best focus",
        "Longitudinal colour",
        "Place in the field",
        'class="checks"',
    )
    places = [html.index(title) for title in titles]
    assert places == sorted(places)
