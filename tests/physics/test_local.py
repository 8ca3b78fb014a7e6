"""The search for one observation's optima, on photographs that labkit's model did not form."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.analysis.kept_fits import KeptFits
from labkit.estimation import starts
from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import (
    Found,
    Guesses,
    Optimum,
    Views,
    find_optima,
    first_state,
    residuals,
)
from labkit.estimation.starts import Log, Sketches, sweep
from labkit.imaging.parts import LowPass
from labkit.imaging.warp import Pose
from labkit.optics.zernike import twin_signs
from labkit.types import Floats

from .brute_force import CARPET, CORNERS, FRAME, OPTICS, WAVES, brute_force_mean

GAIN, READ_VARIANCE, SCALE, AMBIENT = 0.25, 4.0, 1500.0, 40.0
PRIOR = NoisePrior(GAIN, 0.01, READ_VARIANCE, 0.02)
TOO_QUIET = NoisePrior(GAIN / 2, 0.01, READ_VARIANCE / 2, 0.02)
"""By such a calibration no optimum explains the photographs."""

ROUGH_PX = 0.8
"""Corners as the finder has them are within a pixel."""

WRONG = np.array([-0.27, -0.06, -0.04, 0.15, 0.06])
"""A start that ends in another optimum."""


def photograph(rng: np.random.Generator) -> FrameData:
    """6000 electrons at white: noise fifty times the 0.00024 RMS by which the brute force differs from the model."""
    mean = SCALE * brute_force_mean() + AMBIENT
    counts = rng.normal(mean, np.sqrt(GAIN * mean + READ_VARIANCE))
    return FrameData(counts, np.ones(FRAME, bool), np.ones(FRAME), np.zeros(FRAME))


def seen(seed: int, frames: int = 1, noise: NoisePrior = PRIOR) -> Views:
    rng = np.random.default_rng(seed)
    photographs = tuple(photograph(rng) for _ in range(frames))
    rough = tuple(CORNERS + rng.uniform(-ROUGH_PX, ROUGH_PX, (4, 2)) for _ in range(frames))
    return Views(
        photographs,
        tuple(Pose.from_corners(corners, CARPET.size_mm) for corners in rough),
        noise,
    )


def searched(views: Views, **guesses: Any) -> Found:
    return find_optima(OPTICS, CARPET, views, Guesses(**guesses))


def std(optimum: Optimum) -> Floats:
    return np.asarray(np.sqrt(np.diag(optimum.covariance)))


def assert_right(optimum: Optimum) -> None:
    """Every mode is within four standard errors of the truth or of its twin."""
    assert np.all(np.abs(optimum.canonical().waves - WAVES) < 4 * std(optimum))


@pytest.fixture(scope="module")
def views() -> Views:
    return seen(1)


@pytest.fixture(scope="module")
def found(views: Views) -> Found:
    return searched(views)


@pytest.fixture(scope="module")
def best(found: Found) -> Optimum:
    return found.best


PIXELS = {
    "hot": {(40, 41): 1600.0},
    "dead": {(20, 30): -900.0, (50, 12): -900.0},
    "track": {(30 + k, 30 + k): 1200.0 for k in range(6)},
    "warm": {(25, 26): 400.0},
}
"""Counts that pixels have more than light gave them."""


@pytest.mark.parametrize("kind", PIXELS)
def test_a_pixel_that_no_lens_makes_is_left_out_and_moves_nothing(
    views: Views, best: Optimum, kind: str
) -> None:
    counts = views.frames[0].counts.copy()
    for place, more in PIXELS[kind].items():
        counts[place] = max(counts[place] + more, 0.0)
    spoiled = replace(views, frames=(replace(views.frames[0], counts=counts),))
    cleaned = searched(spoiled)
    assert {(one.row, one.column) for one in cleaned.strays} == {*PIXELS[kind]}
    assert cleaned.best.verdict.accepted
    # six pixels of 3,000 less
    np.testing.assert_allclose(cleaned.best.waves, best.waves, atol=0.2 * std(best).min())


def test_no_optimum_of_clean_photographs_shows_a_stray_pixel(
    views: Views, found: Found
) -> None:
    assert found.strays == ()
    wrong = searched(views, starts=(WRONG,), deep=False)
    assert not wrong.best.verdict.accepted
    assert wrong.strays == ()


@pytest.mark.parametrize("seed", [2, 3])
def test_from_nothing_every_mode_ends_within_four_standard_errors(seed: int) -> None:
    optimum = searched(seen(seed)).best
    assert_right(optimum)
    assert std(optimum).max() < 1e-3
    assert optimum.verdict.accepted
    # of n normals squared the mean has a standard deviation of sqrt(2/n); allow four
    assert optimum.chi2_per_pixel == pytest.approx(
        1, abs=4 * np.sqrt(2 / (FRAME[0] * FRAME[1]))
    )


def test_the_light_and_the_pose_come_with_it(best: Optimum) -> None:
    # four of their standard errors, 1.2 and 0.09 counts; corners are known to about 0.01 pixels
    assert best.state.scales[0] == pytest.approx(SCALE, abs=4 * 1.2)
    assert best.state.ambients[0] == pytest.approx(AMBIENT, abs=4 * 0.09)
    assert np.abs(best.state.poses[0].corners_px() - CORNERS).max() < 0.05


def test_two_frames_tell_more_than_one(best: Optimum) -> None:
    both = searched(seen(4, frames=2)).best
    assert_right(both)
    np.testing.assert_allclose(std(both) / std(best), np.sqrt(0.5), rtol=0.05)


def test_a_predicted_start_leads_to_the_same_optimum_and_no_other_is_made(
    views: Views, best: Optimum
) -> None:
    near = searched(views, starts=(WAVES + 0.03,))
    assert_right(near.best)
    assert near.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)
    assert near.starts == 1


def test_with_known_modes_defocus_is_swept(views: Views, best: Optimum) -> None:
    near = searched(views, modes=(WAVES * [0, 1, 1, 1, 1],))
    assert near.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)


def test_a_climb_begins_at_poses_that_another_channel_determined(best: Optimum) -> None:
    far = seen(1)
    far = replace(far, poses=tuple(pose.shifted(-3.0, 3.0) for pose in far.poses))
    near = searched(far, starts=(WAVES + 0.03,), poses=best.state.poses, deep=False)
    assert near.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)


def test_a_climb_goes_on_from_a_state_where_an_earlier_one_ended(
    views: Views, best: Optimum
) -> None:
    again = searched(views, state=best.state, deep=False)
    assert again.starts == 0
    assert again.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)
    np.testing.assert_allclose(again.best.waves, best.waves, atol=0.1 * std(best).min())


def test_of_several_starts_the_likeliest_end_is_first(views: Views, best: Optimum) -> None:
    both = searched(views, starts=(WRONG, WAVES - 0.03))
    assert both.starts == 2
    assert both.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)
    values = [optimum.log_likelihood for optimum in both.optima]
    assert values == sorted(values, reverse=True)


def test_a_wrong_start_alone_is_rejected_and_others_are_tried(
    views: Views, best: Optimum
) -> None:
    deep = searched(views, starts=(WRONG,))
    assert deep.starts > 1
    assert deep.best.verdict.accepted
    assert deep.best.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)


def test_a_search_that_is_not_deep_ends_with_its_starts(
    views: Views, best: Optimum
) -> None:
    shallow = searched(views, starts=(WRONG,), deep=False)
    assert shallow.starts == 1
    assert not shallow.best.verdict.accepted
    assert shallow.best.log_likelihood < best.log_likelihood - 100
    joined = shallow.joined(Found((best,), starts=3, returns=8))
    assert joined.best is best
    assert (joined.starts, joined.settled, len(joined.optima)) == (4, True, 2)


def test_where_no_optimum_explains_the_frames_the_likeliest_is_returned_rejected() -> None:
    found = searched(seen(1, noise=TOO_QUIET))
    assert not found.best.verdict.accepted
    assert not found.cut_short
    assert_right(found.best)
    assert all(below > 0 for _, below in found.others)


def test_a_search_without_patience_is_cut_short() -> None:
    found = searched(seen(1, noise=TOO_QUIET), patience_s=0.0)
    assert found.cut_short
    assert len(found.optima) > 0


def test_a_sweep_yields_a_state_though_its_end_is_doubted_and_no_time_is_left(
    views: Views, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a lone picture near focus: its plausible end is doubted, and is all that there is."""
    excess = iter([0.0, 1.0])  # of the end, and of where it began
    monkeypatch.setattr(starts, "_excess", lambda sketches, state: next(excess))
    monkeypatch.setattr(starts, "near_focus", lambda optics, waves: True)
    monkeypatch.setattr(
        starts, "sweep", lambda sketches, state: sweep(sketches, state)[:1]
    )  # whose end is the best
    first = first_state(views.frames[0], views.poses[0], views.noise, len(OPTICS.noll))
    sketches = Sketches(OPTICS, CARPET, views.frames[0], views.poses[0], views.noise)
    late = Log(40, 0.0, lambda step: None)
    assert len(list(starts.swept(sketches, first, late, doubt_near_focus=True))) == 1


