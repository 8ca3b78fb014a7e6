"""A session's estimate, against formulas written out in the tests and against data drawn from them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.analysis.lens_fit import MODEL_FLOOR_WAVES, LensFit, fit_lens, fit_session_lens
from labkit.analysis.lens_model import (
    COLOUR_STD,
    SIZE_FLOOR,
    LensModel,
    Member,
    Stated,
)
from labkit.analysis.session_results import as_focus, budget
from labkit.estimation.errors import covariance_with_bias
from labkit.estimation.expansion import Measured
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.lens_samples import COLOURS, SIZE_STD, covariance, laws, member, members, moved, stated

FAR, NEAR = (3000.0, 3200.0, 3300.0), tuple(np.linspace(470.0, 494.0, 5).tolist())
EXACT = Uncertain(60.0, 1e-9, "mm"), Uncertain(4.0, 1e-9)


def near_session(mp: float = 1.0, **changed: Any) -> tuple[list[Member], Stated]:
    """60 mm f/4, focused at 482 mm."""
    return members(NEAR, 482.0, 60.0, 4.0, mp), stated(60.0, 4.0, **changed)


def true_values(model: LensModel, theta: Any, k: int) -> Any:
    """(modes + 2,) that member k should measure at a point of the estimate, by the printed laws; theta real or complex."""
    m = model.members[k]

    def at(kind: str, *of: str | float) -> Any:
        return theta[model.index(kind, *of)]

    shares = [m.homings.count(h) / len(m.homings) * at("homing", h) for h in {*m.homings} - {1}]
    range_mm = m.range_mm + at("tape") + at("steps", m.stop) + sum(shares)
    focus, reference = (at("best focus", c) + at("tape") for c in (m.channel, "G"))
    f, n, mp = at("focal length"), at("f-number"), np.exp(at("pupil magnification"))
    waves, cone, scale = laws(range_mm, focus, reference, f, n, mp)
    scale = scale + at("target size") + (at("lateral colour", m.channel) if m.channel != "G" else 0.0)
    modes = [waves if j == 4 else at("mode", m.channel, j) for j in m.measured.noll]
    wavelength = at("wavelength", m.channel)
    return np.array([*(mode * (1 - wavelength) for mode in modes), cone + at("cone") + wavelength, scale])


def test_slopes_are_those_of_the_printed_laws() -> None:
    noll, rng = (4, 6, 11), np.random.default_rng(1)
    fits = [
        Member(c, r, r, Measured(noll, np.zeros(5), np.eye(5), np.eye(5)), homings)
        for r, homings in zip((480.0, 500.0, 530.0), ((1, 1), (1, 2), (2, 3)), strict=True)
        for c in COLOURS
    ]
    model = LensModel(tuple(fits), stated(60.0, 4.0))
    start = np.array([505.0 if c.kind == "best focus" else c.value for c in model.columns])
    theta = start + np.array([c.scale for c in model.columns]) * rng.normal(0, 1, len(start))
    jacobian = model.jacobian(theta)
    for k in range(len(fits)):
        steps = theta + 1e-30j * np.eye(len(theta))
        wanted = np.array([true_values(model, step, k).imag / 1e-30 for step in steps]).T
        np.testing.assert_allclose(model.predicted(theta)[k], true_values(model, theta, k), rtol=1e-12)
        # 600 waves of sagitta, rounded, over a step of 2e-7 in ln mp are wrong by 3e-7 waves
        np.testing.assert_allclose(jacobian[k], wanted, rtol=1e-6, atol=6e-7)


def test_a_lens_is_found_again() -> None:
    fits, plan = near_session(0.93, f_number=Uncertain(4.1, 0.4), focal_length=Uncertain(60.0, 1e-9, "mm"))
    fit = fit_lens(fits, plan)
    # prior values pull: the magnification's by (error / 0.7)^2 of its distance
    assert np.exp(fit.value("pupil magnification")) == pytest.approx(0.93, abs=2e-5)
    assert fit.value("f-number") == pytest.approx(4.0, abs=1e-3)
    assert fit.value("best focus", "G") == pytest.approx(482.0, abs=1e-4)
    assert fit.value("tape") == pytest.approx(0.0, abs=2e-3)


def test_errors_hold_what_a_part_that_is_missing_would_move() -> None:
    fits, plan = near_session()
    fit, rng = fit_lens(fits, plan), np.random.default_rng(2)
    shifts = [0.3 * rng.normal(size=3) * np.sqrt(np.diag(m.measured.covariance)) for m in fits]
    others = [
        replace(m, measured=replace(m.measured, values=m.measured.values + s))
        for m, s in zip(fits, shifts, strict=True)
    ]
    leaning, moved_by = fit.leaning(shifts), fit_lens(others, plan).theta - fit.theta
    assert leaning.lean is not None
    std = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(leaning.lean / std, moved_by / std, atol=0.01)  # 6e-3: the laws bend
    np.testing.assert_allclose(leaning.errors, covariance_with_bias(fit.covariance * leaning.widening**2, leaning.lean))
    assert leaning.chi2 == pytest.approx(
        fit_lens(others, plan).chi2, rel=0.02
    )  # of what they would be, not of what they are
    assert fit.chi2 < 0.5 * leaning.chi2
    for k in range(len(std)):
        shares = leaning.contributions(np.eye(len(std))[k])
        assert sum(share**2 for share in shares.values()) == pytest.approx(leaning.errors[k, k])
    assert leaning.std("tape") > fit.std("tape")


def drawn(rng: np.random.Generator, plan: Stated, mp: float) -> tuple[list[Member], dict[str, float]]:
    """A session whose lens, tape, steps and sizes are off as stated, and whose fits err as they say; and its truth."""
    f, n = (rng.normal(x.value, x.std) for x in (plan.focal_length, plan.f_number))
    zero, size = rng.normal(0, plan.range_zero_std_mm), rng.normal(0, plan.size_std)
    best = {"R": 480.0, "G": 482.0, "B": 485.0}
    steps = dict(zip(NEAR, rng.normal(0, plan.range_std_mm, len(NEAR)), strict=True))
    fits = []
    for r in NEAR:
        for c in COLOURS:
            there = laws(r + zero + steps[r], best[c] + zero, best["G"] + zero, f, n, mp)
            clean = np.array(there) + np.array([0, 0, size + {"R": 2e-4, "G": 0.0, "B": -1e-4}[c]])
            floors = np.diag([MODEL_FLOOR_WAVES**2, 0.0, SIZE_FLOOR**2])
            noise = rng.multivariate_normal(np.zeros(3), covariance(clean[0]) + floors)
            fits.append(member(r, c, clean + noise))
    truth = {"best focus R": best["R"], "best focus B": best["B"], "focal length": f, "f-number": n, "tape": zero}
    return fits, truth | {"pupil magnification": np.log(mp)}


def pulls(rng: np.random.Generator, actual: Stated, believed: Stated) -> Floats:
    """(6,) errors of one drawn session's estimate over what it says of them."""
    fits, truth = drawn(rng, actual, 0.97)
    fit = fit_lens(fits, believed)
    scores = []
    for name, value in truth.items():
        place = ("best focus", name[-1]) if name.startswith("best") else (name,)
        k = fit.model.index(*place)
        scores.append((fit.theta[k] - value) / np.sqrt(fit.covariance[k, k]))  # without widening
    return np.array(scores)


