"""Findings: data first, sentences made of the data, and every code documented."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from labkit.findings.findings import (
    UNANSWERED_CODES,
    Finding,
    Moves,
    camera_part_found,
    camera_parts_missing,
    each_once,
    flats_of_another_range,
    flats_partly_unlit,
    found,
    model_incomplete_everywhere,
    pixels_left_out,
    plan_contradicted,
    residuals_not_noise,
    stated_model_moves,
    surround_uneven,
    two_camps,
    unanswered,
    undetermined,
)
from labkit.findings.texts import TEXTS
from labkit.imaging.parts import KNOWN
from labkit.key import Key
from labkit.results.schema import FindingEntry
from labkit.types import JSON
from labkit.uncertain import Uncertain

PAGES = Path(__file__).parents[2] / "docs" / "troubleshooting"
GREEN = Key(3200.0, "G")
MOVES = Moves({"G": 0.024}, 0.013, 0.031)

SAMPLES = [
    found("session-mended", note="journal.jsonl: left out a torn last line"),
    found("kept-fits-refused", count=2, folder="results/latest/.fits"),
    found("photographs-unlisted", count=2, folder="night/frames", first="a.dng"),
    found("same-photograph", file="b.dng", same_as="a.dng"),
    found("exif-focal-length", file="a.dng", focal_length_mm=50.0, planned_mm=70.0),
    found(
        "exif-f-number", file="a.dng", f_number=4.0, plan_key="lens.f_number", planned=2.8
    ),
    found(
        "settings-differ",
        None,
        {"first": "50 mm", "other": "70 mm"},
        setting="focal length",
        first_file="a",
        file="b",
    ),
    found("picture-altered", note="the photographs were sharpened"),
    found(
        "picture-processed",
        file_format="JPEG",
        bits=8,
        tone_curve="tone curve undone by sRGB",
    ),
    found("colours-at-half-resolution"),
    found(
        "panel-pixels-seen", None, {"to_add": "pixels = {}"}, pitch_mm=0.0962, contrast=0.02
    ),
    found(
        "surround-contradicted",
        None,
        {"surround": "black", "other": "white"},
        level=0.93,
    ),
    surround_uneven(2000.0, 0.0),
    found("no-dark-frames"),
    found("bias-instead-of-darks"),
    found("dark-exposure-differs", least_s=0.01, most_s=0.02),
    found(
        "noise-contradicts-plan",
        channel="G",
        key="gain_counts_per_e",
        stated=0.9,
        measured=0.45,
        std=0.004,
    ),
    found("no-flat-frames"),
    flats_of_another_range(2150.0, 2200.0),
    flats_partly_unlit(2000.0, 0.125),
    found("target-at-places", count=4),
    found("large-target", target_px=1000, count=8, tile_px=200, used=0.32),
    found(
        "tiles-not-found",
        None,
        {"at": " at 1180 mm", "named": "(0, 1)"},
        range_mm=1180.0,
        tiles=[[0, 1]],
        count=1,
        every=6,
    ),
    found(
        "tile-left-out",
        Key(1180.0, "G", (0, 2)),
        {"why": "t.dng: only 12 usable pixels of channel G on the target"},
    ),
    found("gain-not-measured"),
    found("results-corrupt", aside="results/latest/results.json.corrupt"),
    pixels_left_out({(70, 93): {"a.dng": 122.4, "b.dng": -9.0}}),
    found(
        "fit-left-out",
        note="G at 3010 mm is left out: FloatingPointError: overflow",
    ),
    found("search-cut-short", GREEN, patience_s=120.0, starts=40),
    found("fit-mended", GREEN),
    found("fit-does-not-belong", GREEN),
    two_camps([GREEN, Key(3300.0, "G")], [Key(3100.0, "G"), Key(3150.0, "G")]),
    undetermined(GREEN, ["defocus"]),
    residuals_not_noise(GREEN, 1e-6, 1.234, {}, "session"),
    residuals_not_noise(GREEN, 1e-6, 1.234, {}, None),
    model_incomplete_everywhere({"3200_G": 1.2, "3300_G": 1.9}, 3),
    found("chi2-unusual", GREEN, chi2_per_pixel=0.7, low=0.9, high=1.5),
    found("lens-changed", last_mm=3200.0, next_mm=3300.0),
    found("no-best-focus", why="the frames carry no ranges"),
    found("channel-without-best-focus", Key(None, "G")),
    found("defocus-sign-open", Key(None, "G")),
    found("pupil-magnification-at-bound", least=0.05, most=20.0),
    found("pupil-magnification-undetermined", pupil_magnification_std=0.3),
    plan_contradicted(
        "channel.wavelength_nm of G",
        450.0,
        Uncertain(550.6, 1.2, "nm"),
        0.99,
        ["target.size_mm"],
    ),
    found("cones-contradict-one-lens", cone_relative_error=0.02),
    found("modes-differ-between-ranges"),
    found("errors-widened", factor=1.7, chi2_per_freedom=2.9),
    camera_part_found(
        "smear", "smear", {"rows_px": Uncertain(0.4, 0.01, "px")}, 120.0, MOVES
    ),
    found("pupil-at-bound", None, {"title": "obstruction"}),
    found(
        "light-contradicted",
        None,
        {"list": "G 18.0 ± 4.0 nm in place of 39 nm"},
        found_nm={"G": {"value": 18.0, "std": 4.0}},
        named_nm={"G": 39.0},
    ),
    found(
        "higher-modes-found",
        None,
        {"waves_words": "0.0350 ± 0.0002 waves", "besides": ""},
        first_noll=16,
        last_noll=36,
        waves_rms={"value": 0.035, "std": 0.0002},
    ),
    camera_parts_missing({"veil": "veiling glare"}, MOVES),
    stated_model_moves(MOVES, 0, 4),
    found("panel-aperture-found", None, {"across": "0.8 ± 0.1", "down": "0.9 ± 0.1"}),
    found("tile-misplaced", Key(3200.0, "G", (0, 1))),
    found(
        "target-bent",
        None,
        {"depth": "0.50 ± 0.02 mm"},
        depth_mm={"value": 0.5, "std": 0.02},
        p_value=1e-9,
    ),
    found(
        "places-undetermined", None, {"list": "the distortion"}, unknown=["the distortion"]
    ),
    found("tilt-untested", None, {"words": "the sensor's tilt rests on perspective alone"}),
    found(
        "perspective-contradicted",
        None,
        {"share_words": "0.02 ± 0.01"},
        share={"value": 0.02, "std": 0.01},
        p_value=1e-9,
    ),
    found("ranges-not-determined"),
    found("psf-of-another-camera", difference="lens.f_number = 4, the session's is 2.8"),
    found(
        "edge-methods-disagree",
        None,
        {"at": "1,2,30,40"},
        box=[1, 2, 30, 40],
        channel="G",
        pull=12.3,
    ),
    found(
        "edge-blurred-otherwise",
        None,
        {"at": "1,2,30,40", "cause": "motion during the exposure"},
        box=[1, 2, 30, 40],
        channel="G",
    ),
    found(
        "edge-bowed", None, {"at": "1,2,30,40"}, box=[1, 2, 30, 40], channel="G", bow_px=1.2
    ),
    found("edges-without-common-wavefront"),
    found("chart-edges-left-out", cut=5, clipped=2, uneven=3),
    found("chart-squares-small", side_px=34.1, least_px=44.0),
    found("chart-not-flat", number=1, rms_px=0.84),
    found("chart-edges-not-fitted", count=3, why="it holds no edge"),
    found(
        "chart-edges-blurred-otherwise",
        count=12,
        edges=40,
        channel="G",
        cause="motion during the exposure",
    ),
    found("chart-edges-along-pixels", count=12, edges=140),
    found("chart-directions-missing", count=8, places=35),
    found("chart-focus-sign-open"),
    found("chart-ranges-contradicted", channel="G", factor=4.2),
]
"""One of each."""


def entries() -> Iterator[str]:
    """Codes that have an entry in the pages: code in a line above an explanation."""
    for page in PAGES.glob("*.md"):
        for terms in re.findall(
            r"^(`.+)\n: ", page.read_text(encoding="utf-8"), re.MULTILINE
        ):
            yield from re.findall(r"`([^`]+)`", terms)


def test_every_code_has_an_entry_in_troubleshooting() -> None:
    assert set(TEXTS) - set(entries()) == set()


def read_back(finding: Finding) -> Finding:
    kept = json.dumps(FindingEntry.of(finding).written(), allow_nan=False)
    return FindingEntry.model_validate_json(kept).made(Finding)


def test_each_code_makes_one_sentence_that_begins_with_its_key() -> None:
    assert [finding.code for finding in SAMPLES] == list(TEXTS)
    for finding in SAMPLES:
        assert len(finding.text.splitlines()) == 1
        if finding.key == GREEN:
            assert finding.text.startswith("G at 3200 mm: ")
        assert read_back(finding) == finding


def test_what_is_not_finite_is_null_and_the_rest_is_read_back() -> None:
    finding = Finding(
        "a-code", GREEN, {"p_value": float("nan"), "many": (1, np.float64(2.5))}, "words"
    )
    assert finding.numbers == {"p_value": None, "many": [1, 2.5]}
    assert read_back(finding) == finding


@pytest.mark.parametrize("code", ["", "Two-Words", "two words", "two--words"])
def test_a_code_is_in_kebab_case(code: str) -> None:
    with pytest.raises(ValueError, match="code"):
        Finding(code, None, {}, "words")


def test_numbers_are_json() -> None:
    nothing: JSON = object()  # type: ignore[assignment]
    with pytest.raises(TypeError, match="object"):
        Finding("a-code", None, {"what": nothing}, "words")


def test_all_codes_are_in_kebab_case_and_an_unknown_one_is_refused() -> None:
    assert [Finding(code, None, {}, text).code for code, text in TEXTS.items()] == list(
        TEXTS
    )
    assert set(UNANSWERED_CODES) <= set(TEXTS)
    with pytest.raises(KeyError):
        found("no-such-code")


@pytest.mark.parametrize("name", KNOWN)
def test_every_part_of_the_camera_has_words_for_a_sentence(name: str) -> None:
    finding = camera_part_found(name, KNOWN[name].words, {}, None, None)
    assert finding.text.startswith(f"the photographs show {KNOWN[name].words}, which")


def test_both_camps_are_named_with_their_keys() -> None:
    finding = two_camps(
        [Key(3200.0, "G"), Key(3300.0, "G")], [Key(3100.0, "G"), Key(3150.0, "G")]
    )
    assert (
        "G at 3200 mm, G at 3300 mm follow one lens, G at 3100 mm, G at 3150 mm another"
        in finding.text
    )
    assert finding.numbers["outliers"] == ["3100_G", "3150_G"]


def test_a_model_that_is_poor_for_all_says_so_once() -> None:
    finding = model_incomplete_everywhere({"3200_G": 1.234, "3300_G": 1.9}, 3)
    assert finding.text.startswith(
        "the residuals of 2 of 3 fits are more than noise (χ² per pixel 1.23 to 1.90)"
    )
    assert finding.numbers["chi2_per_pixel"] == {"3200_G": 1.234, "3300_G": 1.9}


def test_the_same_sentence_is_said_once() -> None:
    findings = [found("no-dark-frames"), found("no-flat-frames"), found("no-dark-frames")]
    assert each_once(findings) == findings[:2]


def test_what_could_not_be_estimated_is_the_answer() -> None:
    findings = [
        found("no-dark-frames"),
        found("no-best-focus", why="every fit was rejected"),
    ]
    assert unanswered(findings) == "no best focus: every fit was rejected"
    assert unanswered(findings[:1]) is None


def test_an_accepted_optimum_and_a_doubtful_one_have_codes_of_their_own() -> None:
    confirmed = residuals_not_noise(
        GREEN, 1e-6, 1.234, {"smear": KNOWN["smear"].words}, "parts"
    )
    assert confirmed.code == "model-incomplete"
    assert confirmed.text == (
        "G at 3200 mm: the residuals are more than noise (p = 1e-06, χ² per pixel 1.23); a fit with more parts of the "
        "camera confirms the optimum: the model lacks something, such as smear, by a shake or a rolling shutter; "
        "standard errors allow for it"
    )
    by_starts = residuals_not_noise(GREEN, 1e-6, 1.234, {}, "starts")
    assert by_starts.text.endswith("; how much its numbers err is not known")
    doubtful = residuals_not_noise(GREEN, float("nan"), 1.2, {}, None)
    assert doubtful.text.endswith("; its errors are unknown")
    assert (doubtful.code, doubtful.key) == ("optimum-doubtful", GREEN)
    assert doubtful.numbers == {
        "p_value": None,
        "chi2_per_pixel": 1.2,
        "missing": [],
        "confirmed_by": None,
    }


def test_how_far_results_move_is_told_in_numbers_and_in_words() -> None:
    moved = {
        "best_focus_moves_mm": {"G": 0.024},
        "waves_move": 0.013,
        "psf_moves_l1": 0.031,
    }
    words = "best focus by G +0.024 mm, wavefronts by up to 0.013 waves RMS, PSFs by up to 3.1 % (L1)"
    missing = camera_parts_missing({n: KNOWN[n].words for n in ("smear", "veil")}, MOVES)
    assert missing.numbers == {"parts": ["smear", "veil"]} | moved
    assert missing.text.endswith(f"{words}; standard errors include this effect")
    stated = stated_model_moves(MOVES, 1, 4)
    assert stated.numbers == {"rejected_optima": 1, "optima": 4} | moved
    assert stated.text.endswith(f"{words}; 1 of 4 optima would be rejected")
    assert "best focus" not in str(Moves({}, 0.013, 0.031))
    assert "by up to 110 % (L1)" in str(Moves({}, 0.013, 1.054))


def test_a_part_is_told_with_its_numbers() -> None:
    values = {
        "spread_px": Uncertain(0.55, 0.01, "px"),
        "rows_px": Uncertain(0.5, 0.01, "px"),
    }
    finding = camera_part_found(
        "low_pass_filter", KNOWN["low_pass_filter"].words, values, None, None
    )
    assert finding.text.endswith(
        "which the plan does not state: rows 0.500 ± 0.010 px; a wrong sensor.fill_factor looks alike"
    )
    assert finding.numbers["values"] == {
        name: value.as_json() for name, value in values.items()
    }


def test_ranges_and_combinations_are_told_in_words() -> None:
    assert flats_of_another_range(None, 2200.0).text.startswith(
        "no flat frames without a range: those at 2200 mm are"
    )
    assert flats_partly_unlit(2000.0, 0.125).text.startswith(
        "flat frames at 2000 mm leave 12% of the frame unlit"
    )
    assert undetermined(GREEN, ["defocus", "mode 11"]).text.startswith(
        "G at 3200 mm: the frames do not determine defocus, mode 11;"
    )


def test_pixels_that_are_left_out_are_named_by_place_and_photograph() -> None:
    files = {f"{k}.dng": 9.0 for k in range(5)}
    many = {(row, 7): {"a.dng": 30.0} for row in range(4)}
    assert pixels_left_out({(70, 93): {"a.dng": 122.4, "b.dng": -9.0}}).text.startswith(
        "pixel (70, 93) of a.dng and b.dng: beyond what the target and any lens can show, by up to 122"
    )
    assert pixels_left_out({(1, 2): files}).text.startswith(
        "pixel (1, 2) of 0.dng and 4 more: "
    )
    assert "pixel (2, 7) of a.dng, 1 more: beyond" in pixels_left_out(many).text


def test_a_mistake_in_the_plan_is_one_sentence_with_three_others_at_most_each_once() -> (
    None
):
    keys = ["lens.f_number", *["the ranges", "target.size_mm"] * 4, "sensor.pixel_pitch_um"]
    keys += ["lens.focal_length_mm", "lens.f_number"]
    finding = plan_contradicted("lens.f_number", 2.0, Uncertain(2.81, 0.02), 0.9999, keys)
    assert finding.text == (
        "the photographs contradict the plan: lens.f_number = 2 is wrong with a probability of more than 99.5 %, the results "
        "assume 2.810 ± 0.020; correct it and fit again; if it is right, check the ranges, target.size_mm or "
        "sensor.pixel_pitch_um"
    )
    sure = plan_contradicted("lens.f_number", 2.0, Uncertain(2.81, 0.02), 0.93, keys[:2])
    assert "a probability of 93 %" in sure.text
    assert sure.text.endswith("if it is right, check the ranges")
