"""The Gaussian likelihood whose variance follows its mean, with gradient and Fisher information (thesis 3.5-3.28).

Counts d with the black level removed are N(mu, Sigma), independent over pixels,

    mu = V (1 + sum_k c_k P_k) (scale u + ambient),    Sigma = gain mu + read_noise^2 + (s mu)^2 + q,

u the relative image of `labkit.imaging`, V the relative illumination, s its relative standard deviation, and q the variance
of rounding where that is known for each pixel, as behind a tone curve; the low orders P_k with their unknown c_k stand for
what no flat frame determined of the illumination. Of the five detector numbers of thesis (3.4) only four can be estimated
from frames (the information matrix over all five is exactly singular), so the black level is fixed from the raw file and
dark frames, and scale = c1 c3, ambient = c2 c3, gain = c3.
"""

from dataclasses import dataclass, field

import numpy as np

from labkit.arrays import mask_array, real_array
from labkit.imaging.model import Evaluation
from labkit.imaging.shine import Shine
from labkit.types import Bools, Floats


@dataclass(frozen=True)
class FrameData:
    """One frame's data of one channel.

    counts: (rows, columns) with black removed; used: the pixels that count; illumination: V; relative_std: s;
    departures: (k, rows, columns) P, see `low_orders`; none where flats determine V. rounding: (rows, columns) q, counts^2;
    none where the read noise holds it. shine: the part of V that is the
    target's own, blurred with it; none where it is not known.
    Raises ValueError where shapes differ, where nothing is used, or where a used pixel is not finite.
    """

    counts: Floats
    used: Bools
    illumination: Floats
    relative_std: Floats
    departures: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))
    rounding: Floats = field(default_factory=lambda: np.empty((0, 0)))
    shine: Shine | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.counts) != 2:
            raise ValueError(f"counts has shape {np.shape(self.counts)}; (rows, columns) is needed (counts)")
        mask_array("used", self.used, self.counts.shape)
        if not self.used.any():
            raise ValueError(f"used, shape {self.used.shape}: no pixel of the frame is used")
        for name, unit in (("counts", "counts"), ("illumination", "relative"), ("relative_std", "relative")):
            value = np.asarray(getattr(self, name))
            same = value.shape == self.counts.shape  # what is not used may be anything
            real_array(name, np.where(self.used, value, np.zeros_like(value)) if same else value, self.used.shape, unit)
        if len(self.departures):
            real_array("departures", self.departures, (None, *self.used.shape), "relative")
        if len(self.rounding):
            real_array("rounding", self.rounding, self.used.shape, "counts^2")

    def light(self, unevenness: Floats) -> Floats:
        """Relative illumination (pixels,) of the used pixels. unevenness: (k,) c, none of them for none."""
        known = self.illumination[self.used]
        return known * (1 + unevenness @ self.departures[:, self.used]) if len(self.departures) else known


def low_orders(rows: int, columns: int) -> Floats:
    """(5, rows, columns) x, y, x^2, xy, y^2 from -1 to 1 over a frame: how light falls off and leans, at its plainest."""
    y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
    return np.stack(np.broadcast_arrays(x, y, x**2, x * y, y**2))


@dataclass(frozen=True, slots=True)
class Detector:
    """Of one frame: scale and ambient in counts. Of all frames: gain in counts per electron, read_variance in counts^2,
    and the illumination's unevenness (k,) where no flats determine it."""

    scale: float
    ambient: float
    gain: float
    read_variance: float
    unevenness: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True)
class Score:
    """Log-likelihood of one frame with its gradient (p,) and Fisher information (p, p).

    Parameters in order: modes, pose (8), scale, ambient, unevenness (k), log gain, log read variance.
    """

    log_likelihood: float
    gradient: Floats
    information: Floats
    chi2: float
    pixels: int


