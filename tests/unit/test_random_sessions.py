"""The study of many sessions: what is drawn, what is compared, what is kept."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from benchmarks.random_sessions import (
    KINDS,
    Drawn,
    draw,
    draw_as_made,
    draw_many_modes,
    draw_with_parts,
)
from benchmarks.session_tables import parts_table, psf_table, table
from benchmarks.sessions import OutOfTime, compared, ended_after, read
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.parts import LowPassFilter, Smear, Veil
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.scene import carry
from labkit.drivers.simulated.world import Truth, Visit
from labkit.finder.plausibility import Sight, refuse_contradictions
from labkit.types import Floats

SESSIONS = 60


@pytest.fixture(scope="module")
def drawn() -> list[Drawn]:
    return [draw(1, index) for index in range(SESSIONS)]


def test_a_session_is_drawn_by_its_number_alone(drawn: list[Drawn]) -> None:
    assert draw(1, 7) == drawn[7]
    assert draw(2, 7) != drawn[7]


@pytest.mark.parametrize("index", range(5))
def test_sessions_of_many_modes_go_through_focus(index: int) -> None:
    one = draw_many_modes(1, index)
    lens, tape_mm = one.settings.lens, one.settings.rail.tape_error_mm
    assert one.plan.rail is not None
    near, about, far = (
        mm + tape_mm - lens.best_focus_mm["G"] for mm in one.plan.rail.ranges_mm
    )
    assert near < 0 < far
    assert abs(about) < min(-near, far) / 2
    assert one.plan.fit.zernike_noll == (4, 22)
    assert [*Bench(one.settings).truth.modes_waves["G"]] == [*range(5, 23)]


@pytest.mark.parametrize(("kind", "waves"), [("37", 0.5), ("37-one-wave", 1.0)])
def test_sessions_of_most_modes_have_them_to_noll_37(kind: str, waves: float) -> None:
    one = KINDS[f"many-modes-{kind}"](1, 3)
    assert one.plan.fit.zernike_noll is None
    modes = Bench(one.settings).truth.modes_waves["G"]
    assert [*modes] == [*range(5, 38)]
    assert np.linalg.norm([*modes.values()]) == pytest.approx(waves)


@pytest.mark.parametrize("pupil", ["blades", "cats_eye"])
@pytest.mark.parametrize("kind", ["many-modes-37", "many-modes-37-one-wave"])
def test_strong_wavefronts_go_through_pupils_that_are_no_disc(
    kind: str, pupil: str
) -> None:
    one = KINDS[f"{kind}-{pupil.replace('_', '-')}"](1, 3)
    assert getattr(one.settings.lens.pupil, pupil)
    round_one = KINDS[kind](1, 3)
    lens = replace(one.settings.lens, pupil=Pupil())
    assert replace(one.settings, lens=lens) == round_one.settings
    assert one.plan == round_one.plan


@pytest.fixture(scope="module")
def as_made() -> list[Drawn]:
    return [draw_as_made(1, index) for index in range(SESSIONS)]


def test_lenses_as_made_are_those_without_it_and_their_plans_say_nothing(
    drawn: list[Drawn], as_made: list[Drawn]
) -> None:
    assert draw_as_made(1, 7) == as_made[7]
    for plain, made in zip(drawn, as_made, strict=True):
        assert made.plan == plain.plan.replace(fit={"zernike_noll": None})
        assert "zernike_noll" not in made.plan.to_toml()
        lens = replace(made.settings.lens, higher_waves=0.0, pupil=Pupil())
        assert replace(made.settings, lens=lens) == plain.settings


def test_what_is_told_of_a_lens_as_made_is_what_it_has(as_made: list[Drawn]) -> None:
    for one in as_made:
        told = json.loads(json.dumps(one.kind["as_made"]))
        lens = one.settings.lens
        assert 0.005 <= lens.higher_waves == told.pop("higher_waves") <= 0.05
        if eye := told.get("cats_eye"):
            told["cats_eye"] = tuple(eye)
            assert lens.pupil.clear_share > 0.5
        assert lens.pupil == Pupil(**told)


@pytest.mark.parametrize(
    ("has", "share"), [("blades", 0.6), ("obstruction", 0.15), ("cats_eye", 0.25)]
)
def test_pupils_of_every_kind_are_drawn(
    as_made: list[Drawn], has: str, share: float
) -> None:
    having = [one.kind["as_made"][has] for one in as_made if has in one.kind["as_made"]]
    # four standard deviations of a binomial
    spread = (share * (1 - share) * SESSIONS) ** 0.5
    assert len(having) == pytest.approx(share * SESSIONS, abs=4 * spread)
    if has == "blades":
        assert {5, 11} <= set(having) <= set(range(5, 12))


@pytest.fixture(scope="module")
def with_parts() -> list[Drawn]:
    return [draw_with_parts(1, index) for index in range(SESSIONS)]


def test_sessions_with_parts_are_those_without_them_and_their_plans_say_nothing(
    drawn: list[Drawn], with_parts: list[Drawn]
) -> None:
    assert draw_with_parts(1, 7) == with_parts[7]
    for plain, real in zip(drawn, with_parts, strict=True):
        assert real.plan == plain.plan
        lens, sensor, rail = real.settings.lens, real.settings.sensor, real.settings.rail
        bare = replace(
            real.settings,
            lens=replace(lens, spectrum={}, veil=Veil()),
            sensor=replace(sensor, low_pass=LowPassFilter(), diffusion_px=0.0),
            rail=replace(rail, smear=Smear()),
        )
        assert bare == plain.settings


def test_about_half_have_each_part_and_few_a_smear_or_a_veil(
    with_parts: list[Drawn],
) -> None:
    for part, share in {
        "low_pass_px": 0.5,
        "spectrum": 0.5,
        "diffusion_px": 0.5,
        "smear": 0.2,
        "veil": 0.2,
    }.items():
        having = sum(part in one.kind["parts"] for one in with_parts)
        # four standard deviations of a binomial
        assert having == pytest.approx(
            share * SESSIONS, abs=4 * (share * (1 - share) * SESSIONS) ** 0.5
        )


def test_what_is_told_of_parts_is_what_the_world_has(with_parts: list[Drawn]) -> None:
    for one in with_parts:
        parts, settings = json.loads(json.dumps(one.kind["parts"])), one.settings
        lens, sensor, smear = settings.lens, settings.sensor, settings.rail.smear
        assert [sensor.low_pass.rows_px, sensor.low_pass.cols_px] == parts.get(
            "low_pass_px", [0, 0]
        )
        assert sensor.diffusion_px == parts.get("diffusion_px", 0)
        assert [smear.length_px, smear.direction_deg] == parts.get("smear", [0, 0])
        assert lens.veil.fraction == parts.get("veil", [0])[0]
        assert set(lens.spectrum) == set(parts.get("spectrum", {}))
        for colour, lines in parts.get("spectrum", {}).items():
            assert [list(line) for line in lens.spectrum[colour].lines] == lines
            nm, share = np.transpose(lines)
            assert nm @ share == pytest.approx(lens.wavelength_nm[colour], rel=1e-12)
            # a bell's standard deviation is its FWHM over 2.35, that of five lines of a leaning one 0.99 to 0.95 of it
            deviation = np.sqrt(((nm - nm @ share) ** 2) @ share)
            assert 0.95 * 5 / 2.355 < deviation < 60 / 2.355


def test_plans_are_off_by_the_errors_that_they_state(drawn: list[Drawn]) -> None:
    z = []
    for one in drawn:
        plan, lens = one.plan, one.settings.lens
        focal, f_number, size = (
            plan.lens.stated_focal_length,
            plan.lens.stated_f_number,
            plan.target.stated_size,
        )
        true_mm = one.settings.panel.pitch_mm * 3 ** (plan.target.order or 0)
        z.append(
            [
                # the engraving is off by a share of the true number: a second-order difference
                (focal.value / lens.focal_length_mm - 1) * focal.value / focal.std,
                (f_number.value / lens.f_number - 1) * f_number.value / f_number.std,
                (true_mm - size.value) / size.std,
                one.settings.rail.tape_error_mm / plan.fit.range_zero_std_mm,
            ]
        )
    assert stats.kstest(np.ravel(z), "norm").pvalue > 0.01
    assert np.all(np.abs(stats.ttest_1samp(z, 0).pvalue) > 0.001)


def corners_px(bench: Bench, size_mm: float) -> Floats:
    """Of a target in the middle of the panel, (4, 2) row and column."""
    half = size_mm / 2
    columns, rows = carry(
        bench.view.to_pixels(),
        np.array([-half, half, half, -half]),
        np.array([-half, -half, half, half]),
    )
    return np.column_stack((rows, columns))


def test_targets_are_in_the_frame_and_agree_with_their_plans(drawn: list[Drawn]) -> None:
    for one in drawn:
        bench, rail, sights = Bench(one.settings), one.plan.rail, []
        assert rail is not None
        for range_mm in rail.ranges_mm:
            bench.turn_screw(rail.position_mm(range_mm))
            bench.stand(rail.position_mm(range_mm))
            corners = corners_px(bench, one.plan.target.size_mm)
            assert corners.min() > 2
            assert corners.max() < one.settings.sensor.rows - 3
            sights.append(Sight(range_mm, corners))
        refuse_contradictions(sights, one.plan, (one.plan.target.size_mm,) * 2)


TRUTH = Truth(
    seed=1,
    best_focus_mm={"G": 2000.0},
    range_zero_mm=5.0,
    focal_length_mm=70.0,
    f_number=2.8,
    pupil_magnification=1.0,
    lateral_colour={},
    modes_waves={"G": {5: 0.1}},
    counts_per_electron=0.4,
    read_noise_counts=1.0,
    # the home switch tripped 0.02 mm later
    visits=(Visit(2010.0, 2015.02, 5.02, {"G": 0.2}, ()),),
)


def number(value: float, std: float) -> dict[str, float]:
    return {"value": value, "std": std}


def results(astigmatism: float, accepted: bool) -> dict[str, Any]:
    wave = {
        "range_mm": 2010.0,
        "channel": "G",
        "noll": [4, 5],
        "waves_rms": [0.201, astigmatism],
        "std": [0.001, 0.002],
    }
    return {
        "lens": {
            "focal_length_mm": number(70.2, 0.1),
            "f_number": number(2.79, 0.01),
            "range_zero_mm": number(6.02, 1),
        },
        "focus": {
            "best_focus_mm": {"G": number(1999.99, 0.01)},
            "pupil_magnification": number(1.1, 0.1),
        },
        "wavefronts": [wave | {"global_test": {"accepted": accepted}}],
        "findings": [{"code": "fit-mended"}],
    }


def test_errors_are_counted_in_standard_errors() -> None:
    line = compared(results(0.1, True), TRUTH)
    expected = {
        "focal_length": 2.0, "f_number": -1.0, "range_zero": 1.0, "pupil_magnification": 1.0,
        "best_focus": 1.0,  # 1999.99 - (2000 - 0.02)
        "noll.4": 1.0, "noll.5": 0.0,
    }  # fmt: skip
    assert {name: z[0] for name, z in line["z"].items()} == pytest.approx(expected)
    assert (line["fits"], line["mended"], line["wrong_accepted"]) == (1, 1, 0)


@pytest.mark.parametrize(
    ("astigmatism", "accepted", "counted"),
    [
        (0.2, True, "wrong_accepted"),
        (0.2, False, "wrong_rejected"),
        (0.1, False, "right_rejected"),
    ],
)
def test_wrong_optima_are_told_from_right_ones(
    astigmatism: float, accepted: bool, counted: str
) -> None:
    line = compared(results(astigmatism, accepted), TRUTH)
    assert [
        name
        for name in ("wrong_accepted", "wrong_rejected", "right_rejected")
        if line[name]
    ] == [counted]


def test_results_of_the_first_schema_tell_less() -> None:
    first = results(0.1, True)
    del first["lens"]
    assert set(compared(first, TRUTH)["z"]) == {
        "pupil_magnification",
        "best_focus",
        "noll.4",
        "noll.5",
    }
    assert set(compared(first | {"focus": None}, TRUTH)["z"]) == {"noll.4", "noll.5"}


def test_a_mode_that_the_lens_lacks_is_truly_zero() -> None:
    more = results(0.1, True)
    more["wavefronts"][0] |= {
        "noll": [4, 5, 30],
        "waves_rms": [0.201, 0.1, 0.004],
        "std": [0.001, 0.002, 0.002],
    }
    assert compared(more, TRUTH)["z"]["noll.30"] == [2.0]


def test_a_cats_eye_changes_neither_f_number_nor_modes() -> None:
    cut = replace(TRUTH, clear_share=0.81)
    assert compared(results(0.2, True), cut) == compared(results(0.2, True), TRUTH)


def test_a_pupils_numbers_are_compared_in_the_results_units() -> None:
    pentagon = Pupil(blades=5, turn_deg=1.0, cats_eye=(0.3, 1.1, 179.0))
    to_corners = math.sqrt(math.pi / (5 * math.sin(math.pi / 5) * math.cos(math.pi / 5)))
    found = results(0.1, True)
    found["lens"]["pupil"] = {
        "blades": 5,
        "roundness": number(0.02, 0.01),
        "turn_deg": number(71.0, 1.0),  # a pentagon repeats every 72 degrees
        "cats_eye": {
            "shift": number(0.3 / to_corners, 0.01),
            "radius": number(1.1 / to_corners + 0.01, 0.01),
            "direction_deg": number(-179.0, 2.0),
        },
    }
    errors = compared(found, replace(TRUTH, pupil=pentagon))["z"]
    of_pupil = {name[6:]: z for name, (z,) in errors.items() if name.startswith("pupil.")}
    assert of_pupil == pytest.approx(
        {
            "roundness": 2.0,
            "turn_deg": -2.0,
            "shift": 0.0,
            "radius": 1.0,
            "direction_deg": 1.0,
        },
        abs=1e-9,
    )


def test_another_number_of_blades_has_no_turn_to_compare() -> None:
    found = results(0.1, True)
    found["lens"]["pupil"] = {
        "blades": 6,
        "roundness": number(0, 1),
        "turn_deg": number(0, 1),
    }
    errors = compared(found, replace(TRUTH, pupil=Pupil(blades=5)))["z"]
    assert not any(name.startswith("pupil.") for name in errors)


def test_psfs_are_summed_up() -> None:
    lines: list[dict[str, Any]] = [
        {"failed": None, "psf": [[0.02, 0.01], [0.004, 0.008]], "psf_chance": 0.5},
        {"failed": None, "psf": [[0.05, 0.01]], "psf_chance": 0.8413},
        {"failed": "no target"},
    ]
    sums, chances = psf_table(lines)
    assert sums == (
        "PSFs: L1 errors of 2 % in the median, 5 % at most, 33% below 0.5 %; over the stated error "
        "2.00 in the median, more than 2 in 1 of 3"
    )
    assert chances.startswith(
        "PSF's L1 among those of the wavefront's errors, one a session: n 2, mean 0.50, std 0.50"
    )
    assert [*psf_table([{"failed": None}])] == []


def endless() -> None:
    while True:
        pass


def test_a_fit_that_takes_too_long_is_ended() -> None:
    with pytest.raises(OutOfTime, match=r"within 0\.05 s"), ended_after(0.05):
        endless()
    with ended_after(0):
        pass


def test_a_torn_line_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "out.jsonl"
    assert read(path) == []
    path.write_text('{"index": 0}\n{"index": 1}\n{"ind')
    assert [line["index"] for line in read(path)] == [0, 1]
    assert path.read_text() == '{"index": 0}\n{"index": 1}\n'


def test_the_table_sums_up_and_names_what_failed() -> None:
    rng = np.random.default_rng(1)
    done = [
        compared(results(0.1, True), TRUTH) | {"failed": None, "index": index}
        for index in range(400)
    ]
    for line in done:
        line["z"]["noll.5"] = [float(rng.standard_normal())] * 3  # the same at three ranges
    failed = {"failed": "no target", "index": 3}
    lines = [
        json.loads(json.dumps(line | {"making_s": 1.0, "fitting_s": 2.0}))
        for line in (*done, failed)
    ]
    text = "\n".join(table(lines))
    (row,) = (line.split() for line in text.splitlines() if line.startswith("other modes"))
    assert row[2] == "400"
    assert row[-1] == "1200"
    # the mean and the standard deviation of 400 draws, four of their errors wide
    assert float(row[3]) == pytest.approx(0, abs=4 / 400**0.5)
    assert float(row[4]) == pytest.approx(1, abs=4 / 800**0.5)
    assert (
        "400 sessions: fits 400, wrong accepted 0, wrong rejected 0, right rejected 0, mended 400"
        in text
    )
    assert "401 s of making, 802 s of fitting" in text
    assert "session 3 failed: no target" in text


def test_parts_are_counted_as_found_missed_standing_in_or_invented() -> None:
    def line(true: list[str], found: list[str], **gains: float) -> dict[str, Any]:
        return {
            "failed": None,
            "parts": dict.fromkeys(true),
            "found": found,
            "gains": gains,
        }

    lines = [
        line(
            ["low_pass_px", "diffusion_px"], ["low_pass_filter"], diffusion=2.0
        ),  # too weak to be seen
        line(["low_pass_px"], [], low_pass_filter=50.0),
        line(["diffusion_px"], ["low_pass_filter"], diffusion=0.0),
        line(["veil"], ["veil", "spectrum"]),
    ]
    for index, one in enumerate(lines):
        one["index"] = index
    said = dict(words.split(": ", 1) for words in parts_table(lines))
    assert said["low_pass_filter"] == (
        "found in 1 of the 2 that have it, missed in 1 (1); "
        "absent, it stands in for another part in 1, is invented in 0"
    )
    assert said["diffusion"].startswith("found in 0 of the 2 that have it, missed in 0;")
    assert said["spectrum"].endswith(
        "stands in for another part in 0, is invented in 1 (3)"
    )


def test_parts_of_a_lens_as_made_are_counted_too() -> None:
    def line(made: dict[str, Any], found: list[str], **gains: float) -> dict[str, Any]:
        return {"failed": None, "as_made": made, "found": found, "gains": gains}

    higher = ["modes_16_21", "modes_22_28", "modes_29_36"]
    lines = [
        line({"higher_waves": 0.02, "blades": 7}, ["blades_7", *higher]),
        line({"higher_waves": 0.02, "blades": 6}, ["blades_9"], modes_16_21=30.0),
        line({"cats_eye": [0.3, 1.0, 60.0]}, ["uneven_rim"], cats_eye=5.0),
        {"failed": None, "found": ["obstruction"], "gains": {}},
    ]
    lines = [{**one, "index": index} for index, one in enumerate(lines)]
    said = dict(words.split(": ", 1) for words in parts_table(lines))
    assert said["modes_16_21"].startswith(
        "found in 1 of the 2 that have it, missed in 1 (1);"
    )
    assert said["blades"] == (
        "found in 1 of the 2 that have it, missed in 0; "
        "absent, it stands in for another part in 1, is invented in 0"
    )
    assert said["uneven_rim"].endswith("another part in 1, is invented in 0")
    assert said["cats_eye"].startswith("found in 0 of the 1 that have it, missed in 0;")
    assert said["obstruction"].endswith("is invented in 1 (3)")


def test_a_plan_that_is_silent_of_modes_changes_nothing_else(drawn: list[Drawn]) -> None:
    one = KINDS["silent"](1, 7)
    assert one.plan == drawn[7].plan.replace(fit={"zernike_noll": None})
    assert one.settings == drawn[7].settings
