"""How much of their detail the colours of a photograph have in common."""

from __future__ import annotations

import numpy as np

from labkit.restoration.job import Job
from labkit.types import Floats

LEAST_OWN = 0.02  # of the largest, that a combination of colours is held to vary by: greys leave colours nothing of their own


def colour_coupling(job: Job) -> Floats:
    """(colours, colours) inverse of the covariance of neighbours' differences, noise taken off; its trace's mean is 1.

    A scene's colours share their edges; with this as `Roughness`'s coupling, what one colour's planes miss the others fill in.
    """
    photograph, images, noise = job.photographs[0], [], []
    for colour in job.colours:
        planes = [
            photograph.counts[r :: job.period, c :: job.period] for r, c in colour.places
        ]
        used = [photograph.used[r :: job.period, c :: job.period] for r, c in colour.places]
        images.append(np.where(np.all(used, axis=0), np.mean(planes, axis=0), np.nan))
        level = max(float(np.nanmean(images[-1])), 0.0)
        noise.append(2 * (colour.gain * level + colour.read_variance) / len(planes))
    apart = [
        np.diff(np.array(images), axis=axis).reshape(len(images), -1) for axis in (1, 2)
    ]
    steps = np.concatenate(apart, axis=1)
    steps = steps[:, np.isfinite(steps).all(axis=0)]
    covariance = (
        np.atleast_2d(np.cov(steps)) - np.diag(noise)
        if steps.shape[1] > 1
        else np.diag(noise)
    )
    sizes = np.sqrt(np.maximum(np.diag(covariance), 0.01 * np.array(noise)))
    values, vectors = np.linalg.eigh(covariance / np.outer(sizes, sizes))
    alike = (vectors * np.maximum(values, LEAST_OWN * values.max())) @ vectors.T
    coupling = np.linalg.inv(alike * np.outer(sizes, sizes))
    return np.asarray(coupling / np.mean(np.diag(coupling)))
