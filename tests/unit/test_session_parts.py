"""What a session found of its camera: from fits that measured it along, to numbers with units and to words."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from labkit.analysis.session_findings import (
    camera_findings,
    part_findings,
    session_findings,
)
from labkit.analysis.session_parts import model_parts, widest_light_nm
from labkit.estimation.candidate import Measured, Observed
from labkit.estimation.estimate import Estimate, LocalFit
from labkit.estimation.select import select
from labkit.findings.findings import Finding, Moves, found
from labkit.imaging.parts import Obstruction, SpectrumWidth
from labkit.key import Key
from labkit.plan import Plan
from labkit.results.model import PartTried
from tests.lens_samples import measured_of, members, stated, with_measured
from tests.plans import PORTRAIT

FILTER = ("low_pass_filter.rows_px2", "low_pass_filter.columns_px2")
(WIDTH_LABEL,) = (f"{SpectrumWidth.name}.{label}" for label in SpectrumWidth.labels)
ROWS, COLUMNS, WIDTH = 0.55**2, 0.40**2, 0.03**2
PATIENCE_S = 60.0


def with_parts(
    one: Observed, labels: tuple[str, ...], values: list[float], std: list[float]
) -> Observed:
    """A fit that measured its camera along; what it errs by in the first number, it errs by in defocus too."""
    plain = measured_of(one)
    wider = np.insert(plain.values, 1, values)
    covariance, common = np.zeros((len(wider), len(wider))), np.zeros(len(wider))
    at = [0, *range(1 + len(labels), len(wider))]
    covariance[np.ix_(at, at)] = plain.covariance
    of = np.arange(1, 1 + len(labels))
    covariance[of, of] = np.square(std)
    common[[0, 1]] = 1e-3, std[0]
    covariance += np.outer(common, common)
    return with_measured(
        one, Measured((4,), wider, covariance, 0 * covariance, parts=labels)
    )


def session(labels: tuple[str, ...], values: list[float], std: list[float]) -> Estimate:
    every = members((980.0, 1010.0, 1040.0), 1010.0, 70.0, 2.8)
    green = [one for one in every if one.reading.key.channel == "G"]
    selection = select(
        [with_parts(one, labels, values, std) for one in green], stated(70.0, 2.8)
    )
    assert selection.members.all()
    return Estimate((), selection.lens)


def test_a_filter_is_given_by_how_far_apart_its_spots_lie() -> None:
    fits = session(FILTER, [ROWS, COLUMNS], [0.003, 0.006])
    found = model_parts(fits, Plan.from_tables(PORTRAIT))
    assert [*found] == [
        f"low_pass_filter.{what}_px" for what in ("spread", "rows", "columns")
    ]
    spread, rows, columns = found.values()
    assert spread.value == pytest.approx(np.sqrt((ROWS + COLUMNS) / 2))
    assert (rows.value, columns.value) == pytest.approx((0.55, 0.40))
    # of three fits; the slope of a root is half its inverse
    assert columns.std == pytest.approx(0.006 / np.sqrt(3) / (2 * 0.40), rel=1e-6)
    assert (
        0.003 / np.sqrt(3) / (2 * 0.55)
        < rows.std
        < 1.01 * np.sqrt(2) * 0.003 / np.sqrt(3) / (2 * 0.55)
    )


@pytest.mark.parametrize(("value", "share"), [(WIDTH, 1.0), (-1e-4, 0.0)])
def test_a_width_that_was_estimated_is_bounded_by_its_own_error(
    value: float, share: float
) -> None:
    fits = session((WIDTH_LABEL,), [value], [3e-4])
    std = 3e-4 * np.sqrt(2 / 3)  # of three fits, each with a common error as large
    most = widest_light_nm(fits, Plan.from_tables(PORTRAIT))
    assert most == {
        "G": pytest.approx(550 * np.sqrt(share * WIDTH + 1.645 * std), rel=0.02)
    }


def test_what_was_found_is_said() -> None:
    fits = session(FILTER, [ROWS, COLUMNS], [0.003, 0.006])
    fits = replace(fits, tried=(PartTried("low_pass_filter", 120.0, adopted=True),))
    moves = Moves({"G": 0.02}, 0.01, 0.03)
    (finding,) = part_findings(
        fits, model_parts(fits, Plan.from_tables(PORTRAIT)), moves=moves
    )
    assert finding.code == "camera-part-found"
    assert finding.text.startswith(
        "the photographs show an optical low-pass filter, which the plan does not state: rows 0.55"
    )
    numbers = dict(finding.numbers)
    values = numbers.pop("values")
    assert numbers == {
        "part": "low_pass_filter",
        "log_likelihood_gain": 120.0,
        "best_focus_moves_mm": {"G": 0.02},
        "waves_move": 0.01,
        "psf_moves_l1": 0.03,
    }
    assert isinstance(values, dict)
    assert set(values) == {"spread_px", "rows_px", "columns_px"}
    assert values["rows_px"]["value"] == pytest.approx(0.55)


def test_a_rim_that_ended_at_its_bound_is_named_once_for_all_fits() -> None:
    bound, free = (
        cast(
            LocalFit,
            SimpleNamespace(optimum=SimpleNamespace(optics=SimpleNamespace(parts=parts))),
        )
        for parts in ((Obstruction().at((2.0,)),), (Obstruction(0.2),))
    )
    (finding,) = camera_findings(Estimate((bound, free, bound), None), [], {})
    assert finding.code == "pupil-at-bound"
    assert finding.text.startswith("the obstruction ended at the limit")
    assert not camera_findings(Estimate((free,), None), [], {})


def test_a_part_that_the_plan_wants_fitted_is_no_news() -> None:
    fits = session(FILTER, [ROWS, COLUMNS], [0.003, 0.006])
    assert (
        list(
            part_findings(
                fits, model_parts(fits, Plan.from_tables(PORTRAIT)), ["low_pass_filter"]
            )
        )
        == []
    )


def fitted(range_mm: float, channel: str) -> LocalFit:
    """A fit of defocus, of which findings need its key, its modes and its search."""
    return cast(
        LocalFit,
        SimpleNamespace(
            observation=SimpleNamespace(key=Key(range_mm, channel)),
            optimum=SimpleNamespace(noll=(4,)),
            found=SimpleNamespace(cut_short=False),
        ),
    )


def test_a_session_reports_what_its_lens_leaves_open() -> None:
    fits = session(FILTER, [ROWS, COLUMNS], [0.003, 0.006])
    green = [fitted(1000.0 + k, "G") for k in range(3)]
    red = [fitted(1000.0 + k, "R") for k in range(2)]

    def opened(*signed: int) -> list[Finding]:
        session = replace(fits, fits=(*green, *red), members=tuple(range(5)), signed=signed)
        every = session_findings(session, PATIENCE_S)
        return [one for one in every if one.code == "defocus-sign-open"]

    assert opened(0, 1, 2, 3, 4) == []
    assert opened(3, 4) == [found("defocus-sign-open", Key(None, "G"))]
    assert opened(0, 1, 2, 4) == [found("defocus-sign-open", Key(1000.0, "R"))]
    assert opened() == [found("defocus-sign-open", None, {"where": "all wavefronts"})]
    (without,) = session_findings(replace(fits, lens=None), PATIENCE_S)
    assert (without.code, without.numbers) == (
        "no-best-focus",
        {"why": "defocus was not fitted"},
    )


def test_a_spectrum_is_each_channels_own() -> None:
    found = model_parts(
        session((WIDTH_LABEL,), [WIDTH], [1e-4]), Plan.from_tables(PORTRAIT)
    )
    assert set(found) == {"spectrum.G.width_nm"}
    assert found["spectrum.G.width_nm"].value == pytest.approx(0.03 * 550)


def test_a_square_that_came_out_below_nothing_is_nothing_with_an_error() -> None:
    found = model_parts(
        session(("diffusion.variance_px2",), [-1e-4], [4e-4]), Plan.from_tables(PORTRAIT)
    )
    assert found["diffusion.sigma_px"].value == 0.0
    assert 4e-4 / np.sqrt(3) < found["diffusion.sigma_px"].std ** 2 < 4e-4 * np.sqrt(2)
