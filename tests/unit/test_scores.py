"""What frames say of parts that their model lacks, against climbs with the parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.camera import chance_gain
from labkit.estimation.climb import Problem, Start
from labkit.estimation.expansion import Freed, free_f_number, with_modes
from labkit.estimation.scores import ScoreTest, score_tests, twin_scores
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts import KNOWN, Diffusion, LowPass, Part, SpectrumWidth, Veil
from labkit.imaging.parts.blur import SCALE_PX
from labkit.optics.spectrum import Spectrum
from labkit.plan.mode_groups import MODE_GROUPS
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH, photographed

EVERY = [name for name, part in KNOWN.items() if part.sought]
SPECTRUM = SpectrumWidth.name


def problem(*parts: Part) -> Problem:
    """Frames taken with parts of a camera, and a model without."""
    with_them = ForwardModel.build(
        replace(OPTICS, given=parts),
        CARPET,
        FRAME,
        POSE,
        f_number_margin=SETTINGS.f_number_margin,
    )
    without = ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    return replace(photographed(with_them), model=without)


def fitted(of: Problem) -> Freed:
    return free_f_number(of, Start(TRUTH), 0.03)


def asked(of: Problem) -> dict[str, ScoreTest]:
    freed = fitted(of)
    return score_tests(freed.expansion, freed.optics.lacking, 0.03)


def test_a_filter_is_called_for_by_as_much_as_a_climb_with_it_gains() -> None:
    frames = problem(LowPass(0.2, 0.15))
    plain, test = fitted(frames), asked(frames)["low_pass_filter"]
    model = frames.model.with_optics(OPTICS.with_parts(["low_pass_filter"]))
    climbed = free_f_number(replace(frames, model=model), Start(plain.solution.state), 0.03)
    gained = climbed.solution.objective - plain.solution.objective
    assert gained > 20
    assert test.gain == pytest.approx(
        gained, rel=0.3
    )  # 20.3 of 23.7: a cosine is no parabola
    rows, columns = climbed.measured.values[3:5]
    std = np.sqrt(np.diag(climbed.measured.covariance)[3:5])
    assert climbed.solution.converged
    assert abs(rows - 0.2) < 3 * std[0] < 0.08
    assert abs(columns - 0.15) < 3 * std[1] < 0.15


def test_what_photographs_call_for_does_not_depend_on_numbers_that_move_nothing() -> None:
    frames = problem(LowPass(0.2, 0.15))
    # a target that is no panel's: the panel's numbers are as their prior has them
    shown = replace(
        frames, model=frames.model.with_optics(replace(OPTICS, panel=Aperture()))
    )
    ours, plain = asked(shown), asked(frames)
    assert ours.keys() == plain.keys()
    for name, test in plain.items():
        np.testing.assert_allclose(
            ours[name].information,
            test.information,
            rtol=1e-6,
            atol=1e-6 * np.abs(test.information).max(),
        )
        np.testing.assert_allclose(
            ours[name].slope,
            test.slope,
            rtol=1e-6,
            # two climbs: up to 6.1e-6 standard errors apart, by machine
            atol=1e-5 * np.sqrt(np.abs(test.information).max()),
        )


def test_a_veil_is_climbed_to_with_its_width() -> None:
    frames = problem(Veil(0.02, 7.0))
    model = frames.model.with_optics(OPTICS.with_parts(["veil"]))
    climbed = free_f_number(
        replace(frames, model=model), Start(fitted(frames).solution.state), 0.03
    )
    share, log_scale = climbed.measured.values[3:5]
    std = np.sqrt(np.diag(climbed.measured.covariance)[3:5])
    assert climbed.solution.converged
    assert abs(share - 0.02) < 3 * std[0] < 0.01
    assert abs(log_scale - np.log(7 / SCALE_PX)) < 3 * std[1] < 0.6, (share, log_scale, std)


def test_a_plain_camera_calls_for_nothing() -> None:
    # twice the gain of n numbers is chi-squared of n at most: beyond 7 once in a thousand for three of them
    assert {
        name: test.gain for name, test in asked(problem()).items() if test.gain > 7
    } == {}


def test_a_model_that_has_everything_calls_for_nothing() -> None:
    assert score_tests(fitted(problem()).expansion, [], 0.03) == {}


def test_what_a_plan_gives_is_not_asked_for() -> None:
    assert replace(OPTICS, given=(LowPass(0.3, 0.3),)).lacking == [
        name for name in EVERY if name != "low_pass_filter"
    ]
    assert replace(OPTICS, spectrum=Spectrum()).lacking == [
        name for name in EVERY if name != SPECTRUM
    ]
    assert OPTICS.with_parts(["veil"]).lacking == [name for name in EVERY if name != "veil"]


def test_a_part_of_each_name_can_be_added() -> None:
    for name, part in KNOWN.items():
        assert OPTICS.with_parts([name]).parts == (part,)
        assert OPTICS.with_parts([name]).without([name]) == OPTICS
    assert OPTICS.with_parts([SPECTRUM]).camera_labels == ("spectrum.variance",)
    assert replace(OPTICS, parts=(Diffusion(0.1),)).with_parts(["veil"]).camera_labels == (
        "diffusion.variance_px2",
        "veil.share",
        "veil.log_scale",
    )


# groups of modes

HIGHER = (0.02, -0.015, 0.01, 0.012, -0.02, 0.01)
"""Noll 16 to 21, waves RMS."""


def higher_problem(waves: tuple[float, ...]) -> Problem:
    """Return frames taken through a lens with modes 16 to 21, and a model without these modes."""
    lens = replace(OPTICS, noll=(*OPTICS.noll, *MODE_GROUPS["modes_16_21"].noll))
    with_them = ForwardModel.build(
        lens, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    without = ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    truth = replace(TRUTH, waves=np.array([*TRUTH.waves, *waves]))
    return replace(photographed(with_them, truth), model=without)


def test_modes_gain_as_much_as_a_climb_with_them_gains() -> None:
    frames = higher_problem(HIGHER)
    plain = fitted(frames)
    tests = score_tests(plain.expansion, ["modes_16_21", "modes_22_28"], 0.03)
    wider = OPTICS.with_parts(["modes_16_21"])
    start = with_modes(plain.solution.state, OPTICS, wider)
    climbed = free_f_number(
        replace(frames, model=frames.model.with_optics(wider)), Start(start), 0.03
    )
    gained = climbed.solution.objective - plain.solution.objective
    assert climbed.solution.converged
    assert gained > 100
    assert tests["modes_16_21"].gain == pytest.approx(gained, rel=0.2)
    std = np.sqrt(np.diag(climbed.covariance))
    true = np.array([*TRUTH.waves, *HIGHER])
    assert np.abs((climbed.solution.state.waves - true) / std).max() < 3.5
    # seven further modes, which are not there
    further = tests["modes_22_28"].gain - tests["modes_16_21"].gain
    assert 0 < further < chance_gain(7)


def test_a_fit_without_modes_is_off_by_what_they_move() -> None:
    waves = 0.1 * np.array(HIGHER)
    plain, off = fitted(higher_problem((0.0,) * 6)), fitted(higher_problem(tuple(waves)))
    test = score_tests(plain.expansion, ["modes_16_21"], 0.03)["modes_16_21"]
    std = np.sqrt(np.diag(plain.measured.covariance))
    moved = (off.measured.values - plain.measured.values) / std
    assert test.moves is not None
    assert np.abs(moved).max() > 0.5
    # measured 0.030: the likelihood is no parabola
    np.testing.assert_allclose(-waves @ test.moves / std, moved, atol=0.06)


def test_a_lens_without_higher_modes_shows_none() -> None:
    names = ["modes_16_21", "modes_22_28", "modes_29_36"]
    tests = score_tests(fitted(problem()).expansion, names, 0.03)
    for numbers, name in zip((6, 13, 21), names, strict=True):
        assert tests[name].slope.shape == (numbers,)
        assert tests[name].gain < chance_gain(numbers)


def test_the_twin_shows_the_even_modes_with_the_other_sign() -> None:
    expansion = fitted(higher_problem(HIGHER)).expansion
    tests = score_tests(expansion, ["veil", "modes_16_21", "modes_22_28"], 0.03)
    twin = twin_scores(tests, np.array([-1.0, 1.0, 1.0, 1.0, 1.0]))
    np.testing.assert_array_equal(twin["veil"].slope, tests["veil"].slope)
    odd, even = np.split(twin["modes_22_28"].slope, [6])
    np.testing.assert_array_equal(odd, tests["modes_22_28"].slope[:6])
    np.testing.assert_array_equal(even, -tests["modes_22_28"].slope[6:])
    for name, test in twin.items():
        assert test.gain == pytest.approx(tests[name].gain, rel=1e-9)
