"""A session's estimate, against formulas written out in the tests and against data drawn from them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.analysis.session_results import as_focus, budget
from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Observed
from labkit.estimation.laws import FOCUS, MAGNIFICATION, RANGE_ZERO, Laws
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.optics.known_bias import covariance_with_bias
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.lens_samples import (
    COLOURS,
    NEAR,
    SIZE_STD,
    best_focus,
    covariance,
    laws,
    lens_of,
    measured,
    measured_of,
    members,
    moved,
    observed,
    stated,
    with_measured,
    with_values,
)

FAR = (3000.0, 3200.0, 3300.0)


def near_session(mp: float = 1.0, **changed: Any) -> tuple[list[Observed], Stated]:
    """60 mm f/4, focused at 482 mm."""
    return members(NEAR, 482.0, 60.0, 4.0, mp), stated(60.0, 4.0, **changed)


def test_a_lens_is_found_again() -> None:
    plan = stated(
        60.0, 4.0, f_number=Uncertain(4.1, 0.4), focal_length=Uncertain(60.0, 1e-9, "mm")
    )
    fit = lens_of(members(NEAR, 482.0, 60.0, 4.0, 0.93), plan)
    # prior values pull: the magnification's by (error / 0.7)^2 of its distance
    assert np.exp(fit.value(MAGNIFICATION)) == pytest.approx(0.93, abs=2e-5)
    assert fit.value("f-number") == pytest.approx(4.0, abs=1e-3)
    assert best_focus(fit, "G").value == pytest.approx(482.0, abs=1e-4)
    assert fit.value(RANGE_ZERO) == pytest.approx(0.0, abs=2e-3)


def test_errors_hold_what_a_part_that_is_missing_would_move() -> None:
    every, plan = near_session()
    fit, rng = lens_of(every, plan), np.random.default_rng(2)
    noise = fit.solved.normal.covariance
    shifts = np.array(
        [
            0.3 * rng.normal(size=3) * np.sqrt(np.diag(measured_of(one).covariance))
            for one in every
        ]
    )
    shifted = [
        with_values(one, measured_of(one).values + shift)
        for one, shift in zip(every, shifts, strict=True)
    ]
    there = lens_of(shifted, plan)
    moved = there.theta - fit.theta
    biased = replace(
        fit, bias=Point(moved, fit.solved.point.own), bias_chi2=there.chi2 - fit.chi2
    )
    widened = covariance_with_bias(noise * biased.birge_ratio**2, moved)
    np.testing.assert_allclose(biased.errors, widened)
    # the members disagree as they would after the move, not as they do now
    assert biased.chi2 == pytest.approx(there.chi2, rel=0.02)
    assert fit.chi2 < 1e-6 < 1 < biased.chi2
    assert biased.std(RANGE_ZERO) > fit.std(RANGE_ZERO)


def test_the_sources_of_an_error_with_a_bias_add_up_to_its_variance() -> None:
    every, plan = near_session()
    fit = lens_of(every, plan)
    biased = replace(
        fit, bias=Point(0.5 * np.sqrt(np.diag(fit.errors)), fit.solved.point.own)
    )
    for k, unit in enumerate(np.eye(len(biased.theta))):
        shares = biased.contributions(unit)
        assert sum(share**2 for share in shares.values()) == pytest.approx(
            biased.errors[k, k]
        )


def drawn(
    rng: np.random.Generator, plan: Stated, mp: float
) -> tuple[list[Observed], dict[str, float]]:
    """A session whose lens, tape, steps and sizes are off as stated, and whose fits err as they say; and its truth."""
    f, n = (rng.normal(x.value, x.std) for x in (plan.focal_length, plan.f_number))
    zero, size = rng.normal(0, plan.range_zero_std_mm), rng.normal(0, plan.size_std)
    best = {"R": 480.0, "G": 482.0, "B": 485.0}
    lateral = {"R": 2e-4, "G": 0.0, "B": -1e-4}
    steps = dict(zip(NEAR, rng.normal(0, plan.range_std_mm, len(NEAR)), strict=True))
    every = []
    for r in NEAR:
        for c in COLOURS:
            there = laws(r + zero + steps[r], best[c] + zero, best["G"] + zero, f, n, mp)
            clean = np.array(there) + np.array([0, 0, size + lateral[c]])
            floors = np.diag([SETTINGS.defocus_floor_waves**2, 0.0, SETTINGS.size_floor**2])
            noise = rng.multivariate_normal(np.zeros(3), covariance(clean[0]) + floors)
            every.append(observed(r, c, measured(clean + noise)))
    truth = {
        "R": best["R"],
        "B": best["B"],
        "focal length": f,
        "f-number": n,
        RANGE_ZERO: zero,
        MAGNIFICATION: np.log(mp),
    }
    return every, truth


def pulls(rng: np.random.Generator, actual: Stated, believed: Stated) -> Floats:
    """(6,) errors of one drawn session's estimate over what it says of them, without widening."""
    every, truth = drawn(rng, actual, 0.97)
    fit = lens_of(every, believed)
    scores = []
    for name, value in truth.items():
        unit = (
            fit.model.best_focus(name)
            if name in COLOURS
            else np.eye(len(fit.theta))[fit.model.index(name)]
        )
        scores.append(
            (unit @ fit.theta - value) / np.sqrt(unit @ fit.solved.normal.covariance @ unit)
        )
    return np.array(scores)


