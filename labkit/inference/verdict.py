"""Whether the end of a climb is believed to be the global optimum: what is left of the data must be noise.

A wrong optimum leaves structure behind, of two kinds that are asked for separately: more variance than the noise
measured beforehand, and likeness between neighbouring pixels. Both statistics are standard normal at the truth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from labkit.inference.likelihood import Detector, predict
from labkit.inference.solve import Problem, State
from labkit.optics.zernike import Floats

SIGNIFICANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Verdict:
    """name: of the test. p_value: chance of residuals this odd at the truth. starts: climbs made to get here."""

    p_value: float
    accepted: bool
    excess: float
    likeness: float
    starts: int
    name: str = "residuals"


def judge(problem: Problem, state: State, relative: list[Floats], starts: int, model_error: float = 0.01) -> Verdict:
    """Judge an optimum by its residuals.

    excess: chi2 against the noise as calibrated, in its standard deviations, those of the calibration and of a
    relative model_error in the residual variance included. likeness: correlation of neighbours along rows and columns,
    in its standard deviations. Two one-sided tests, Bonferroni.
    """
    gain, read_variance = np.exp(problem.noise.centre)
    total, pixels, photon_share, pairs, products = 0.0, 0, 0.0, 0.0, 0.0
    for frame, own, u in zip(problem.frames, state.detectors(), relative, strict=True):
        calibrated = Detector(own.scale, own.ambient, float(gain), float(read_variance))
        mean, variance = predict(u, frame, calibrated)
        normalised = (frame.counts[frame.used] - mean) / np.sqrt(variance)
        total += float(np.sum(normalised**2))
        pixels += mean.size
        photon_share += float(np.sum(gain * np.maximum(mean, 0) / variance))
        image = np.zeros(frame.used.shape)
        image[frame.used] = normalised / np.sqrt(np.mean(normalised**2))
        for product in _neighbour_products(image):
            products += float(product.sum())
            pairs += np.count_nonzero(product)
    share = photon_share / pixels
    calibration = np.hypot(share * problem.noise.gain_std, (1 - share) * problem.noise.read_variance_std)
    excess = (total / pixels - 1) / np.sqrt(2 / pixels + calibration**2 + model_error**2)
    likeness = products / np.sqrt(pairs) / np.sqrt(1 + pairs * (model_error / 4) ** 2)
    p_value = min(1.0, 2 * float(min(norm.sf(excess), norm.sf(likeness))))
    return Verdict(p_value, p_value >= SIGNIFICANCE, float(excess), float(likeness), starts)


def _neighbour_products(image: Floats) -> list[Floats]:
    """Products of nearest neighbours of the same colour along rows and along columns, whatever the mosaic's period."""
    products = []
    for axis in (0, 1):
        for period in (1, 2):
            n = image.shape[axis]
            product = np.take(image, np.arange(n - period), axis) * np.take(image, np.arange(period, n), axis)
            if np.any(product):
                products.append(product)
                break
    return products
