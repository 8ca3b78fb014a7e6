"""Best focus and pupil magnification from points that the closed form made."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from labkit.analysis.focus import MODEL_FLOOR_WAVES, DefocusPoint, choose_signs, fit_focus
from labkit.errors import DataError
from labkit.optics.lens import ThinLens
from labkit.types import Floats

RANGES = (500.0, 510.0, 520.0, 535.0, 550.0)
BEST = {"R": 512.0, "B": 515.0}


def closed_form(target_mm: float, focus_mm: float, mp: float) -> float:
    """Waves RMS at 450 nm of a 70 mm f/2.8 lens: physics.md section 10, written out anew."""
    f, half = 70.0, mp * 70.0 / 2.8 / 2
    s, r = (x * f / (x - f) for x in (target_mm, focus_mm))
    edge_r, edge_s = (np.sqrt((d + (mp - 1) * f) ** 2 - half**2) for d in (r, s))
    return float((s - r + edge_r - edge_s) / np.sqrt(12) / 450e-6)


def points(std: float, rng: np.random.Generator | None = None) -> list[DefocusPoint]:
    total = np.hypot(std, MODEL_FLOOR_WAVES)
    return [
        DefocusPoint(x, c, closed_form(x, r, 0.985) + (rng.normal(0, total) if rng else 0.0), std)
        for c, r in BEST.items()
        for x in RANGES
    ]


def test_points_on_the_curve_give_back_its_parameters() -> None:
    fit = fit_focus(points(0.002), 70.0, 2.8, 450.0, "corrected")
    np.testing.assert_allclose(fit.best_focus_mm, list(BEST.values()), rtol=1e-7)
    assert fit.pupil_magnification == pytest.approx(0.985, abs=1e-6)
    assert fit.identifiable


@pytest.mark.slow
def test_errors_of_best_focus_are_as_large_as_it_says() -> None:
    rng, scores = np.random.default_rng(2), []
    for _ in range(300):
        fit = fit_focus(points(0.002, rng), 70.0, 2.8, 450.0, "corrected")
        # undo the inflation by the residuals: it is conservative on purpose
        std = fit.std / np.sqrt(max(1.0, fit.chi2_per_freedom or 1.0))
        scores.append(([*fit.best_focus_mm, fit.pupil_magnification] - np.array([512.0, 515.0, 0.985])) / std)
    # mean and std of 300 unit normals err by 1/sqrt(300) and 1/sqrt(600); allow four of them
    assert np.all(np.abs(np.mean(scores, axis=0)) < 4 / np.sqrt(300))
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 4 / np.sqrt(600))


@pytest.mark.slow
def test_errors_of_best_focus_know_of_the_ranges_own() -> None:
    rng, by_range = np.random.default_rng(3), 0.05
    scores, blind = list[Floats](), list[Floats]()
    truth = np.array([*BEST.values(), 0.985])
    for _ in range(300):
        # both colours of a stop are where the carriage is, which is not quite where it says
        shift = dict(zip(RANGES, rng.normal(0, by_range, len(RANGES)), strict=True))
        seen = [
            DefocusPoint(x, c, closed_form(x + shift[x], r, 0.985) + rng.normal(0, MODEL_FLOOR_WAVES), 0.0)
            for c, r in BEST.items()
            for x in RANGES
        ]
        for range_std_mm, z in ((by_range, scores), (0.0, blind)):
            fit = fit_focus(seen, 70.0, 2.8, 450.0, "corrected", range_std_mm)
            std = fit.std / np.sqrt(max(1.0, fit.chi2_per_freedom or 1.0))
            z.append((np.append(fit.best_focus_mm, fit.pupil_magnification) - truth) / std)
    assert np.all(np.abs(np.mean(scores, axis=0)) < 4 / np.sqrt(300))
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 4 / np.sqrt(600))
    assert np.all(np.std(blind, axis=0) > 2)


def test_one_range_is_too_few() -> None:
    with pytest.raises(DataError, match="at least 2 ranges"):
        fit_focus(points(0.002)[:1], 70.0, 2.8, 450.0, "corrected")


def test_far_ranges_tell_no_pupil_magnification() -> None:
    far = [DefocusPoint(x, "G", closed_form(x, 3050.0, 0.985), 0.002) for x in (3000.0, 3200.0, 3300.0)]
    assert fit_focus(far, 70.0, 2.8, 450.0, "corrected").identifiable is False


def test_defocus_that_no_lens_has_gives_no_magnification() -> None:
    far_too_steep = [DefocusPoint(p.range_mm, p.channel, 3 * p.waves + 0.5 * p.waves**2, 0.002) for p in points(0.002)]
    fit = fit_focus(far_too_steep, 70.0, 2.8, 450.0, "corrected")
    assert fit.at_limit
    assert not fit.identifiable


@pytest.mark.parametrize("scale", [1.0, 10.0, 100.0])
def test_standard_errors_are_those_of_slopes_in_more_digits(scale: float) -> None:
    ranges, focus = scale * np.array([3000.0, 3200.0, 3300.0]), scale * 3150.0
    step = 1e-4

    def waves(best: float, mp: float) -> npt.NDArray[np.longdouble]:
        f, half = np.longdouble(70), np.longdouble(mp) * 70 / np.longdouble("2.8") / 2
        s, r = (x * f / (x - f) for x in (ranges.astype(np.longdouble), np.longdouble(best)))
        edges = [np.sqrt((d + (np.longdouble(mp) - 1) * f) ** 2 - half**2) for d in (r, s)]
        path = s - r + edges[0] - edges[1]
        return np.asarray(path / np.sqrt(np.longdouble(12)) / np.longdouble("450e-6"), np.longdouble)

    by_best = (waves(focus + step * focus, 1.0) - waves(focus - step * focus, 1.0)) / (2 * step * focus)
    by_mp = (waves(focus, 1.0 + step) - waves(focus, 1.0 - step)) / (2 * step)
    slopes = np.stack([by_best, by_mp], axis=1).astype(float) / np.hypot(0.002, MODEL_FLOOR_WAVES)
    wanted = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    given = [DefocusPoint(x, "G", float(w), 0.002) for x, w in zip(ranges, waves(focus, 1.0), strict=True)]
    fit = fit_focus(given, 70.0, 2.8, 450.0, "corrected")
    # at 300 m the two slopes differ by so little that inverting their products leaves six digits
    np.testing.assert_allclose(fit.std, wanted, rtol=4e-6)
    assert not fit.identifiable


def test_ranges_that_tell_nothing_leave_no_zero_error() -> None:
    remote = [DefocusPoint(x, "G", 0.0, 0.002) for x in (3e8, 3.2e8, 3.3e8)]
    fit = fit_focus(remote, 70.0, 2.8, 450.0, "corrected")
    assert np.all(np.isfinite(fit.std))
    assert fit.std[1] > 1e3


@pytest.mark.parametrize("seed", range(12))
def test_signs_undo_a_random_choice_of_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.sort(rng.uniform(2000, 2300, 5))
    focus = rng.uniform(2050, 2250)
    truth = np.array([closed_form(x, focus, 0.985) for x in ranges])
    flips = rng.choice([-1, 1], 5)
    spherical, astigmatism = rng.normal(0, 0.002, (2, 5)) + np.array([[0.08], [-0.06]])
    others = {11: list(flips * spherical), 6: list(flips * astigmatism)}
    found = choose_signs(list(ranges), list(flips * truth), [0.002] * 5, others, ThinLens(70.0, 2.8), 450.0)
    assert found == list(flips)
