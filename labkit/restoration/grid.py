"""The grid of a restored scene: its spectra, and how planes of a mosaic sample them (thesis 2.61, 4.41)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.fft

from labkit.imaging.grid import Torus
from labkit.types import (
    AnyComplexes,
    AnyFloats,
    Bools,
    Complexes,
    Complexes64,
    Floats,
    Floats32,
)


@dataclass(frozen=True)
class SceneGrid:
    """Fine samples around a frame of pixels, a whole number to a pixel, on a torus.

    frame: (rows, columns) of pixels, whole cells of `period`. guard_px: pixels beyond it on every side, at least, from which
    light reaches it. period: pixels to a cell of the filter array, 2 for Bayer's, 1 for mono. samples: to a pixel.
    pixels, cells: the same torus counted in pixels, and in cells with a sample of each plane.

    Spectra are half planes (fine rows // 2 + 1, fine columns), rows from frequency 0 up; the row at Nyquist's frequency, if
    there is one, is seen by no plane.
    """

    frame: tuple[int, int]
    guard_px: int
    pitch_um: float
    samples: int
    period: int
    pixels: Torus = field(init=False, repr=False, compare=False)
    cells: Torus = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.samples < 1 or any(
            side % self.period or side < self.period for side in self.frame
        ):
            raise ValueError(
                f"a frame of {self.frame} pixels and {self.samples} samples to a pixel: whole cells of "
                f"{self.period} pixels and a sample or more are needed"
            )
        guard = -(-self.guard_px // self.period)
        frame = (self.frame[0] // self.period, self.frame[1] // self.period)
        rows, columns = (
            scipy.fft.next_fast_len(side + 2 * guard, real=True) for side in frame
        )
        margin = ((rows - frame[0]) // 2, (columns - frame[1]) // 2)
        step, limit = self.period * self.samples, self.samples / (2 * self.pitch_um)
        object.__setattr__(
            self,
            "cells",
            Torus((rows, columns), margin, frame, step, self.period * self.pitch_um, limit),
        )
        wide, at = (
            (self.period * a, self.period * b) for a, b in ((rows, columns), margin)
        )
        object.__setattr__(
            self, "pixels", Torus(wide, at, self.frame, self.samples, self.pitch_um, limit)
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of fine samples."""
        return self.pixels.fine

    @property
    def inner(self) -> tuple[slice, slice]:
        """The fine samples within the frame's pixels, the first of each pixel in its centre."""
        rows, columns = (
            slice(m * self.samples, (m + f) * self.samples)
            for m, f in zip(self.pixels.margin, self.frame, strict=True)
        )
        return rows, columns

    @cached_property
    def frequencies(self) -> tuple[Floats, Floats]:
        """Along rows (half, 1) and columns (1, columns), cycles a pixel."""
        rows, columns = self.shape
        step = 1 / self.samples
        return scipy.fft.rfftfreq(rows, step)[:, None], scipy.fft.fftfreq(columns, step)[
            None, :
        ]

    @cached_property
    def squared_frequency(self) -> Floats32:
        """Half plane of w^2, (radians a pixel)^2: the diagonal of thesis (K.10)."""
        down, right = self.frequencies
        return ((2 * np.pi) ** 2 * (down**2 + right**2)).astype(np.float32)

    @cached_property
    def share(self) -> Floats32:
        """(half, 1) by which a half plane's squares sum to the image's: Parseval's."""
        rows, columns = self.shape
        share = np.full((rows // 2 + 1, 1), 2.0 / (rows * columns), np.float32)
        share[0] /= 2
        if rows % 2 == 0:
            share[-1] /= 2
        return share

    def whole(self, transfer: AnyComplexes) -> Complexes64:
        """Return a transfer function on the torus's band as a half plane, 0 at Nyquist's row."""
        half = np.zeros((self.shape[0] // 2 + 1, self.shape[1]), np.complex64)
        half[: len(transfer)] = transfer
        return half

    def shifted(self, transfer: Complexes64, shift_px: tuple[float, float]) -> Complexes64:
        """Return a transfer function with a shift, pixels down and right."""
        down, right = (
            np.exp(-2j * np.pi * by * w).astype(np.complex64)
            for by, w in zip(shift_px, self.frequencies, strict=True)
        )
        return np.asarray(transfer * down * right)

    def spectrum(self, scene: AnyFloats) -> AnyComplexes:
        """Return the half plane of a scene's DFT, (..., rows, columns), in its precision."""
        return np.asarray(scipy.fft.rfftn(scene, axes=(-1, -2)))

    def image(self, spectrum: AnyComplexes) -> AnyFloats:
        """Return the scene of a half plane."""
        return np.asarray(scipy.fft.irfftn(spectrum, s=self.shape[::-1], axes=(-1, -2)))

    def sample(self, spectrum: AnyComplexes) -> Floats:
        """Return the samples (rows, columns) of a plane, one for each cell of the frame, of a blurred scene's half plane."""
        return self.cells.sample(spectrum)

    def spread(self, plane: Floats, transfer: Complexes64) -> Complexes64:
        """Return the half plane of a plane through the transpose of blur by a transfer function and `sample`."""
        cells = np.zeros(self.cells.pixels)
        cells[self.at_frame] = plane
        folded = scipy.fft.fft2(cells).astype(np.complex64)[:, None, :]
        (rows, columns), result = self.cells.pixels, np.conj(transfer)
        for first in range(0, len(result), rows):  # the spectrum of samples repeats itself
            block = result[first : first + rows].reshape(
                -1, self.cells.oversampling, columns
            )
            block *= folded[: len(block)]
        return np.asarray(result)

    def finer(self, scene: Floats32, samples: int) -> Floats32:
        """Return a scene (..., rows, columns) of this grid on one of more samples a pixel, by its spectrum."""
        rows, columns = (side // self.samples * samples for side in self.shape)
        spectrum = self.spectrum(scene)
        if self.shape[0] % 2 == 0:
            spectrum[..., -1, :] *= 0.5
        half = self.shape[1] // 2
        wide = np.zeros((*spectrum.shape[:-2], rows // 2 + 1, columns), spectrum.dtype)
        wide[..., : spectrum.shape[-2], :half] = spectrum[..., :half]
        wide[..., : spectrum.shape[-2], half - self.shape[1] :] = spectrum[..., half:]
        fine = scipy.fft.irfftn(wide, s=(columns, rows), axes=(-1, -2))
        return np.asarray(fine * np.float32((samples / self.samples) ** 2))

    @property
    def at_frame(self) -> tuple[slice, slice]:
        """The frame among the torus's cells."""
        rows, columns = (
            slice(m, m + f)
            for m, f in zip(self.cells.margin, self.cells.frame, strict=True)
        )
        return rows, columns

    def kernel(self, spectrum: AnyComplexes) -> Complexes:
        """Return the DFT (cells rows, cells columns // 2 + 1) of the samples of a half plane at all cells."""
        folded = self.cells.folded_rows(self.cells.folded_columns(spectrum))
        kernel = 2.0 / self.cells.oversampling**2 * scipy.fft.ifft2(folded).real
        return np.asarray(scipy.fft.rfft2(kernel))

    def seen(self, planes: Sequence[Bools]) -> Bools:
        """Return the mask (rows, columns) of fine samples in cells of the frame with data. planes: used counts of each."""
        seen, step = np.zeros(self.shape, bool), self.cells.oversampling
        used = np.any(planes, axis=0)
        seen[self.inner] = np.repeat(np.repeat(used, step, axis=0), step, axis=1)
        return seen
