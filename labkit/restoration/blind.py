"""The defocus of a PSF, determined by the photograph itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.restoration.evidence import unlikeliness
from labkit.restoration.job import Job
from labkit.restoration.tiles import CHOSEN_ON, areas_of
from labkit.types import Floats, Progress, no_progress

SPAN_WAVES, COARSE_WAVES = (
    1.6,
    0.1,
)  # of the search, from best focus on; its step, then a quarter of it
BLIND_PARTS, LEAST_BLIND_PARTS, BLIND_PART_PX = (
    6,
    3,
    32,
)  # whose likelihoods are multiplied, the richest in contrast
SURE = 3.0  # standard errors from best focus
# waves, by which scenes' own blur, depth and spectra make it err: 0.22 RMS of three pictures of the study at 0, 0.3 and 1.07,
# and once 0.7, of a real one (docs/decisions.md)
SCENES = 0.25


@dataclass(frozen=True)
class Defocus:
    """A photograph's own defocus.

    Attributes
    ----------
    waves : Noll mode 4, RMS at the reference wavelength, mean of the colours'
    std : its standard error
    determined : whether it differs from best focus, 0, which is used otherwise
    """

    waves: float
    std: float
    determined: bool

    @property
    def doubts(self) -> list[str]:
        """Sentences on an undetermined defocus."""
        if self.determined:
            return []
        return [
            f"the photograph's own defocus, {abs(self.waves):.2f} ± {self.std:.2f} waves, does not differ from best focus: it "
            "is restored as if taken there; where its range is known, give it with --range"
        ]


def fitted_defocus(job: Job, progress: Progress = no_progress) -> tuple[Job, Defocus]:
    """Return the job with the likeliest defocus over all scenes, all colours moved alike, and the defocus.

    It has the sign of the session's defocus, since a photograph hardly determines the sign. Its error is a jackknife over
    parts, which differ in spectrum and depth. Raises ValueError if mode 4 is none of the modes.
    """
    defoci = [c.defocus for c in job.colours if c.defocus is not None]
    if len(defoci) < len(job.colours):
        raise ValueError(
            "the session's wavefronts have no mode 4: their defocus cannot be fitted"
        )
    own = float(np.mean(defoci))
    coarse = np.arange(0, SPAN_WAVES + COARSE_WAVES / 2, COARSE_WAVES)
    fine = np.arange(-0.75, 0.76, 0.25) * COARSE_WAVES
    total = len(coarse) + len(fine)

    def scored(places: Floats, done: int) -> Floats:
        """Return scores (places, parts)."""
        rows = []
        for k, place in enumerate(places):
            rows.append(_unlikely(moved(job, float(np.copysign(place, own)) - own)))
            progress(done + k + 1, total, f"defocus {np.copysign(place, own):+.3f} waves")
        return np.array(rows)

    rough = scored(coarse, 0)
    near = np.abs(coarse[np.argmin(rough.sum(axis=1))] + fine)
    scores = np.concatenate([rough, scored(near, len(coarse))])
    size, std = _jackknifed(np.concatenate([coarse, near]), scores)
    determined = size > SURE * std
    waves = float(np.copysign(size, own))
    return moved(job, (waves if determined else 0.0) - own), Defocus(waves, std, determined)


def moved(job: Job, by_waves: float) -> Job:
    """Return the job with every colour's defocus moved, waves RMS at the reference wavelength."""
    colours = []
    for colour in job.colours:
        step: Floats = np.zeros(len(colour.waves))
        step[colour.optics.noll.index(4)] = by_waves
        colours.append(replace(colour, waves=colour.waves + step, waves_at=None))
    return replace(job, colours=tuple(colours))


def _unlikely(job: Job) -> Floats:
    """Return the score of each part (parts,)."""
    coarse = job.of_samples(min(CHOSEN_ON, job.nyquist_samples))
    views = [coarse.views(area) for area in areas_of(job, BLIND_PART_PX)[:BLIND_PARTS]]
    return np.array(
        [unlikeliness(view, job.coupling) for view in views if view is not None]
    )


def _jackknifed(places: Floats, scores: Floats) -> tuple[float, float]:
    """Return the place of least summed score, and its standard error by leaving out parts and by scenes.

    B. Efron and C. Stein, Ann. Statist. 9, 586 (1981).
    """
    total = scores.sum(axis=1)
    count = scores.shape[1]
    without = places[np.argmin(total[:, None] - scores, axis=0)]
    if count < LEAST_BLIND_PARTS:
        return float(places[np.argmin(total)]), SPAN_WAVES
    spread = (count - 1) * float(np.var(without))
    return float(places[np.argmin(total)]), float(np.hypot(np.sqrt(spread), SCENES))