USUAL = stated(60.0, 4.0, f_number=Uncertain(4.0, 0.12), range_zero_std_mm=1.0, range_std_mm=0.01, size_std=1e-4)


@pytest.mark.slow
def test_errors_are_as_large_as_the_estimate_says() -> None:
    rng = np.random.default_rng(2)
    scores = np.array([pulls(rng, USUAL, USUAL) for _ in range(120)])
    # mean and std of 120 unit normals err by 1/sqrt(120) and 1/sqrt(240); allow four of them
    assert np.all(np.abs(scores.mean(axis=0)) < 4 / np.sqrt(120))
    assert np.all(np.abs(scores.std(axis=0) - 1) < 4 / np.sqrt(240))


def test_the_misfit_of_a_session_is_as_large_as_chance_makes_it() -> None:
    rng = np.random.default_rng(4)
    fits = [fit_lens(drawn(rng, USUAL, 0.97)[0], USUAL) for _ in range(40)]
    assert {fit.freedom for fit in fits} == {15 * 3 - 5}  # five numbers of which nothing was known before
    # the mean of 40 chi-squareds over their 40 freedoms errs by sqrt(2 / 1600); allow four of them
    assert np.mean([fit.typical for fit in fits]) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 1600))


@pytest.mark.slow
def test_an_estimate_that_believes_the_rail_is_exact_is_wrong() -> None:
    rng, believed = np.random.default_rng(3), replace(USUAL, range_std_mm=0.0)
    scores = np.array([pulls(rng, USUAL, believed) for _ in range(40)])
    assert np.all(scores.std(axis=0)[:2] > 1.5)  # best focus: by 2.2 and 2.3


