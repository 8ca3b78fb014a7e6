"""What a photograph is asked of itself where the session does not tell: its noise, its defocus."""

from __future__ import annotations

from dataclasses import replace

from labkit.restoration.blind import Defocus
from labkit.restoration.job import Job
from labkit.restoration.noise import own_noise


def doubts(defocus: Defocus) -> list[str]:
    """What is to be said of a fitted defocus."""
    if defocus.told:
        return []
    return [
        f"the photograph's own defocus, {abs(defocus.waves):.2f} ± {defocus.std:.2f} waves, is not told from best focus: it is "
        "restored as if taken there; where its range is known, give it with --range"
    ]


def with_own_noise(job: Job, notes: list[str]) -> Job:
    """The job with the first photograph's noise, by itself, where that tells it: another camera's is not the session's."""
    colours = []
    for colour in job.colours:
        if (noise := own_noise(job.photographs[0], colour, job.period)) is not None:
            notes.append(
                f"{colour.name}: the noise is the photograph's own, {noise[0]:.2g} counts an electron; the session's has "
                f"{colour.gain:.2g}"
            )
            colour = replace(colour, gain=noise[0], read_variance=noise[1])
        colours.append(colour)
    return replace(job, colours=tuple(colours))
