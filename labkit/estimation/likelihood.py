"""The likelihood of counts, and of a frame of a target, with gradient and Fisher information (thesis 3.2-3.28).

Every likelihood in labkit is that of `NormalCounts`. A frame's counts have the mean

    mu = V (1 + sum_k c_k P_k) (scale u + ambient),

where u is the relative image of `labkit.imaging` and V the relative illumination. Low orders P_k with unknown coefficients c_k
describe illumination that no flat frame determined. Of the five detector numbers of thesis (3.4) only four can be estimated
from frames (the information matrix over all five is exactly singular), so the black level is fixed from the raw file and
dark frames, and scale = c1 c3, ambient = c2 c3, gain = c3.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from labkit.arrays import mask_array, real_array
from labkit.imaging.brightness import Brightness
from labkit.imaging.model import Evaluation
from labkit.types import Bools, Floats


@dataclass(frozen=True, eq=False)
class NormalCounts:
    """The distribution of counts with the black level removed: independent, normal, the variance a function of the mean.

    Attributes
    ----------
    mean : counts, any shape; all other arrays have the same shape
    gain : counts per electron
    read_variance : counts^2
    relative_std : standard deviation of the illumination, relative
    rounding : variance of rounding, counts^2, where it differs from pixel to pixel

    Notes
    -----
    Thesis (3.2): variance = gain max(mean, 0) + read_variance + (relative_std mean)^2 + rounding. A mean below 0, as a PSF's
    rings can make it, has no photon noise.
    """

    mean: Floats
    gain: float
    read_variance: float
    relative_std: Floats | float = 0.0
    rounding: Floats | float = 0.0

    @cached_property
    def variance(self) -> Floats:
        """Variance of the counts, counts^2."""
        spread = self.relative_std * self.mean
        photons = self.gain * np.maximum(self.mean, 0.0)
        return np.asarray(photons + self.read_variance + spread**2 + self.rounding)

    @cached_property
    def bend(self) -> Floats:
        """Derivative of the variance with respect to the mean, counts."""
        return np.asarray(
            self.gain * (self.mean > 0) + 2 * self.relative_std**2 * self.mean
        )

    @cached_property
    def of_variance(self) -> Floats:
        """(2, ...) derivatives of the variance with respect to the logarithms of gain and read variance, counts^2."""
        return np.stack(
            [
                self.gain * np.maximum(self.mean, 0.0),
                np.full_like(self.mean, self.read_variance),
            ]
        )

    def chi2(self, counts: Floats) -> float:
        """Return the sum of squared residuals over their variance."""
        return float(np.sum((counts - self.mean) ** 2 / self.variance))

    def log_likelihood(self, counts: Floats) -> float:
        """Return the log-likelihood, thesis (3.5), without its constant."""
        return float(
            -0.5 * np.sum((counts - self.mean) ** 2 / self.variance + np.log(self.variance))
        )

    def pulls(self, counts: Floats) -> tuple[Floats, Floats]:
        """Return derivatives of each pixel's log-likelihood by its mean and by its variance, thesis (3.9).

        The derivative by the mean includes the variance's dependence on the mean.
        """
        normalised = (counts - self.mean) / self.variance
        rise = 0.5 * (normalised**2 - 1 / self.variance)
        return normalised + self.bend * rise, rise

    def weights(self) -> tuple[Floats, Floats, Floats]:
        """Return weights of products of derivatives in the Fisher information of each pixel, thesis (3.15), (3.19).

        Returns
        -------
        weights for mean times mean, mean times variance, variance times variance
        """
        square = 0.5 / self.variance**2
        cross = self.bend * square
        return 1 / self.variance + self.bend * cross, cross, square


@dataclass(frozen=True, eq=False, kw_only=True)
class Slopes(NormalCounts):
    """Counts with the derivatives of their mean with respect to parameters.

    Attributes
    ----------
    of_mean : (parameters, pixels), counts per unit of the parameter; the logarithms of gain and read variance, which do not
        affect the mean, follow these parameters
    """

    of_mean: Floats

    def gradient(self, counts: Floats) -> Floats:
        """Return the gradient (parameters + 2,) of the log-likelihood, thesis (3.9)."""
        by_mean, by_variance = self.pulls(counts)
        return np.concatenate([self.of_mean @ by_mean, self.of_variance @ by_variance])

    def information(self) -> Floats:
        """Return the Fisher information (parameters + 2, parameters + 2), thesis (3.15), (3.19)."""
        both, cross, square = self.weights()
        across = self.of_mean @ (self.of_variance * cross).T
        weighted = self.of_mean * np.sqrt(both)
        own = (self.of_variance * square) @ self.of_variance.T
        return np.block([[weighted @ weighted.T, across], [across.T, own]])


@dataclass(frozen=True)
class FrameData:
    """One frame's data of one channel.

    Attributes
    ----------
    counts : (rows, columns), black level removed
    used : (rows, columns) mask of the pixels that count
    illumination : (rows, columns) relative illumination V
    relative_std : (rows, columns) relative standard deviation of V
    departures : (k, rows, columns) low orders P, see `low_orders`; empty if flats determine V
    rounding : (rows, columns) variance of rounding, counts^2; empty if the read noise includes rounding
    brightness : part of V that belongs to the target and is blurred with the target; None if unknown
    beside : (rows, columns) light of neighbouring targets for a lambda N of one pixel, 1 for white; None without

    Raises
    ------
    ValueError : shapes differ, no pixel is used, or a used pixel is not finite
    """

    counts: Floats
    used: Bools
    illumination: Floats
    relative_std: Floats
    departures: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))
    rounding: Floats = field(default_factory=lambda: np.empty((0, 0)))
    brightness: Brightness | None = None
    beside: Floats | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.counts) != 2:
            raise ValueError(
                f"counts has shape {np.shape(self.counts)}; (rows, columns) is needed (counts)"
            )
        mask_array("used", self.used, self.counts.shape)
        if not self.used.any():
            raise ValueError(
                f"used, shape {self.used.shape}: no pixel of the frame is used"
            )
        for name, unit in (
            ("counts", "counts"),
            ("illumination", "relative"),
            ("relative_std", "relative"),
        ):
            value = np.asarray(getattr(self, name))
            same = value.shape == self.counts.shape  # what is not used may be anything
            real_array(
                name,
                np.where(self.used, value, np.zeros_like(value)) if same else value,
                self.used.shape,
                unit,
            )
        if len(self.departures):
            real_array("departures", self.departures, (None, *self.used.shape), "relative")
        if self.beside is not None:
            real_array("beside", self.beside, self.used.shape, "relative")
        if len(self.rounding):
            real_array("rounding", self.rounding, self.used.shape, "counts^2")

    def light(self, unevenness: Floats) -> Floats:
        """Return the relative illumination (pixels,) of the used pixels. unevenness: (k,) coefficients of `departures`."""
        known = self.illumination[self.used]
        return (
            known * (1 + unevenness @ self.departures[:, self.used])
            if len(self.departures)
            else known
        )


def low_orders(rows: int, columns: int) -> Floats:
    """Return x, y, x^2, xy, y^2, (5, rows, columns), from -1 to 1 over a frame: the simplest falloff and gradient of light."""
    y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
    return np.stack(np.broadcast_arrays(x, y, x**2, x * y, y**2))


@dataclass(frozen=True, slots=True)
class Detector:
    """Detector numbers of a frame.

    Attributes
    ----------
    scale, ambient : of the frame, counts
    gain : of all frames, counts per electron
    read_variance : of all frames, counts^2
    unevenness : (k,) of the illumination, of all frames; empty if flats determine it
    """

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


def expected(relative: Floats, data: FrameData, detector: Detector) -> NormalCounts:
    """Return the distribution of the used pixels' counts (pixels,) for a relative image (pixels,).

    Raises
    ------
    ValueError : the image has another number of pixels
    """
    light = data.light(detector.unevenness)
    if np.shape(relative) != light.shape:
        raise ValueError(
            f"relative has shape {np.shape(relative)}; {light.shape} is needed (of the target's radiance)"
        )
    return NormalCounts(
        light * (detector.scale * relative + detector.ambient),
        detector.gain,
        detector.read_variance,
        data.relative_std[data.used],
        data.rounding[data.used] if len(data.rounding) else 0.0,
    )


def predict(relative: Floats, data: FrameData, detector: Detector) -> tuple[Floats, Floats]:
    """Return mean and variance of `expected`, (pixels,) each."""
    counts = expected(relative, data, detector)
    return counts.mean, counts.variance


def log_likelihood(relative: Floats, data: FrameData, detector: Detector) -> float:
    """Return the log-likelihood, thesis (3.5), without its constant."""
    return expected(relative, data, detector).log_likelihood(data.counts[data.used])


def chi2(relative: Floats, data: FrameData, detector: Detector) -> float:
    """Return the sum of squared residuals over their variance."""
    return expected(relative, data, detector).chi2(data.counts[data.used])


def slopes(evaluation: Evaluation, data: FrameData, detector: Detector) -> Slopes:
    """Return `expected` with derivatives with respect to the parameters of `Score`."""
    counts = expected(evaluation.mean, data, detector)
    of_mean = np.concatenate(
        [
            detector.scale * evaluation.by_waves,
            detector.scale * evaluation.by_pose,
            evaluation.mean[None],
            np.ones((1, counts.mean.size)),
        ]
    )
    of_mean *= data.light(detector.unevenness)
    if len(data.departures):
        even = data.illumination[data.used] * (
            detector.scale * evaluation.mean + detector.ambient
        )
        of_mean = np.concatenate([of_mean, data.departures[:, data.used] * even])
    noise = (counts.gain, counts.read_variance, counts.relative_std, counts.rounding)
    return Slopes(counts.mean, *noise, of_mean=of_mean)


def score(evaluation: Evaluation, data: FrameData, detector: Detector) -> Score:
    """Return log-likelihood, gradient and Fisher information, thesis (3.9), (3.15), (3.19)."""
    of = slopes(evaluation, data, detector)
    counts = data.counts[data.used]
    return Score(of.log_likelihood(counts), of.gradient(counts), of.information())