@pytest.mark.parametrize("right_beside", [False, True])
def test_a_climb_begins_with_another_observations_optimum_if_it_is_likelier(
    views: Views, right_beside: bool
) -> None:
    start, other = (WRONG, WAVES) if right_beside else (WAVES, WRONG)
    found = searched(views, deep=False, starts=(start,), beside=(OPTICS, other))
    assert len(found.optima) == 1
    assert_right(found.best)


def test_a_part_of_the_model_is_fitted_too(views: Views) -> None:
    camera = replace(OPTICS, parts=(LowPass(),))
    optimum = find_optima(camera, CARPET, views, Guesses(starts=(WRONG,))).best
    assert optimum.verdict.accepted
    assert [part.name for part in optimum.optics.parts] == ["low_pass_filter"]
    assert optimum.measured.parts == optimum.optics.camera_labels
    assert_right(optimum)


def test_photographs_of_a_complete_model_call_for_no_part(views: Views) -> None:
    optimum = searched(views, starts=(WAVES,), score=tuple(OPTICS.lacking)).best
    assert set(optimum.scores) == set(OPTICS.lacking)
    # 2 gain is chi2 of at most 2 numbers: above 10 once in 20 000
    assert max(call.gain for call in optimum.scores.values()) < 10


def test_the_same_frames_and_seed_give_the_same_numbers(
    views: Views, best: Optimum
) -> None:
    again = searched(views).best
    np.testing.assert_array_equal(again.waves, best.waves)
    np.testing.assert_array_equal(again.covariance, best.covariance)


