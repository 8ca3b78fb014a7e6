"""The torus on which an image is modelled, and the folding of its spectrum by sampling (thesis 2.61-2.69)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.fft

from labkit.types import AnyComplexes, AnyFloats, Complexes, Complexes64, Floats


@dataclass(frozen=True)
class Torus:
    """A periodic fine grid around a frame of pixels, with a whole number of fine samples to a pixel.

    pixels: (rows, columns) of the torus, in pixels; the frame begins at `margin`, the rest
    is guard band. oversampling: fine samples to a pixel along each axis. pitch_um: of the
    pixels. band_limit_per_um: limit of all images' spectra, below the fine grid's Nyquist
    frequency. row_frequency: (half rows, 1) cycles/um, from 0 up to the band limit;
    column_frequency: (1, fine columns), in FFT order.

    Spectra are half planes: row frequencies from 0 up to the band limit, all column
    frequencies in FFT order; real images have no more. With a whole ratio sampling simply
    folds the spectrum, so neither a Nyquist bin nor a non-integer ratio ever arises.
    """

    pixels: tuple[int, int]
    margin: tuple[int, int]
    frame: tuple[int, int]
    oversampling: int
    pitch_um: float
    band_limit_per_um: float
    row_frequency: Floats = field(init=False, repr=False, compare=False)
    column_frequency: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0 < self.band_limit_per_um <= self.oversampling / (2 * self.pitch_um):
            raise ValueError(
                f"{self.oversampling} samples a pixel of {self.pitch_um:g} um cannot hold {self.band_limit_per_um:g} cycles/um"
            )
        if any(
            m + f > p for m, f, p in zip(self.margin, self.frame, self.pixels, strict=True)
        ):
            raise ValueError(
                f"a frame of {self.frame} pixels at {self.margin} does not fit a torus of {self.pixels}"
            )
        count = min(
            self.fine[0] // 2,
            int(self.band_limit_per_um * self.fine[0] * self.spacing_um) + 1,
        )
        rows, columns = (
            scipy.fft.rfftfreq(self.fine[0], self.spacing_um),
            scipy.fft.fftfreq(self.fine[1], self.spacing_um),
        )
        object.__setattr__(self, "row_frequency", np.asarray(rows[:count, None]))
        object.__setattr__(self, "column_frequency", np.asarray(columns[None, :]))

    @classmethod
    def around(
        cls,
        frame: tuple[int, int],
        guard_px: tuple[int, int],
        pitch_um: float,
        band_limit_per_um: float,
    ) -> "Torus":
        """Return a torus with at least guard_px pixels of guard band below and beside the frame, of sides good
        for the FFT.
        """
        oversampling = math.ceil(2 * pitch_um * band_limit_per_um * (1 + 1e-9))
        rows, columns = (
            scipy.fft.next_fast_len(side + guard, real=True)
            for side, guard in zip(frame, guard_px, strict=True)
        )
        margin = ((rows - frame[0]) // 2, (columns - frame[1]) // 2)
        return cls(
            (rows, columns), margin, frame, oversampling, pitch_um, band_limit_per_um
        )

    @property
    def fine(self) -> tuple[int, int]:
        """(rows, columns) of the fine grid."""
        return self.pixels[0] * self.oversampling, self.pixels[1] * self.oversampling

    @property
    def spacing_um(self) -> float:
        """Spacing of the fine grid."""
        return self.pitch_um / self.oversampling

    def half_spectrum(self, image: AnyFloats) -> AnyComplexes:
        """Return the half plane of the DFT of a fine image, in its precision."""
        by_row = scipy.fft.rfft(image, axis=0)[: self.row_frequency.size]
        return np.asarray(scipy.fft.fft(by_row, axis=1, overwrite_x=True))

    def half_spectrum_of_window(
        self, window: AnyFloats, finer: float = 1.0
    ) -> AnyComplexes:
        """Return the half plane of the DFT of a small image with zeros around, whose [0, 0] is the torus's.

        window: (m, m), sampled `finer` times as finely as the torus, whose sides are whole
        numbers of its samples; content beyond the torus's band is dropped. The result has
        the image's precision. Raises ValueError for a window larger than the torus.
        """
        rows, columns = (round(side * finer) for side in self.fine)
        if max(window.shape) > min(rows, columns):
            raise ValueError(
                f"a window of {window.shape} samples does not fit a torus of {(rows, columns)}"
            )
        by_row = scipy.fft.rfft(window, n=rows, axis=0)[: self.row_frequency.size]
        return self._columns(np.asarray(scipy.fft.fft(by_row, n=columns, axis=1)))

    def cut(self, spectrum: Complexes64, oversampling: int) -> Complexes64:
        """Return the part in this torus's band of a half plane at another, finer oversampling."""
        return self._columns(spectrum[: self.row_frequency.size]) * np.float32(
            (self.oversampling / oversampling) ** 2
        )

    def _columns(self, spectrum: AnyComplexes) -> AnyComplexes:
        """Return the columns at this torus's column frequencies of a half plane with more."""
        if spectrum.shape[1] == self.fine[1]:
            return spectrum
        positive = (self.fine[1] + 1) // 2
        return np.concatenate(
            [spectrum[:, :positive], spectrum[:, positive - self.fine[1] :]], axis=1
        )

    def shift(self, distance_um: float) -> tuple[Complexes, Complexes]:
        """Return factors along rows (m, 1) and columns (1, n) of the half plane that move an image up and left."""
        turn = 2j * np.pi * distance_um
        return np.exp(turn * self.row_frequency), np.exp(turn * self.column_frequency)

    def sample(
        self, spectrum: AnyComplexes, transfer: AnyComplexes | Floats | None = None
    ) -> Floats:
        """Return the frame's pixels, (rows, columns), of an image's half spectrum, times a transfer function if
        any.

        Sampling a periodic band-limited image folds its DFT, thesis (2.61). The product is
        computed for as many rows at a time as fold onto the torus once: as a whole it is as
        large as the spectrum.
        """
        folded = np.zeros(
            self.pixels,
            np.result_type(spectrum, spectrum if transfer is None else transfer),
        )
        for rows in self._onto_one_another(spectrum):
            block = self.folded_columns(
                spectrum[rows] if transfer is None else spectrum[rows] * transfer[rows]
            )
            folded[: len(block)] += block
            if rows.start == 0:
                folded[0] -= 0.5 * block[0]  # frequency 0 has no partner
        return self.unfolded(folded)

    def sample_slopes(
        self, spectrum: AnyComplexes, transfer: AnyComplexes
    ) -> tuple[Floats, Floats]:
        """Return the derivatives of `sample` along rows and along columns, per pixel."""
        down, right = (
            (2j * np.pi * self.pitch_um * f).astype(spectrum.dtype)
            for f in (self.row_frequency, self.column_frequency)
        )
        by_row = np.zeros(self.pixels, spectrum.dtype)
        folded = np.zeros((self.pixels[0], self.fine[1]), spectrum.dtype)
        for rows in self._onto_one_another(spectrum):
            block = spectrum[rows] * transfer[rows]
            by_row[: len(block)] += self.folded_columns(block) * down[rows]
            folded[: len(block)] += block
            if rows.start == 0:
                folded[0] -= 0.5 * block[0]
        return self.unfolded(by_row), self.unfolded(self.folded_columns(folded * right))

    def _onto_one_another(self, spectrum: AnyComplexes) -> Iterator[slice]:
        """Yield slices of a half plane's rows that sampling folds onto the same rows."""
        return (
            slice(first, first + self.pixels[0])
            for first in range(0, len(spectrum), self.pixels[0])
        )

    def folded_columns(self, spectrum: AnyComplexes) -> AnyComplexes:
        """Return half planes with columns folded by sampling: (any, fine columns) -> (any, columns).

        The operation commutes with `folded_rows`.
        """
        return np.asarray(
            spectrum.reshape(len(spectrum), self.oversampling, self.pixels[1]).sum(axis=1)
        )

    def folded_rows(self, spectrum: AnyComplexes) -> AnyComplexes:
        """Return half planes with rows folded by sampling: (half rows, any) -> (rows, any).

        Half a plane suffices: the other half adds the complex conjugate, in `unfolded`.
        """
        folded = np.zeros((self.pixels[0], spectrum.shape[1]), spectrum.dtype)
        for first in range(0, len(spectrum), self.pixels[0]):
            block = spectrum[first : first + self.pixels[0]]
            folded[: len(block)] += block
        folded[0] -= 0.5 * spectrum[0]  # frequency 0 has no partner
        return folded

    def unfolded(self, folded: AnyComplexes) -> Floats:
        """Return the frame's pixels of a half plane folded both ways: twice the real part of its transform."""
        image = scipy.fft.ifft2(folded).real
        seen = image[
            tuple(slice(m, m + f) for m, f in zip(self.margin, self.frame, strict=True))
        ]
        return seen * (2.0 / self.oversampling**2)
