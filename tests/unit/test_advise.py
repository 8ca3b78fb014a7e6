"""Advice before a capture, against closed forms and against what a session of that plan then gave."""

import json
from math import isfinite
from pathlib import Path

import pytest

from labkit.analysis.advise import advise, best_order
from labkit.cli import run
from labkit.demo import PLAN
from labkit.errors import DataError, PlanError
from labkit.plan import Plan, parse_plan

TEXT = PLAN.format(address="simulated:")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return parse_plan(TEXT, Path())


@pytest.mark.slow
def test_errors_are_those_that_a_session_of_this_plan_had(plan: Plan) -> None:
    # labkit demo, seed 1: best focus +- 0.026 mm and defocus +- 0.0001 a colour, mp +- 0.0027 from three colours
    advice = advise(plan)
    assert advice.best_focus_std_mm == pytest.approx(0.026, rel=0.3)
    assert advice.magnification_std == pytest.approx(0.0027 * 3**0.5, rel=0.3)
    assert all(0.5e-4 < one.std_defocus_waves < 2e-4 for one in advice.ranges)
    assert advice.told


def test_the_order_is_the_largest_that_an_airy_disc_resolves(plan: Plan) -> None:
    # 1.2197 * 450e-6 mm * 2.8 / 70 mm * 3200 mm = 0.0703 mm; 46.8 mm / 0.0703 mm = 666 = 3^5.9
    assert best_order(plan, 3200.0) == 5
    assert best_order(plan, 500.0) == 7


@pytest.mark.slow
def test_the_least_side_is_that_of_cells_as_wide_as_an_airy_radius(plan: Plan) -> None:
    (one,) = advise(plan, ranges_mm=[3200.0]).ranges
    assert one.size_mm == pytest.approx(3**5 * 0.0703, rel=1e-3)
    assert one.cell_airy == pytest.approx(46.8 / (3**5 * 0.0703), rel=1e-3)


@pytest.mark.slow
def test_a_display_is_resolved_from_where_its_pixels_span_an_airy_radius(plan: Plan) -> None:
    advice = advise(plan, ranges_mm=[3000.0])
    assert advice.nearest_mm == pytest.approx(25.4 / 264 / (0.0703 / 3200), rel=1e-3)
    assert any("display's own pixels" in note for note in advice.notes)


def test_cells_finer_than_the_displays_pixels_are_named(plan: Plan) -> None:
    small = plan.model_copy(update={"target": plan.target.model_copy(update={"size_mm": 15.0})})
    assert any("finer than the display's pixels" in note for note in advise(small, ranges_mm=[3000.0]).notes)


def test_far_away_the_magnification_is_not_told(plan: Plan) -> None:
    advice = advise(plan, ranges_mm=[30000.0, 32000.0, 34000.0])
    assert not advice.told
    assert advice.magnification_std is not None
    assert advice.magnification_std > 1


@pytest.mark.slow
def test_errors_fall_with_the_square_root_of_light(plan: Plan) -> None:
    dim, bright = (advise(plan, ranges_mm=[3200.0], electrons=e).ranges[0] for e in (4e4, 16e4))
    assert dim.std_wavefront_waves / bright.std_wavefront_waves == pytest.approx(2.0, rel=0.02)


@pytest.mark.slow
def test_photographs_for_an_error_that_is_wanted(plan: Plan) -> None:
    now = advise(plan, ranges_mm=[3200.0]).ranges[0].std_wavefront_waves
    assert advise(plan, ranges_mm=[3200.0], want_waves=now / 3).frames == pytest.approx(9 * 2, abs=1)
    assert advise(plan, ranges_mm=[3200.0], want_waves=10 * now).frames == 1


@pytest.mark.slow
def test_ranges_that_tell_the_magnification_do_tell_it(plan: Plan) -> None:
    faint = advise(plan, electrons=100.0)
    assert not faint.told
    proposed = advise(plan, ranges_mm=faint.telling_ranges_mm, electrons=100.0)
    assert proposed.told


def test_a_lone_range_gives_no_focus(plan: Plan) -> None:
    advice = advise(plan, ranges_mm=[3000.0])
    assert advice.best_focus_std_mm is None
    assert advice.magnification_std is None


def test_a_pattern_that_tells_nothing_is_said_not_raised(tmp_path: Path) -> None:
    (tmp_path / "grey.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes([255] * 16))
    image = 'kind = "image"\nfile = "grey.pgm"\nsize_mm = 46.8\nsurround = "white"\n'
    text = TEXT[: TEXT.index('kind = "sierpinski"')] + image + TEXT[TEXT.index("\n[fit]") :]
    advice = advise(parse_plan(text, tmp_path), ranges_mm=[3000.0])
    assert not isfinite(advice.ranges[0].std_defocus_waves)
    assert any("leave open" in note for note in advice.notes)
    assert advice.as_json()["ranges"][0]["std_defocus_waves"] is None


def test_what_cannot_be_advised_on(plan: Plan) -> None:
    with pytest.raises(PlanError, match="no ranges"):
        advise(plan.model_copy(update={"rail": None}))
    with pytest.raises(PlanError, match="more than the focal length, 70 mm"):
        advise(plan, ranges_mm=[60.0])
    with pytest.raises(PlanError, match="range nan mm: allowed"):
        advise(plan, ranges_mm=[float("nan")])
    with pytest.raises(DataError, match="wanted error = 0 waves: allowed"):
        advise(plan, want_waves=0.0)
    with pytest.raises(DataError, match="electrons = inf: allowed"):
        advise(plan, electrons=float("inf"))


@pytest.mark.slow
def test_the_command_answers_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.toml").write_text(TEXT)
    assert run(["advise", str(tmp_path / "plan.toml"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [one["range_mm"] for one in answer["ranges"]] == [3000.0, 3200.0, 3300.0]
    assert run(["advise", str(tmp_path / "none.toml")]) == 2