def test_an_optimum_and_its_twin_are_alike_in_all_but_even_modes(best: Optimum) -> None:
    twin = best.twin()
    np.testing.assert_array_equal(
        twin_signs(OPTICS.noll), [-1, -1, 1, 1, -1]
    )  # Noll 4, 6 and 11 are even
    np.testing.assert_array_equal(twin.waves, best.waves * [-1, -1, 1, 1, -1])
    np.testing.assert_array_equal(
        twin.measured.waves, best.measured.waves * [-1, -1, 1, 1, -1]
    )
    np.testing.assert_array_equal(std(twin), std(best))
    assert twin.covariance[0, 2] == -best.covariance[0, 2]
    assert twin.covariance[0, 1] == best.covariance[0, 1]
    np.testing.assert_array_equal(twin.twin().covariance, best.covariance)


def test_of_twins_the_one_with_its_largest_even_mode_positive_is_canonical(
    best: Optimum,
) -> None:
    for one in (best, best.twin()):
        assert one.canonical().waves[0] > 0
    odd = replace(
        best,
        optics=replace(OPTICS, noll=(7, 8)),
        state=replace(best.state, waves=np.array([-0.3, 0.1])),
    )
    assert odd.canonical() is odd


def test_residuals_are_the_frames_less_the_fit_in_its_own_noise(
    views: Views, best: Optimum
) -> None:
    ((mean, noise_std),) = residuals(best, views.frames)
    z = (views.frames[0].counts.ravel() - mean) / noise_std
    assert np.mean(z**2) == pytest.approx(best.chi2_per_pixel, rel=1e-9)
    np.testing.assert_allclose(
        noise_std, np.sqrt(best.state.gain * mean + best.state.read_noise**2), rtol=1e-12
    )


def by_name(name: str) -> Found:
    """A search as a task: only its name is used here."""
    pytest.fail(f"{name} was searched for")


def test_what_a_search_found_can_be_kept(views: Views, tmp_path: Path) -> None:
    made = searched(views, starts=(WAVES,), score=("veil",), deep=False)

    def run(
        function: Callable[[Any], Any], tasks: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        yield from ((index, made) for index, _ in enumerate(tasks))

    def never(
        function: Callable[[Any], Any], tasks: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        pytest.fail("it was kept, and is made again")

    list(KeptFits(run, tmp_path)(by_name, ["a"]))
    ((_, kept),) = KeptFits(never, tmp_path)(by_name, ["a"])
    np.testing.assert_array_equal(kept.best.waves, made.best.waves)
    assert kept.best.scores.keys() == made.best.scores.keys()
