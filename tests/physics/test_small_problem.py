"""Wavefronts retrieved at a pose that is held, from pictures that labkit's model did not form."""

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation import small_problem
from labkit.estimation.climb import State
from labkit.estimation.likelihood import low_orders, predict
from labkit.estimation.settings import SETTINGS
from labkit.estimation.small_problem import PhaseRetrieval, Retrieved
from labkit.experiments.conditions import (
    NOLL,
    Trial,
    carpet,
    draw_trial,
    optics,
    random_waves,
)
from labkit.imaging.model import ForwardModel
from labkit.optics.psf import Pupil
from labkit.types import Floats

OFF_PX = np.array([0.15, -0.2])  # rows, columns


@pytest.fixture(scope="module")
def trial() -> Trial:
    return draw_trial(np.random.default_rng(7), snr=50.0)


def prepared(trial: Trial, state: State) -> PhaseRetrieval:
    return PhaseRetrieval.prepare(optics(NOLL), carpet(), trial.frame, trial.noise, state)


def knowing_nothing(trial: Trial) -> State:
    """A little defocus, the pose a fraction of a pixel off."""
    state = trial.state(np.append(0.2, np.zeros(len(NOLL) - 1)))
    return replace(state, poses=(trial.pose.shifted(*OFF_PX),))


def test_components_make_up_the_psfs_of_wavefronts_they_were_not_drawn_from() -> None:
    pupil = Pupil(0.55, 0.55, 8.0, 2.2, 64, (2, 3, *NOLL))
    components, perfect = small_problem._components(pupil)
    np.testing.assert_allclose(
        components @ components.T, np.eye(len(components)), atol=1e-4
    )
    rng = np.random.default_rng(1)
    for _ in range(10):
        waves = np.concatenate(
            [rng.normal(scale=0.1, size=2), random_waves(rng, len(NOLL), 0.25)]
        )
        departure = (pupil.psf(waves) - perfect).ravel()
        left = departure - components.T @ (components @ departure)
        assert np.linalg.norm(left) < 0.02 * np.linalg.norm(departure)


def test_its_misfit_is_that_of_the_whole_model(trial: Trial) -> None:
    """Misfits of two wavefronts differ as the sums of squares do that the forward model leaves at the same pose."""
    state, rng = trial.state(trial.waves), np.random.default_rng(2)
    small = prepared(trial, state)
    model = ForwardModel.build(optics(NOLL), carpet(), trial.frame.counts.shape, trial.pose)
    drawing = model.draw([trial.pose])
    counts, detector = trial.frame.counts[trial.frame.used], state.detectors()[0]
    (there,) = model.means(trial.waves, drawing, [trial.frame.used])
    variance = predict(there, trial.frame, detector)[1]

    def squares(waves: np.ndarray) -> tuple[float, float]:
        components, perfect = small_problem._components(small.pupil)
        departure = (
            components @ (small.pupil.psf(np.append([0, 0], waves)) - perfect).ravel()
        )
        light = np.append(state.scales, state.ambients)
        mine = np.sum(
            (small.factor @ np.append(state.scales * departure, light) - small.data) ** 2
        )
        (relative,) = model.means(waves, drawing, [trial.frame.used])
        mean = predict(relative, trial.frame, detector)[0]
        return float(mine), float(np.sum((counts - mean) ** 2 / variance))

    best, whole_best = squares(trial.waves)
    for _ in range(5):
        mine, whole = squares(random_waves(rng, len(NOLL), 0.25))
        assert mine - best == pytest.approx(whole - whole_best, rel=0.05)


def test_it_is_prepared_without_copies_of_all_its_pictures(
    trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = trial.state(trial.waves)
    whole = prepared(trial, state)
    # of 11 thousand pixels; of a large target a twentieth
    monkeypatch.setattr(small_problem, "SETTINGS", replace(SETTINGS, pixels_at_once=1000))
    tracemalloc.start()
    small = prepared(trial, state)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_allclose(
        small.factor.T @ small.factor, whole.factor.T @ whole.factor, rtol=1e-5
    )
    pictures = (
        4 * SETTINGS.psf_components * int(trial.frame.used.sum())
    )  # bytes, in single precision
    assert peak < 4 * pictures  # measured: 2.6, the model's own among them


def searched(
    small: PhaseRetrieval, seed: int, given: Sequence[Floats] = ()
) -> list[Retrieved]:
    """Records at every candidate, and at the end."""
    rng, records = np.random.default_rng(seed), [Retrieved(tuple(given))]
    while len(records) == 1 or records[-1].candidate is not None:
        records.append(small.to_next_candidate(records[-1], rng))
    return records[1:]


def test_from_random_starts_the_truth_stands_out_and_the_pose_is_mended(
    trial: Trial,
) -> None:
    small = prepared(trial, knowing_nothing(trial))
    best, second = searched(small, 3)[-1].optima[:2]
    assert np.linalg.norm(trial.error(best.state.waves)) < 0.03
    off = best.state.poses[0].corners_px() - trial.pose.corners_px()
    assert np.abs(off.mean(axis=0)).max() < 0.3 * np.abs(OFF_PX).max()
    assert second.misfit > 2 * best.misfit


def test_starts_that_are_given_come_first_and_the_search_ends(trial: Trial) -> None:
    small = prepared(trial, knowing_nothing(trial))
    given = [trial.waves + 0.01, -trial.waves]
    *offers, end = searched(small, 4, given)
    assert offers[0].candidate is not None
    assert np.linalg.norm(trial.error(offers[0].candidate.waves)) < 0.03
    assert end.ended
    assert end.starts <= 2 * SETTINGS.most_starts
    misfits = [o.misfit for o in end.optima]
    assert misfits == sorted(misfits)
    assert len(offers) == sum(o.offered for o in end.optima)


def test_a_search_taken_up_again_from_its_record_goes_the_same_way(trial: Trial) -> None:
    small, given = prepared(trial, knowing_nothing(trial)), [trial.waves + 0.01]
    record = small.to_next_candidate(Retrieved(tuple(given)), np.random.default_rng(5))
    ends = [small.to_next_candidate(record, np.random.default_rng(6)) for _ in range(2)]
    assert [o.misfit for o in ends[0].optima] == [o.misfit for o in ends[1].optima]
    assert [o.met for o in ends[0].optima] == [o.met for o in ends[1].optima]


def test_low_orders_of_the_illumination_cost_it_nothing(trial: Trial) -> None:
    uneven = low_orders(*trial.frame.counts.shape)
    light = 1 + np.tensordot([0.05, -0.03, 0.02, 0.01, -0.04], uneven, 1)
    frame = replace(trial.frame, counts=trial.frame.counts * light, departures=uneven)
    state = replace(knowing_nothing(trial), unevenness=np.zeros(len(uneven)))
    small = PhaseRetrieval.prepare(optics(NOLL), carpet(), frame, trial.noise, state)
    best = searched(small, 3)[-1].optima[0]
    assert np.linalg.norm(trial.error(best.state.waves)) < 0.03


def test_one_mode_alone_is_retrieved_too() -> None:
    rng = np.random.default_rng(8)
    trial = draw_trial(rng, noll=(4,))
    small = PhaseRetrieval.prepare(
        optics((4,)), carpet(), trial.frame, trial.noise, trial.state(np.array([0.1]))
    )
    offer = small.to_next_candidate(Retrieved(), rng).candidate
    assert offer is not None
    assert abs(abs(offer.waves[0]) - abs(trial.waves[0])) < 0.01