def independent_std(
    ranges: tuple[float, ...], focus: float, plan: Stated, size_std: float, *, floors: bool = True
) -> dict[str, float]:
    """The standard errors by the information matrix of the printed laws, slopes by complex steps."""
    f, n = plan.focal_length, plan.f_number
    centre = np.array([f.value, n.value, 0.0, 0.0, focus, focus, focus, 0.0, 0.0, *(0.0 for _ in ranges)])
    prior = [f.std, n.std, USUAL_LOG_MAGNIFICATION, plan.range_zero_std_mm, 1e5, 1e5, 1e5, COLOUR_STD, COLOUR_STD]
    information = np.diag(np.array([*prior, *(plan.range_std_mm for _ in ranges)]) ** -2.0)
    for k, r in enumerate(ranges):
        for c in range(3):
            steps = centre + 1e-30j * np.eye(len(centre))
            rows = []
            for t in steps:
                focus_mm, reference_mm = t[4 + c] + t[3], t[5] + t[3]
                waves, cone, scale = laws(r + t[3] + t[9 + k], focus_mm, reference_mm, t[0], t[1], np.exp(t[2]))
                rows.append([waves, cone, scale + (t[7 + c // 2] if c != 1 else 0.0)])
            slope = np.array(rows).imag.T / 1e-30
            waves = laws(r, focus, focus, f.value, n.value, 1.0)[0]
            floor = np.diag([MODEL_FLOOR_WAVES**2, 0.0, SIZE_FLOOR**2]) if floors else 0.0
            noise = covariance(waves, size_std=size_std) + floor
            information += slope.T @ np.linalg.solve(noise, slope)
    scale = 1 / np.sqrt(np.diag(information))
    std = scale * np.sqrt(np.diag(np.linalg.inv(information * np.outer(scale, scale))))
    names = ("focal length", "f-number", "pupil magnification", "tape")
    return dict(zip(names, std, strict=False)) | {"best focus": std[5]}


NO_SIZES = 10.0
CASES = {
    # of physics.md §15: best focus, f-number in per cent, focal length, magnification, zero point
    "far, exact": (FAR, 3150.0, 70.0, 2.8, True, SIZE_STD, (0.037, None, None, 0.003, None)),
    "far, no sizes": (FAR, 3150.0, 70.0, 2.8, False, NO_SIZES, (0.038, 0.7, 0.22, 0.26, 5.0)),
    "near, exact": (NEAR, 482.0, 60.0, 4.0, True, SIZE_STD, (0.0017, None, None, 0.0007, None)),
    "near, no sizes": (NEAR, 482.0, 60.0, 4.0, False, NO_SIZES, (0.0020, 1.4, 0.34, 0.16, 4.4)),
}


@pytest.mark.parametrize("case", CASES)
def test_standard_errors_are_those_of_an_independent_calculation(case: str) -> None:
    ranges, focus, f, n, exact, size_std, printed = CASES[case]
    held = {"focal_length": Uncertain(f, 1e-9), "f_number": Uncertain(n, 1e-9), "range_zero_std_mm": 1e-9}
    plan = stated(f, n, **(held if exact else {}))
    fit = fit_lens(members(ranges, focus, f, n, size_std=size_std), plan)
    found = {k: fit.std(k) for k in ("focal length", "f-number", "pupil magnification", "tape")}
    found["best focus"] = fit.std("best focus", "G")
    for name, std in independent_std(ranges, focus, plan, size_std).items():
        if std > 1e-6:  # what is held exact has no error to compare
            assert found[name] == pytest.approx(std, rel=1e-3), name
    pure = independent_std(ranges, focus, plan, size_std, floors=False)
    numbers = [pure[k] for k in ("best focus", "f-number", "focal length", "pupil magnification", "tape")]
    numbers[1] *= 100 / n
    for number, wanted in zip(numbers, printed, strict=True):
        # the table does not say what it takes for known of the magnification beforehand, nor where focus lay
        assert wanted is None or wanted / 2 < number < 2 * wanted


def test_sizes_tell_of_pupils_and_f_number() -> None:
    plan = stated(70.0, 2.8)
    blind, seeing = (
        fit_lens(members(FAR, 3150.0, 70.0, 2.8, size_std=std), plan).std("pupil magnification")
        for std in (NO_SIZES, 1.5e-5)
    )
    assert seeing < blind / 3


def test_the_sources_of_an_error_add_up_to_its_variance() -> None:
    fits, plan = near_session(size_std=1e-4, wavelength_std=dict.fromkeys(COLOURS, 0.005), range_std_mm=0.01)
    flats = [replace(m.measured, calibration=0.2 * m.measured.covariance) for m in fits]
    fit = fit_lens([replace(m, measured=measured) for m, measured in zip(fits, flats, strict=True)], plan)
    shares = budget(fit)
    for name, std in (("best_focus_mm.R", fit.std("best focus", "R")), ("f_number", fit.std("f-number"))):
        assert np.linalg.norm(list(shares[name].values())) == pytest.approx(std, rel=1e-6)
    assert shares["range_zero_mm"]["geometry"] > shares["range_zero_mm"]["photons"] > 0
    assert all(share["calibration"] > 0 for share in shares.values())


def test_errors_grow_where_the_members_disagree() -> None:
    fits, plan = near_session()
    fit = fit_lens([moved(m, 0.01) if k % 4 == 0 else m for k, m in enumerate(fits)], plan)
    assert fit.widening > 3
    shares = budget(fit)["best_focus_mm.G"]
    assert np.linalg.norm(list(shares.values())) == pytest.approx(fit.std("best focus", "G"), rel=1e-6)


def test_a_wrong_optimum_is_found_and_no_other() -> None:
    ranges, rng = (980.0, 1000.0, 1020.0, 1040.0), np.random.default_rng(5)
    fits = members(ranges, 1010.0, 70.0, 2.8)
    fits = [
        replace(
            m, measured=replace(m.measured, values=rng.multivariate_normal(m.measured.values, m.measured.covariance))
        )
        for m in fits
    ]
    assert fit_session_lens(fits, stated(70.0, 2.8))[0] == []
    fits[7] = moved(fits[7], 0.09)  # the case of physics.md §15
    out, fit = fit_session_lens(fits, stated(70.0, 2.8))
    assert out == [7]
    assert fit.value("best focus", "B") == pytest.approx(1010.0, abs=4 * fit.std("best focus", "B"))


def test_a_cone_of_another_lens_is_not_believed() -> None:
    fits, plan = near_session(focal_length=EXACT[0], f_number=Uncertain(4.0, 0.002), range_zero_std_mm=0.1)
    off = [moved(m, -0.04 * m.measured.values[0], 0.04) for m in fits]
    assert fit_session_lens(fits, plan)[1].model.paraxial
    out, fit = fit_session_lens(off, plan)
    assert out == []
    assert not fit.model.paraxial
    # without sizes the pupils take a part of it upon them: 0.020 is left
    assert 0.01 < fit.value("cone") < 0.04
    assert fit.value("best focus", "G") == pytest.approx(482.0, abs=0.01)


def with_coma(m: Member, coma: float) -> Member:
    values, cov = np.insert(m.measured.values, 1, coma), np.diag([0.0, 1e-8, 0.0, 0.0])
    cov[np.ix_([0, 2, 3], [0, 2, 3])] = m.measured.covariance
    return replace(m, measured=Measured((4, 7), values, cov, 0 * cov))


def test_modes_that_change_from_range_to_range_are_not_held_to_be_the_same() -> None:
    fits, plan = near_session()
    assert fit_session_lens([with_coma(m, 0.02) for m in fits], plan)[1].model.shared
    out, fit = fit_session_lens([with_coma(m, 0.02 + 1e-4 * (m.range_mm - 482)) for m in fits], plan)
    assert out == []
    assert not fit.model.shared


def test_a_few_wrong_optima_cost_no_law() -> None:
    fits, plan = near_session()
    for wrong in ([7], [7, 11]):
        off = [with_coma(moved(m, 0.02), -0.03) if k in wrong else with_coma(m, 0.02) for k, m in enumerate(fits)]
        out, fit = fit_session_lens(off, plan)
        assert sorted(out) == wrong
        assert fit.model.shared
        assert fit.model.paraxial
        assert fit.p_value > 0.1


def focus_of(fit: LensFit) -> Any:
    found = as_focus(fit)
    assert found is not None
    return found


def test_one_range_gives_no_best_focus() -> None:
    assert as_focus(fit_lens(members((3000.0,), 3050.0, 70.0, 2.8), stated(70.0, 2.8))) is None


def test_far_ranges_tell_no_pupil_magnification() -> None:
    far = fit_lens(members((30_000.0, 32_000.0, 33_000.0), 31_000.0, 70.0, 2.8), stated(70.0, 2.8))
    assert not focus_of(far).identifiable
    assert focus_of(fit_lens(*near_session())).identifiable


def test_defocus_that_no_lens_has_gives_no_magnification() -> None:
    fits, plan = near_session()
    fit = fit_lens([moved(m, 2 * m.measured.values[0] + 0.5) for m in fits], plan)
    assert fit.p_value < 1e-6
    assert fit.widening > 5
    assert not focus_of(fit).identifiable


def test_ranges_that_tell_nothing_leave_no_zero_error() -> None:
    fit = fit_lens(members((3e6, 3.2e6, 3.3e6), 3.1e6, 70.0, 2.8), stated(70.0, 2.8))
    assert np.all(np.isfinite(fit.covariance))
    assert fit.std("best focus", "G") > 1e3
    assert fit.std("pupil magnification") == pytest.approx(USUAL_LOG_MAGNIFICATION, rel=0.3)


def leaning(m: Member, shortening: float, std: float) -> Member:
    """A member whose target leans: its size is less by as much."""
    values = m.measured.values - [0.0, 0.0, shortening]
    return replace(m, measured=replace(m.measured, values=values, shortening=(shortening, std)))


def test_a_lean_that_all_ranges_share_costs_no_precision_of_one_size_beside_another() -> None:
    seen = members((1900, 2000, 2100), 2010, 70.0, 2.8)
    straight = fit_lens(seen, stated(70.0, 2.8))
    leans = fit_lens([leaning(m, 8e-4, 3e-4 if k else 1e-5) for k, m in enumerate(seen)], stated(70.0, 2.8))
    assert leans.model.lean == (8e-4, 1e-5)
    off = np.abs(leans.theta - straight.theta) / np.sqrt(np.diag(straight.covariance))
    assert off.max() < 1e-3
    assert leans.std("pupil magnification") == pytest.approx(straight.std("pupil magnification"), rel=0.02)


def test_leans_that_differ_count_each_for_itself_with_their_errors() -> None:
    seen = members((1900, 2000, 2100), 2010, 70.0, 2.8)
    leans = fit_lens([leaning(m, (2e-4, 8e-4, 5e-4)[k // 3], 2e-5) for k, m in enumerate(seen)], stated(70.0, 2.8))
    assert leans.model.lean is None
    assert leans.value("focal length") == pytest.approx(
        fit_lens(seen, stated(70.0, 2.8)).value("focal length"), abs=0.02
    )
