"""How good the search's small problem is, for stronger wavefronts and more modes: python -m benchmarks.small_problem

For each number of components and strength up to which PSFs are drawn for them: what they leave of a PSF, where a start from
the truth ends, how many random starts end there too, and by how much the best of the other ends is worse.
"""

from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from labkit.estimation import small_problem
from labkit.estimation.settings import SETTINGS
from labkit.estimation.small_problem import PhaseRetrieval
from labkit.experiments.conditions import NOLL, carpet, draw_trial, optics, random_waves
from labkit.experiments.search import NOLL_22, SAME_END, STARTS
from labkit.optics.strehl import TILTS

SNR = 75.0
CASES = ((NOLL, 0.25, 4), (NOLL, 0.5, 6), (NOLL_22, 0.35, 6), (NOLL_22, 0.5, 10))
DRAWN = ((300, 0.4), (600, 0.6))
"""Components, and the largest RMS of the wavefronts that they are drawn from."""

PSFS = 40


def left(small: PhaseRetrieval, waves_rms: float) -> float:
    """Median share of a PSF's departure from the perfect one that the components leave."""
    components, perfect = small_problem._components(small.pupil)
    rng, shares = np.random.default_rng(5), []
    for _ in range(PSFS):
        waves = np.append(
            np.zeros(len(TILTS)),
            random_waves(rng, len(small.optics.noll), waves_rms),
        )
        departure = (small.pupil.psf(waves) - perfect).ravel()
        rest = departure - components.T @ (components @ departure)
        shares.append(np.linalg.norm(rest) / np.linalg.norm(departure))
    return float(np.median(shares))


def case(noll: Sequence[int], waves_rms: float, pictures: int) -> str:
    """A line of the table."""
    modes, right = tuple(noll), 0
    errors, ratios = list[float](), list[float]()
    for seed in range(pictures):
        rng = np.random.default_rng([seed, round(SNR), len(modes), round(100 * waves_rms)])
        trial = draw_trial(rng, snr=SNR, noll=modes, waves_rms=waves_rms)
        here = trial.state(np.zeros(len(modes)))
        small = PhaseRetrieval.prepare(
            optics(modes), carpet(), trial.frame, trial.noise, here
        )
        true_end = small.descend(trial.waves)
        error = trial.error(true_end.state.waves)
        ends = [small.descend(small.random_waves(rng)) for _ in range(STARTS)]
        others = [
            e
            for e in ends
            if np.linalg.norm(trial.error(e.state.waves) - error) >= SAME_END
        ]
        errors.append(float(np.linalg.norm(error)))
        ratios.append(min((e.misfit for e in others), default=np.inf) / true_end.misfit)
        right += STARTS - len(others)
    return (
        f"{len(modes)} modes, {waves_rms:g} waves: left {100 * left(small, waves_rms):.1f} %, "
        f"error {np.median(errors):.3f} waves, "
        f"right {right} of {STARTS * pictures}, next best {min(ratios):.2f} to {max(ratios):.2f} times the misfit"
    )


if __name__ == "__main__":
    for components, strongest in DRAWN:
        waves = (SETTINGS.start_waves[0], strongest)
        drawn = replace(SETTINGS, psf_components=components, start_waves=waves)
        small_problem._components.cache_clear()
        print(f"{components} components, drawn up to {strongest:g} waves")
        with patch.object(small_problem, "SETTINGS", drawn):
            for noll, waves_rms, pictures in CASES:
                print(" ", case(noll, waves_rms, pictures), flush=True)
