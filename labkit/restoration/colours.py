"""The covariance of a scene's colours: the share of their common detail."""

from __future__ import annotations

import numpy as np

from labkit.restoration.job import Job
from labkit.types import Floats

LEAST_OWN = 0.02  # least variance of a combination of colours, relative to the largest: greys vary in one only


def colour_coupling(job: Job) -> Floats:
    """Return the inverse (colours, colours) of the covariance of neighbours' differences without noise, of mean diagonal 1.

    A scene's colours share their edges: with this as coupling of `Roughness` the colours complete each other.
    """
    photograph = job.photographs[0]
    images = []
    noise = []
    for colour in job.colours:
        places = [job.plane(place) for place in colour.places]
        planes = [photograph.counts[place] for place in places]
        used = [photograph.used[place] for place in places]
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
