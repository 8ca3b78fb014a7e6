"""The smoothest torus through known samples: guard bands and holes filled with the least bandwidth (thesis 2.28-2.32).

Smooth means little spectral energy times squared frequency, which is the integral of the squared gradient of the signal's
continuous, periodic, band-limited extension.
"""

import numpy as np
import scipy.fft
from scipy.sparse.linalg import LinearOperator, cg

from labkit.arrays import mask_array, real_array
from labkit.errors import FitError
from labkit.types import Bools, Floats

TOLERANCE = 1e-8
"""Of the gradient on the unknown samples, relative to that of holes filled with the mean."""

ROUNDING = 1e-14
MAX_STEPS = 1000


def roughness(signal: Floats) -> tuple[float, Floats]:
    """Half the summed squared gradient, radiance^2 per sample^2, and its derivative by each sample. Thesis (2.31), (2.32).

    signal: any number of axes, periodic. Raises ValueError for one that is no finite array.
    """
    signal = real_array("signal", signal, np.shape(signal), "radiance")
    slope = _filtered(signal, _weights(signal.shape))
    return 0.5 * float(np.vdot(signal, slope)), slope


def fill(signal: Floats, known: Bools) -> Floats:
    """The signal with its unknown samples replaced by the smoothest ones; the known ones stay as they are, to the bit.

    signal: any number of axes, periodic; unknown samples may hold anything. known: mask of the same shape. The solution is
    unique; conjugate gradients on the unknown samples find it. Raises ValueError for other arrays or where nothing is known,
    FitError should the gradients not converge. Thesis (2.28)-(2.32).
    """
    known = mask_array("known", known, np.shape(signal))
    if not known.any():
        raise ValueError(f"known, shape {known.shape}: not one sample is known")
    filled = np.where(known, signal, 0.0)
    filled = real_array("signal", filled, known.shape, "radiance, where known")
    unknown = ~known
    filled[unknown] = filled[known].mean()
    if unknown.any():
        filled[unknown] += _step_to_smoothest(filled, unknown)
    return filled


def _step_to_smoothest(filled: Floats, unknown: Bools) -> Floats:
    """What the unknown samples of a filled signal lack, by conjugate gradients. Thesis (2.31), (2.32)."""

    def on_unknown(weights: Floats) -> LinearOperator:
        def apply(step: Floats) -> Floats:
            spread = np.zeros(unknown.shape)
            spread[unknown] = step
            return _filtered(spread, weights)[unknown]

        return LinearOperator((count, count), matvec=apply, dtype=np.float64)

    weights, lowest = _weights(unknown.shape), (2 * np.pi / max(unknown.shape)) ** 2
    count = int(np.count_nonzero(unknown))
    # F^H W^-1 F conditions all of them, holes, guard bands and scattered samples: 60-80 steps, where without it a guard
    # band takes 700, and where with W^-2 scattered samples take 200
    step, failed = cg(
        on_unknown(weights),
        -_filtered(filled, weights)[unknown],
        rtol=TOLERANCE,
        atol=ROUNDING * float(np.linalg.norm(filled)),
        maxiter=MAX_STEPS,
        M=on_unknown(1 / np.sqrt(np.maximum(weights, lowest))),
    )
    if failed:
        raise FitError(f"the smoothest filling of {count} samples did not converge in {failed} steps")
    return np.asarray(step)


def guard_band(image: Floats, shape: tuple[int, ...]) -> Floats:
    """The image in the middle of a larger torus of the given shape, smoothly extended around it. Thesis Figure 2.8.

    It starts at (larger - smaller) // 2 along each axis. Raises ValueError for a shape that cannot hold it.
    """
    image = real_array("image", image, np.shape(image), "radiance")
    if len(shape) != image.ndim or any(large < small for large, small in zip(shape, image.shape, strict=True)):
        raise ValueError(f"shape {shape} (samples) cannot hold an image of shape {image.shape}")
    inside = tuple(slice(start := (n - m) // 2, start + m) for n, m in zip(shape, image.shape, strict=True))
    torus, known = np.zeros(shape), np.zeros(shape, bool)
    torus[inside], known[inside] = image, True
    return fill(torus, known)


def _weights(shape: tuple[int, ...]) -> Floats:
    """W^2, squared frequencies in radians per sample, on the half of the spectrum that a real signal has."""
    frequencies = [scipy.fft.fftfreq(n) for n in shape[:-1]] + [scipy.fft.rfftfreq(shape[-1])]
    return np.asarray(sum((2 * np.pi * f) ** 2 for f in np.meshgrid(*frequencies, indexing="ij", sparse=True)))


def _filtered(signal: Floats, weights: Floats) -> Floats:
    """F^H (weights) F of a real signal."""
    return np.asarray(scipy.fft.irfftn(scipy.fft.rfftn(signal) * weights, signal.shape))