def predict(relative: Floats, data: FrameData, detector: Detector) -> tuple[Floats, Floats]:
    """Mean and variance (pixels,) of the used pixels' counts from their relative image (pixels,).

    Raises ValueError for an image of other pixels.
    """
    light = data.light(detector.unevenness)
    if np.shape(relative) != light.shape:
        raise ValueError(f"relative has shape {np.shape(relative)}; {light.shape} is needed (of the target's radiance)")
    mean = light * (detector.scale * relative + detector.ambient)
    spread = data.relative_std[data.used] * mean
    variance = detector.gain * np.maximum(mean, 0.0) + detector.read_variance + spread**2
    return mean, variance + data.rounding[data.used] if len(data.rounding) else variance


def log_likelihood(relative: Floats, data: FrameData, detector: Detector) -> float:
    """Thesis (3.5), without its constant."""
    mean, variance = predict(relative, data, detector)
    return float(-0.5 * np.sum((data.counts[data.used] - mean) ** 2 / variance + np.log(variance)))


def chi2(relative: Floats, data: FrameData, detector: Detector) -> float:
    """Sum of squared residuals over their variance."""
    mean, variance = predict(relative, data, detector)
    return float(np.sum((data.counts[data.used] - mean) ** 2 / variance))


@dataclass(frozen=True, slots=True)
class Slopes:
    """Of one frame's counts, by its parameters in the order of `Score`.

    mean, variance: (pixels,). of_mean: (p - 2, pixels) by all but the noise's two, which change the variance alone:
    of_variance (2, pixels). bend: (pixels,) d variance / d mean.
    """

    mean: Floats
    variance: Floats
    of_mean: Floats
    of_variance: Floats
    bend: Floats

    def pulls(self, counts: Floats) -> tuple[Floats, Floats]:
        """(pixels,) each: slopes of a pixel's log-likelihood by its mean and by its variance (3.9). counts: (pixels,)."""
        normalised = (counts - self.mean) / self.variance
        rise = 0.5 * (normalised**2 - 1 / self.variance)
        return normalised + self.bend * rise, rise

    def weights(self) -> tuple[Floats, Floats, Floats]:
        """(pixels,) each: what a product of two slopes of the mean adds to the information, of one with one of the
        variance, and of two of the variance: thesis (3.15), (3.19), variance's dependence included."""
        square = 0.5 / self.variance**2
        cross = self.bend * square
        return 1 / self.variance + self.bend * cross, cross, square


def slopes(evaluation: Evaluation, data: FrameData, detector: Detector) -> Slopes:
    """Mean and variance of the used pixels' counts with their derivatives."""
    mean, variance = predict(evaluation.mean, data, detector)
    of_mean = np.concatenate(
        [
            detector.scale * evaluation.by_waves,
            detector.scale * evaluation.by_pose,
            evaluation.mean[None],
            np.ones((1, mean.size)),
        ]
    )
    of_mean *= data.light(detector.unevenness)
    if len(data.departures):
        even = data.illumination[data.used] * (detector.scale * evaluation.mean + detector.ambient)
        of_mean = np.concatenate([of_mean, data.departures[:, data.used] * even])
    of_variance = np.stack([detector.gain * np.maximum(mean, 0), np.full_like(mean, detector.read_variance)])
    bend = detector.gain * (mean > 0) + 2 * data.relative_std[data.used] ** 2 * mean
    return Slopes(mean, variance, of_mean, of_variance, bend)


def score(evaluation: Evaluation, data: FrameData, detector: Detector) -> Score:
    """Log-likelihood, gradient (3.9) and Fisher information (3.15), (3.19)."""
    of = slopes(evaluation, data, detector)
    counts = data.counts[data.used]
    by_mean, by_variance = of.pulls(counts)
    gradient = np.concatenate([of.of_mean @ by_mean, of.of_variance @ by_variance])
    both, cross, square = of.weights()
    across = of.of_mean @ (of.of_variance * cross).T
    weighted = of.of_mean * np.sqrt(both)
    information = np.block([[weighted @ weighted.T, across], [across.T, (of.of_variance * square) @ of.of_variance.T]])
    chi2 = float(np.sum((counts - of.mean) ** 2 / of.variance))
    return Score(-0.5 * (chi2 + float(np.sum(np.log(of.variance)))), gradient, information, chi2, of.mean.size)
