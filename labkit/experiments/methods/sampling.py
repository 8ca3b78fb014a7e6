"""Sampling of periodic band-limited signals at any rate, up or down: the operator S (thesis 2.61-2.69, Figure 5.3)."""

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import scipy.fft
import scipy.sparse

from labkit.arrays import real_array
from labkit.types import Floats


@dataclass(frozen=True)
class Sampling:
    """Resampling S of a signal on a torus, from one grid to a finer or coarser grid with the same first sample.

    A coarser grid aliases, as a sensor does. The frequency n/2 of an even n is split into (1 + j)/2 and (1 - j)/2 of
    itself at +n/2 and -n/2. The split keeps its energy: a finer grid loses nothing, and S^T S is the identity times the
    ratio of sizes.

    Parameters
    ----------
    source, result : samples along each axis, before and after; any number of axes, ratios whole or not

    Raises
    ------
    ValueError
        for sizes that are not positive whole numbers, or of different numbers of axes
    """

    source: tuple[int, ...]
    result: tuple[int, ...]
    _folds: tuple[scipy.sparse.csr_array, ...] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        for name, sizes in (("source", self.source), ("result", self.result)):
            if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes):
                raise ValueError(
                    f"{name}: positive whole numbers of samples are needed, not {sizes}"
                )
        if len(self.source) != len(self.result):
            raise ValueError(
                f"source {self.source} and result {self.result} (samples) differ in their number of axes"
            )
        folds = tuple(_fold(n, m) for n, m in zip(self.source, self.result, strict=True))
        object.__setattr__(self, "_folds", folds)

    def apply(self, signal: Floats) -> Floats:
        """Return the signal (*source) resampled to (*result). Thesis (2.68)."""
        signal = real_array("signal", signal, self.source, "radiance")
        for axis, fold in enumerate(self._folds):
            signal = _through(signal, axis, fold) * (fold.shape[0] / fold.shape[1])
        return signal

    def adjoint(self, values: Floats) -> Floats:
        """Return the transpose of `apply`, from (*result) to (*source)."""
        values = real_array("values", values, self.result, "radiance")
        for axis, fold in enumerate(self._folds):
            values = _through(values, axis, scipy.sparse.csr_array(fold.conj().T))
        return values


def grid_sizes(
    ratio: float, source_least: int, result_least: int, tolerance: float
) -> tuple[int, int]:
    """Return the smallest grid sizes (source, result) whose quotient is a ratio within a tolerance.

    Of all pairs with |source / result - ratio| <= tolerance ratio, the pair with the
    smallest result is returned; of
    these, the nearest to the ratio.

    Parameters
    ----------
    ratio : source to result, above 0
    source_least, result_least : lower limits, samples
    tolerance : relative, between 0 and 1

    Raises
    ------
    ValueError
        for numbers out of these limits

    Notes
    -----
    Thesis (5.28)-(5.32) and Figure 5.3, which may break (5.32) for ratios below 1.
    """
    if not (math.isfinite(ratio) and ratio > 0):
        raise ValueError(
            f"ratio = {ratio}: a finite number of samples to a sample, above 0, is needed"
        )
    if not 0 < tolerance < 1:
        raise ValueError(
            f"tolerance = {tolerance}: a relative error between 0 and 1 is needed"
        )
    if source_least < 1 or result_least < 1:
        raise ValueError(
            f"source_least = {source_least}, result_least = {result_least}: at least one sample is needed"
        )
    # in whole numbers: rounding would decide which pairs at the very tolerance fit
    wanted = Fraction(ratio)
    allowed = Fraction(tolerance) * wanted
    result = max(result_least, math.ceil(source_least / (wanted + allowed)))
    while True:
        source = max(source_least, round(wanted * result))
        if abs(Fraction(source, result) - wanted) <= allowed:
            return source, result
        result += 1


def _fold(source: int, result: int) -> scipy.sparse.csr_array:
    """Return the (result, source) map between the DFTs on both grids, up to the ratio of sizes. Thesis
    (2.61)-(2.69).
    """
    line = np.arange(-(source // 2), source // 2 + 1)
    share = np.ones(line.size, complex)
    if source % 2 == 0:
        share[[0, -1]] = (1 - 1j) / 2, (1 + 1j) / 2
    return scipy.sparse.csr_array(
        (share, (line % result, line % source)), shape=(result, source)
    )


def _through(signal: Floats, axis: int, fold: scipy.sparse.csr_array) -> Floats:
    """Fold the spectrum of a real signal along one axis."""
    spectrum = scipy.fft.fft(np.moveaxis(signal, axis, 0), axis=0)
    size = fold.shape[0]
    others = spectrum.shape[1:]
    folded = np.asarray(fold @ spectrum.reshape(fold.shape[1], -1))
    result = scipy.fft.ifft(folded.reshape(size, *others), axis=0).real
    return np.asarray(np.moveaxis(result, 0, axis))