USUAL = stated(
    60.0,
    4.0,
    f_number=Uncertain(4.0, 0.12),
    range_zero_std_mm=1.0,
    range_std_mm=0.01,
    size_std=1e-4,
)


def test_errors_are_as_large_as_the_estimate_says() -> None:
    rng = np.random.default_rng(2)
    scores = np.array([pulls(rng, USUAL, USUAL) for _ in range(120)])
    # mean and std of 120 unit normals err by 1/sqrt(120) and 1/sqrt(240); allow four of them
    assert np.all(np.abs(scores.mean(axis=0)) < 4 / np.sqrt(120))
    assert np.all(np.abs(scores.std(axis=0) - 1) < 4 / np.sqrt(240))


def test_defocus_residuals_scatter_as_their_errors_say() -> None:
    rng, scores = np.random.default_rng(5), []
    for _ in range(60):
        green = focus_of(lens_of(drawn(rng, USUAL, 0.97)[0], USUAL)).residuals("G")
        scores.append([each.value / each.std for each in green])
    # the std of each residual in 60 sessions errs by 1/sqrt(120); allow four of them
    assert np.all(np.abs(np.array(scores).std(axis=0) - 1) < 4 / np.sqrt(120))


def test_the_misfit_of_a_session_is_as_large_as_chance_makes_it() -> None:
    rng = np.random.default_rng(4)
    fits = [lens_of(drawn(rng, USUAL, 0.97)[0], USUAL) for _ in range(40)]
    # nothing was known of three best focuses and of two colours' sizes
    assert [fit.degrees_of_freedom for fit in fits] == pytest.approx(
        [15 * 3 - 5] * 40, rel=1e-6
    )
    # the mean of 40 chi-squareds over their 40 freedoms errs by sqrt(2 / 1600); allow four of them
    assert np.mean([fit.reduced_chi2 for fit in fits]) == pytest.approx(
        1.0, abs=4 * np.sqrt(2 / 1600)
    )


def test_an_estimate_that_believes_the_rail_is_exact_is_wrong() -> None:
    rng, believed = np.random.default_rng(3), replace(USUAL, range_std_mm=0.0)
    scores = np.array([pulls(rng, USUAL, believed) for _ in range(40)])
    assert np.all(scores.std(axis=0)[:2] > 1.5)  # best focus: by 2.2 and 2.3


def independent_std(
    ranges: tuple[float, ...],
    focus: float,
    plan: Stated,
    size_std: float,
    *,
    floors: bool = True,
) -> dict[str, float]:
    """The standard errors by the information matrix of the printed laws, slopes by complex steps."""
    f, n, far = plan.focal_length, plan.f_number, max(ranges)
    axial, lateral = SETTINGS.colour_std * far, SETTINGS.colour_std
    # f, N, ln mp, zero, best focus, and of R and B: best focus and size beside green's; the steps of the rail
    centre = np.array(
        [f.value, n.value, 0.0, 0.0, focus, *np.zeros(4), *np.zeros(len(ranges))]
    )
    prior = [
        f.std,
        n.std,
        USUAL_LOG_MAGNIFICATION,
        plan.range_zero_std_mm,
        100 * far,
        axial,
        axial,
        lateral,
        lateral,
    ]
    information = np.diag(np.array([*prior, *(plan.range_std_mm for _ in ranges)]) ** -2.0)
    for k, r in enumerate(ranges):
        waves = laws(r, focus, focus, f.value, n.value, 1.0)[0]
        floor = (
            np.diag([SETTINGS.defocus_floor_waves**2, 0.0, SETTINGS.size_floor**2])
            if floors
            else 0.0
        )
        noise = covariance(waves, size_std=size_std) + floor
        for axial_at, lateral_at in ((5, 7), (None, None), (6, 8)):
            rows = []
            for t in centre + 1e-30j * np.eye(len(centre)):
                colour, size = (
                    (0.0, 0.0) if axial_at is None else (t[axial_at], t[lateral_at])
                )
                there = laws(
                    r + t[3] + t[9 + k],
                    t[4] + t[3] + colour,
                    t[4] + t[3],
                    t[0],
                    t[1],
                    np.exp(t[2]),
                )
                rows.append([*there[:2], there[2] + size])
            slope = np.array(rows).imag.T / 1e-30
            information += slope.T @ np.linalg.solve(noise, slope)
    scale = 1 / np.sqrt(np.diag(information))
    std = scale * np.sqrt(np.diag(np.linalg.inv(information * np.outer(scale, scale))))
    names = ("focal length", "f-number", MAGNIFICATION, RANGE_ZERO)
    return dict(zip(names, std, strict=False)) | {FOCUS: std[4]}


