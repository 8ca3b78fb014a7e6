"""What frames say of parts that their model lacks, against climbs with the parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.climb import Problem, Start
from labkit.estimation.expansion import Freed, free_cone
from labkit.estimation.scores import ScoreTest, score_tests
from labkit.estimation.settings import SETTINGS
from labkit.imaging.aperture import Aperture
from labkit.imaging.model import ForwardModel
from labkit.imaging.parts import KNOWN, Diffusion, LowPass, Part, SpectrumWidth, Veil
from labkit.imaging.parts.veil import SCALE_PX
from labkit.optics.spectrum import Spectrum
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH, photographed

EVERY = [*KNOWN]
SPECTRUM = SpectrumWidth.name


def problem(*parts: Part) -> Problem:
    """Frames taken with parts of a camera, and a model without."""
    with_them = ForwardModel.build(
        replace(OPTICS, given=parts), CARPET, FRAME, POSE, cone_margin=SETTINGS.cone_margin
    )
    without = ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, cone_margin=SETTINGS.cone_margin
    )
    return replace(photographed(with_them), model=without)


def fitted(of: Problem) -> Freed:
    return free_cone(of, Start(TRUTH), 0.03)


def asked(of: Problem) -> dict[str, ScoreTest]:
    freed = fitted(of)
    return score_tests(freed.expansion, freed.optics.lacking, 0.03)


def test_a_filter_is_called_for_by_as_much_as_a_climb_with_it_gains() -> None:
    frames = problem(LowPass(0.2, 0.15))
    plain, test = fitted(frames), asked(frames)["low_pass_filter"]
    model = frames.model.with_optics(OPTICS.with_parts(["low_pass_filter"]))
    climbed = free_cone(replace(frames, model=model), Start(plain.solution.state), 0.03)
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
        np.testing.assert_allclose(ours[name].information, test.information, rtol=1e-6)
        np.testing.assert_allclose(ours[name].slope, test.slope, rtol=1e-6)


def test_a_veil_is_climbed_to_with_its_width() -> None:
    frames = problem(Veil(0.02, 7.0))
    model = frames.model.with_optics(OPTICS.with_parts(["veil"]))
    climbed = free_cone(
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
