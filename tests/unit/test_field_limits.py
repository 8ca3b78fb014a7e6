"""Verdicts on a field by the limits of a plan."""

from typing import Any

import numpy as np
import pytest

from labkit.errors import PlanError
from labkit.field.limits import Judged, judge, judge_limits
from labkit.field.places import field_points
from labkit.field.terms import lens_terms
from labkit.optics.field import FieldModel
from labkit.optics.mtf import mtf50
from labkit.plan import Limits
from labkit.uncertain import Uncertain
from tests.field_samples import FRAME, a_field


def a_lens() -> FieldModel:
    """Blurred to the right, tilted and with coma."""
    model = a_field()
    model.waves[0, 0, :5] = 0.02, 0.01, 0.0, 0.03, 0.04
    model.waves[0, 1, 0] = 0.1
    model.waves[0, 3, 0] = 0.02
    return model


def judged(**limits: Any) -> dict[str, Judged]:
    made = judge_limits(Limits(**limits), a_lens(), "G")
    return {one.name: one for one in made}


def test_a_number_on_either_side_of_its_limit_passes_or_fails_and_close_to_it_neither() -> (
    None
):
    number = {"": Uncertain(50.0, 1.0, "cycles/mm")}
    # 95 % of one side is 1.645 standard errors
    for limit, verdict in {48.3: "pass", 48.4: "cannot tell"}.items():
        assert judge("x", limit, number, 0.95, is_least=True).verdict == verdict
    for limit, verdict in {51.7: "fail", 51.6: "cannot tell"}.items():
        assert judge("x", limit, number, 0.95, is_least=True).verdict == verdict
    assert judge("x", 48.3, number, 0.95, is_least=False).verdict == "fail"
    assert judge("x", 51.7, number, 0.95, is_least=False).verdict == "pass"


def test_a_limit_from_above_holds_both_signs() -> None:
    number = {"": Uncertain(-5.0, 0.1)}
    assert judge("x", 4.0, number, 0.95, is_least=False).verdict == "fail"
    assert judge("x", 6.0, number, 0.95, is_least=False).verdict == "pass"


def test_numbers_without_an_error_cannot_be_told() -> None:
    for std in (np.nan, np.inf):
        number = {"": Uncertain(50.0, std)}
        assert judge("x", 10.0, number, 0.95, is_least=True).verdict == "cannot tell"
    nothing = judge("x", 10.0, {}, 0.95, is_least=True)
    assert (nothing.verdict, nothing.where) == ("cannot tell", "not measured")


@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_verdicts_are_wrong_no_more_often_than_stated(confidence: float) -> None:
    """Eight numbers are exactly at their limit: neither verdict is right."""
    rng = np.random.default_rng(7)
    verdicts = []
    for _ in range(2000):
        values = rng.normal(50, 1, 8)
        numbers = {str(k): Uncertain(value, 1.0) for k, value in enumerate(values)}
        verdicts.append(judge("x", 50.0, numbers, confidence, is_least=True).verdict)
    wrong = 1 - confidence
    # a share of 10 % in 2000 has a standard error of 0.7 %; eight tests are exact to 0.5 %
    assert verdicts.count("fail") / 2000 == pytest.approx(wrong, abs=0.02)
    assert verdicts.count("pass") / 2000 <= wrong


def test_the_worst_corner_and_direction_decide() -> None:
    model = a_lens()
    corners = {name: field_points(FRAME)[name] for name in ("top right", "bottom right")}
    halves = {
        f"{name}, {direction}": mtf50(
            model.wavefront("G", place), direction, FRAME.heights_mm(place).tolist()
        ).value
        for name, place in corners.items()
        for direction in ("sagittal", "tangential")
    }
    worst = min(halves.values())
    one = judged(corner_mtf50=worst + 20)["corner_mtf50"]
    assert one.verdict == "fail"
    assert one.number.value == pytest.approx(worst)
    assert halves[one.where] == worst
    assert judged(corner_mtf50=worst - 20)["corner_mtf50"].verdict == "pass"


def test_every_limit_of_a_plan_is_measured_or_says_that_it_is_not() -> None:
    names = [name for name in Limits.model_fields if name != "confidence"]
    found = judged(**dict.fromkeys(names, 0.5))
    assert list(found) == names
    not_of_the_wavefront = {n for n, one in found.items() if one.where == "not measured"}
    assert not_of_the_wavefront == {"distortion_percent", "lateral_colour_um"}
    given = {"distortion_percent": {"": Uncertain(0.3, 0.01, "%")}}
    limits = Limits(distortion_percent=0.5)
    assert judge_limits(limits, a_lens(), "G", given)[0].verdict == "pass"


def test_limits_have_the_units_of_their_names() -> None:
    terms = lens_terms(a_lens(), "G")
    found = judged(
        tilt_um=1,
        tilt_arcmin=1,
        tilt_um_per_mm=1,
        curvature_um=1,
        linear_astigmatism_waves=1,
    )
    slope = terms.tilt.slope.magnitude.value
    assert found["tilt_um_per_mm"].number.value == pytest.approx(slope)
    assert found["tilt_arcmin"].number.value == pytest.approx(slope * 3.437747, rel=1e-6)
    # the tilt is along the rows: its peak to valley is over the frame's width
    assert found["tilt_um"].number.value == pytest.approx(slope * 768 * 5.2e-3)
    corner_um = 1e3 * terms.curvature.value * FRAME.radius_mm**2
    assert found["curvature_um"].number.value == pytest.approx(corner_um)


def test_a_limit_without_its_unit_is_named_in_one_line() -> None:
    with pytest.raises(PlanError, match="tilt is no known key; did you mean tilt_um"):
        Limits.from_tables({"tilt": 3})
    with pytest.raises(PlanError, match=r"corner_mtf_at_20.*0 to 1"):
        Limits.from_tables({"corner_mtf_at_20": 20})
