"""What results say of their numbers: which optima are found, what the model explains, and which numbers hold."""

from dataclasses import replace
from math import isnan

import numpy as np
import pytest

from labkit.findings.findings import Finding
from labkit.results import OptimumTest, Wavefront, verdicts
from tests.results_samples import ACCEPTED, REJECTED, a_wavefront, some_results
from tests.unit.test_findings import SAMPLES

INCOMPLETE = replace(ACCEPTED, name="session", explains=False)
UNDETERMINED = replace(REJECTED, undetermined=("mode 4",))


def rows(*wavefronts: Wavefront) -> list[tuple[str, ...]]:
    table = some_results(wavefronts=wavefronts).wavefront_rows()
    assert table[0][-2:] == ["optimum", "model"]
    return [tuple(row[-2:]) for row in table[1:]]


def test_optimum_and_model_are_two_columns() -> None:
    tests = (ACCEPTED, INCOMPLETE, REJECTED, UNDETERMINED, None)
    wavefronts = [a_wavefront(3000.0 + k, test=test) for k, test in enumerate(tests)]
    assert rows(*wavefronts) == [
        ("found", "explains the photographs"),
        ("found", "incomplete"),
        ("doubtful", "incomplete"),
        ("undetermined", "incomplete"),
        ("untested", "untested"),
    ]


def test_the_headline_says_which_numbers_hold() -> None:
    def said(*tests: object) -> str:
        wavefronts = tuple(a_wavefront(3000.0 + k, test=t) for k, t in enumerate(tests))
        return some_results(wavefronts=wavefronts).headline

    assert said(ACCEPTED, ACCEPTED).startswith("all numbers hold within their errors")
    assert said(ACCEPTED, REJECTED).startswith("do not use R at 3001 mm: the optimum is")
    incomplete = said(*[INCOMPLETE] * 8)
    assert incomplete.startswith("in 8 of 8 fits the model is incomplete")
    assert "of the fitted modes alone" in incomplete
    assert "errors are not known" in said(INCOMPLETE)
    assert "untested" in said(None)
    is_open = some_results(wavefronts=(a_wavefront(sign_open=True),)).headline
    assert is_open.endswith("the sign of even modes is open: R at 3000 mm")
    assert said(REJECTED, REJECTED).startswith("do not use all 2 fits")


@pytest.mark.parametrize("code", verdicts.CONTRADICTIONS)
def test_no_error_of_an_incomplete_model_is_said_to_hold_where_the_plan_is_in_doubt(
    code: str,
) -> None:
    (doubt,) = (one for one in SAMPLES if one.code == code)

    def said(test: OptimumTest, *findings: Finding) -> str:
        two = tuple(a_wavefront(3000.0 + k, test=test) for k in range(2))
        return some_results(wavefronts=two, findings=findings).headline

    assert "best focus hold within their errors" in said(INCOMPLETE)
    assert "best focus hold" not in said(INCOMPLETE, doubt)
    assert said(INCOMPLETE, doubt).endswith("check plan and modes first")
    assert said(ACCEPTED, doubt) == said(ACCEPTED)


def test_no_error_of_an_incomplete_model_is_said_to_hold_where_no_sign_is_known() -> None:
    def said(*is_open: bool) -> str:
        return some_results(
            wavefronts=tuple(
                a_wavefront(3000.0 + k, test=INCOMPLETE, sign_open=one)
                for k, one in enumerate(is_open)
            )
        ).headline

    assert "best focus hold within their errors" in said(False, True)
    assert "best focus hold" not in said(True, True)


def test_two_colours_at_one_range_confirm_no_error_of_an_incomplete_model() -> None:
    colours = tuple(a_wavefront(3000.0, c, test=INCOMPLETE) for c in ("R", "B"))
    headline = some_results(wavefronts=colours).headline
    assert "errors are not known" in headline
    assert "hold" not in headline


def test_the_file_and_the_table_of_coefficients_mark_errors_that_are_not_known() -> None:
    pytest.importorskip("pandas")
    wavefronts = (a_wavefront(test=INCOMPLETE), a_wavefront(channel="G", test=ACCEPTED))
    results = some_results(wavefronts=wavefronts, focus=None)
    entries = results.as_json()["wavefronts"]
    assert [entry["errors_known"] for entry in entries] == [False, True]
    table = results.to_dataframe()
    assert table.groupby("channel")["errors_known"].all().to_dict() == {
        "G": True,
        "R": False,
    }


@pytest.mark.parametrize(
    ("tests", "known"),
    [
        ((ACCEPTED,), True),
        ((INCOMPLETE,), False),  # no other range shows what the model lacks
        ((INCOMPLETE, INCOMPLETE), True),
        ((REJECTED,), False),
        ((None,), True),
    ],
)
def test_an_error_is_printed_where_it_is_known(
    tests: tuple[object, ...], known: bool
) -> None:
    wavefronts = tuple(a_wavefront(3000.0 + k, test=t) for k, t in enumerate(tests))
    results = some_results(wavefronts=wavefronts, focus=None)
    (one,) = results.at_best_focus()
    assert one.strehl is not None
    assert isnan(one.strehl.std) is not known
    assert results.lens_rows()[1][1].endswith("± unknown") is not known


def test_a_fit_of_defocus_alone_has_no_strehl_ratio() -> None:
    alone = a_wavefront(noll=(4,), waves=np.array([0.1]), covariance=1e-6 * np.eye(1))
    row = some_results(wavefronts=(alone,)).lens_rows()[1]
    assert row[1:6] == ["not fitted"] * 5


def test_the_summary_has_a_row_for_each_channel_with_errors() -> None:
    pytest.importorskip("pandas")
    results = some_results()
    table = results.summary()
    assert table["channel"].tolist() == ["R", "B"]
    best = results.nearest_focus("B").best
    assert table["strehl"][1] == best.strehl.value
    assert table["strehl_std"][1] == best.strehl.std
    assert table["mtf50_y_per_mm"][1] == best.mtf50("y").value
    assert table["best_focus_mm"].tolist() == [2986.84, 2987.31]
    assert table["colour_mm"][1] == pytest.approx(0.47)
    assert table["colour_mm_std"][1] == pytest.approx(np.sqrt(2))  # the covariance is 1
    assert table["colour_um"].notna().tolist() == [False, True]
    assert table["model"].tolist() == ["explains the photographs"] * 2


def test_longitudinal_colour_is_a_table_with_signs() -> None:
    heading, row = some_results().colour_rows()
    assert heading == ["longitudinal colour", "best focus/mm", "on the sensor/µm"]
    assert row[:2] == ["B \N{MINUS SIGN} R", "+0.5 ± 1.4"]
    assert some_results(focus=None).colour_rows() == []
