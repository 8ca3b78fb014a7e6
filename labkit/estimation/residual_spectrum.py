"""Power of the residuals by spatial frequency: flat for noise alone."""

from collections.abc import Sequence

import numpy as np

from labkit.estimation.likelihood import Detector, FrameData, predict
from labkit.types import Floats

BINS = 12


def residual_frequencies(frames: Sequence[FrameData]) -> Floats:
    """Return the frequencies of `residual_spectrum`, (BINS,) cycles per pixel: middles of evenly spaced rings."""
    return (np.arange(BINS) + 0.5) * _highest(frames) / BINS


def residual_spectrum(
    frames: Sequence[FrameData], relative: Sequence[Floats], detectors: Sequence[Detector]
) -> Floats:
    """Compute the power of normalised residuals by spatial frequency.

    Frequencies beyond the Nyquist frequency of a Bayer plane are aliases, and are left out.

    Parameters
    ----------
    frames : counts, with calibration
    relative : relative image (pixels,) of the used pixels of each frame
    detectors : detector numbers of each frame

    Returns
    -------
    (BINS,) power averaged over rings of frequencies and over frames; 1 for noise alone
    """
    highest, total = _highest(frames), np.zeros(BINS)
    for frame, image, detector in zip(frames, relative, detectors, strict=True):
        mean, variance = predict(image, frame, detector)
        rest = np.zeros(frame.used.shape)
        rest[frame.used] = (frame.counts[frame.used] - mean) / np.sqrt(variance)
        power = np.abs(np.fft.fft2(rest)) ** 2 / mean.size
        at = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, rest.shape), indexing="ij"))
        rings = np.digitize(at, np.linspace(0, highest, BINS + 1)) - 1
        inside = rings < BINS
        total += np.bincount(rings[inside], power[inside], BINS) / np.maximum(
            np.bincount(rings[inside], minlength=BINS), 1
        )
    return total / len(frames)


def _highest(frames: Sequence[FrameData]) -> float:
    """Return the Nyquist frequency of the frames' pixels, cycles per pixel; a Bayer plane has half of the sensor's."""
    rows, columns = np.nonzero(frames[0].used)
    alone = frames[0].used.sum() < 0.6 * (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    return 0.25 if alone else 0.5