NO_SIZES = 10.0
CASES = {
    # of physics.md §15: best focus, f-number in per cent, focal length, magnification, zero point
    "far, exact": (
        FAR,
        3150.0,
        70.0,
        2.8,
        True,
        SIZE_STD,
        (0.037, None, None, 0.003, None),
    ),
    "far, no sizes": (
        FAR,
        3150.0,
        70.0,
        2.8,
        False,
        NO_SIZES,
        (0.038, 0.7, 0.22, 0.26, 5.0),
    ),
    "near, exact": (
        NEAR,
        482.0,
        60.0,
        4.0,
        True,
        SIZE_STD,
        (0.0017, None, None, 0.0007, None),
    ),
    "near, no sizes": (
        NEAR,
        482.0,
        60.0,
        4.0,
        False,
        NO_SIZES,
        (0.0020, 1.4, 0.34, 0.16, 4.4),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_standard_errors_are_those_of_an_independent_calculation(case: str) -> None:
    ranges, focus, f, n, exact, size_std, printed = CASES[case]
    held = {
        "focal_length": Uncertain(f, 1e-9),
        "f_number": Uncertain(n, 1e-9),
        "range_zero_std_mm": 1e-9,
    }
    plan = stated(f, n, **(held if exact else {}))
    fit = lens_of(members(ranges, focus, f, n, size_std=size_std), plan)
    found = {
        name: fit.std(name)
        for name in ("focal length", "f-number", MAGNIFICATION, RANGE_ZERO)
    }
    found[FOCUS] = best_focus(fit, "G").std
    for name, std in independent_std(ranges, focus, plan, size_std).items():
        if std > 1e-6:  # what is held exact has no error to compare
            assert found[name] == pytest.approx(std, rel=1.5e-7), name
    pure = independent_std(ranges, focus, plan, size_std, floors=False)
    numbers = [
        pure[name]
        for name in (FOCUS, "f-number", "focal length", MAGNIFICATION, RANGE_ZERO)
    ]
    numbers[1] *= 100 / n
    for number, wanted in zip(numbers, printed, strict=True):
        # the table does not say what it takes for known of the magnification beforehand, nor where focus lay
        assert wanted is None or wanted / 2 < number < 2 * wanted


def test_sizes_tell_of_pupils_and_f_number() -> None:
    plan = stated(70.0, 2.8)
    blind, seeing = (
        lens_of(members(FAR, 3150.0, 70.0, 2.8, size_std=std), plan).std(MAGNIFICATION)
        for std in (NO_SIZES, 1.5e-5)
    )
    assert seeing < blind / 3


def test_the_sources_of_an_error_add_up_to_its_variance() -> None:
    every, plan = near_session(
        size_std=1e-4, wavelength_std=dict.fromkeys(COLOURS, 0.005), range_std_mm=0.01
    )
    flats = [
        replace(measured_of(one), calibration=0.2 * measured_of(one).covariance)
        for one in every
    ]
    fit = lens_of(
        [with_measured(one, of) for one, of in zip(every, flats, strict=True)], plan
    )
    shares = budget(fit)
    for name, std in (
        ("best_focus_mm.R", best_focus(fit, "R").std),
        ("f_number", fit.std("f-number")),
    ):
        assert np.linalg.norm(list(shares[name].values())) == pytest.approx(std, rel=1e-6)
    assert shares["range_zero_mm"]["geometry"] > shares["range_zero_mm"]["photons"] > 0
    assert all(share["calibration"] > 0 for share in shares.values())


def test_errors_grow_where_the_members_disagree() -> None:
    every, plan = near_session()
    fit = lens_of(
        [moved(one, 0.01) if k % 4 == 0 else one for k, one in enumerate(every)], plan
    )
    assert fit.birge_ratio > 3
    shares = budget(fit)["best_focus_mm.G"]
    assert np.linalg.norm(list(shares.values())) == pytest.approx(
        best_focus(fit, "G").std, rel=1e-6
    )


def marginal(fit: LensFit) -> float:
    """Log-likelihood of all values, their columns integrated over priors, by one QR of all whitened rows."""
    columns = fit.model.columns
    std = np.array([column.prior_std for column in columns])
    away = (np.array([column.value for column in columns]) - fit.theta) / std
    noise = fit.measured.covariance + np.diag(fit.model.scatter())
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    rest = (whitening @ (fit.measured.values - fit.solved.predicted)[..., None]).ravel()
    rows = np.concatenate(
        [(whitening @ fit.solved.slopes).reshape(rest.size, -1) * std, np.eye(len(std))]
    )
    q, r = np.linalg.qr(rows)
    target = np.concatenate([rest, away])
    misfit = target - q @ (q.T @ target)
    log_determinant = (
        np.linalg.slogdet(noise)[1].sum() + 2 * np.log(np.abs(np.diag(r))).sum()
    )
    return float(-0.5 * (misfit @ misfit + log_determinant))


def test_the_evidence_of_two_laws_differs_as_their_gaussians_do() -> None:
    plan, every = stated(60.0, 4.0), members(NEAR[::2], 482.0, 60.0, 4.0, modes={7: 0.02})
    every = [moved(one, 2e-4 * (-1) ** k, modes=5e-4 * k) for k, one in enumerate(every)]
    looser = Laws(mode_scatter=0.003, f_number_std=0.1, size_scatter=1e-3)
    strict, loose = (lens_of(every, plan, of) for of in (Laws(), looser))
    difference = marginal(loose) - marginal(strict)
    assert abs(difference) > 10
    assert loose.log_evidence - strict.log_evidence == pytest.approx(difference, abs=1e-6)


def focus_of(fit: LensFit) -> Any:
    found = as_focus(fit)
    assert found is not None
    return found


def test_one_range_gives_no_best_focus() -> None:
    one = members((3000.0,), 3050.0, 70.0, 2.8)
    assert as_focus(lens_of(one, stated(70.0, 2.8))) is None


def test_far_ranges_tell_no_pupil_magnification() -> None:
    far = lens_of(
        members((30_000.0, 32_000.0, 33_000.0), 31_000.0, 70.0, 2.8), stated(70.0, 2.8)
    )
    assert not focus_of(far).identifiable
    assert focus_of(lens_of(*near_session())).identifiable


def test_defocus_that_no_lens_has_gives_no_magnification() -> None:
    every, plan = near_session()
    fit = lens_of([moved(one, 2 * measured_of(one).values[0] + 0.5) for one in every], plan)
    assert fit.p_value < 1e-6
    assert fit.birge_ratio > 5
    assert not focus_of(fit).identifiable


def test_ranges_that_tell_nothing_leave_no_zero_error() -> None:
    fit = lens_of(members((3e6, 3.2e6, 3.3e6), 3.1e6, 70.0, 2.8), stated(70.0, 2.8))
    assert np.all(np.isfinite(fit.errors))
    assert best_focus(fit, "G").std > 1e3
    assert fit.std(MAGNIFICATION) == pytest.approx(USUAL_LOG_MAGNIFICATION, rel=0.3)


def tilted(one: Observed, foreshortening: float, std: float) -> Observed:
    """A member whose target is tilted, which makes its size less by `foreshortening`."""
    of = measured_of(one)
    return with_measured(
        one,
        replace(
            of,
            values=of.values - [0.0, 0.0, foreshortening],
            foreshortening=(foreshortening, std),
        ),
    )


def test_a_tilt_that_all_ranges_share_costs_no_precision_of_one_size_against_another() -> (
    None
):
    every = members((1900, 2000, 2100), 2010, 70.0, 2.8)
    straight = lens_of(every, stated(70.0, 2.8))
    fit = lens_of(
        [tilted(one, 8e-4, 3e-4 if k else 1e-5) for k, one in enumerate(every)],
        stated(70.0, 2.8),
    )
    assert fit.model.tilt_std == 1e-5
    off = np.abs(fit.theta - straight.theta) / np.sqrt(np.diag(straight.errors))
    assert off.max() < 1e-3
    assert fit.std(MAGNIFICATION) == pytest.approx(straight.std(MAGNIFICATION), rel=0.02)


def test_tilts_that_differ_count_each_for_itself_with_their_errors() -> None:
    every, plan = members((1900, 2000, 2100), 2010, 70.0, 2.8), stated(70.0, 2.8)
    fit = lens_of(
        [tilted(one, (2e-4, 8e-4, 5e-4)[k // 3], 2e-5) for k, one in enumerate(every)], plan
    )
    assert fit.model.tilt_std == 0.0
    variances = fit.measured.covariance[:, -1, -1]
    np.testing.assert_allclose(variances, SIZE_STD**2 + 2e-5**2)
    straight = lens_of(every, plan)
    assert fit.value("focal length") == pytest.approx(
        straight.value("focal length"), abs=0.02
    )
