"""The one number of a PSF that a photograph itself determines: its defocus (blind restoration in one number)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.restoration.job import Job
from labkit.restoration.strength import generalised_misfit
from labkit.restoration.tiles import parts_of
from labkit.types import Floats, Progress, no_progress

SPAN_WAVES, STEPS = 1.6, 17  # of the first search, from best focus on
ROUNDS = 3  # of finer ones, each a quarter as wide


def fitted_defocus(job: Job, progress: Progress = no_progress) -> Job:
    """The job with the defocus, Noll mode 4, under which it restores best by generalised cross-validation; those of all
    colours are moved alike. S. Reeves and R. Mersereau, IEEE Trans. Image Process. 1, 301 (1992).

    Its sign is that of the session's own: a photograph hardly tells one from the other.
    Raises ValueError where mode 4 is none of the modes.
    """
    if any(4 not in colour.optics.noll for colour in job.colours):
        raise ValueError("the session's wavefronts have no mode 4: their defocus cannot be fitted")
    own = float(np.mean([colour.waves[colour.optics.noll.index(4)] for colour in job.colours]))
    centre, half, done = float(np.copysign(SPAN_WAVES / 2, own)), SPAN_WAVES / 2, 0
    count = STEPS
    for _ in range(ROUNDS + 1):
        places = centre + np.linspace(-half, half, count)
        scores = []
        for place in places:
            scores.append(_score(moved(job, place - own)))
            done += 1
            progress(done, STEPS + 5 * ROUNDS, f"defocus {place:+.3f} waves")
        centre, half, count = _least(places, scores), 2 * half / (count - 1), 5
    return moved(job, centre - own)


def moved(job: Job, by_waves: float) -> Job:
    """The job with every colour's defocus moved, waves RMS at the reference wavelength."""
    colours = []
    for colour in job.colours:
        step: Floats = np.zeros(len(colour.waves))
        step[colour.optics.noll.index(4)] = by_waves
        colours.append(replace(colour, waves=colour.waves + step, waves_at=None))
    return replace(job, colours=tuple(colours))


def _score(job: Job) -> float:
    return generalised_misfit(parts_of(job)[:1], job.coupling, np.random.default_rng(1))


def _least(places: Floats, scores: Sequence[float]) -> float:
    return float(places[int(np.argmin(scores))])
