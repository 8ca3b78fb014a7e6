"""The transfer function of lens and pixel on a torus, and its derivatives (thesis 2.13, 2.45 corrected, Appendix H)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.imaging.grid import Torus
from labkit.imaging.halo import perfect_transfer
from labkit.optics.psf import Pupil
from labkit.types import AnyComplexes, Complexes, Complexes64, Floats, Floats32

CONE_STEP = 2e-3  # of ln N in its differences


@dataclass(frozen=True)
class Blur:
    """Lens and pixel.

    pupil: the torus's sides are whole numbers of its PSF's samples. active_um: width of the pixel's active square,
    whatever the sampling period. pixel: half plane of that square's transfer function.

    Diffraction's halo reaches far beyond any window. Averaged over its fringes it does not depend on the wavefront, so the
    transfer function is the closed form for a perfect lens plus the transform of PSF(wavefront) - PSF(none), which is small
    and compact. (A PSF simply cut at 160 um biases an f/2.8 fit by 0.02 waves.)
    """

    torus: Torus
    pupil: Pupil
    active_um: float
    pixel: Floats = field(init=False, repr=False, compare=False)
    _finer: float = field(init=False, repr=False, compare=False)
    _centred_pixel: Complexes = field(init=False, repr=False, compare=False)
    _perfect: Floats = field(init=False, repr=False, compare=False)
    _perfect_psf: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        torus, pupil = self.torus, self.pupil
        finer = torus.spacing_um / pupil.spacing_um
        if max(abs(side * finer - round(side * finer)) for side in torus.fine) > 1e-6:
            raise ValueError(
                f"the torus's sides, {torus.fine} samples of {torus.spacing_um:g} um, are no multiples of the PSF's spacing, "
                f"{pupil.spacing_um:g} um"
            )
        pixel = np.sinc(torus.row_frequency * self.active_um) * np.sinc(torus.column_frequency * self.active_um)
        for name, value in (
            ("pixel", pixel),
            ("_finer", finer),
            ("_centred_pixel", pixel * torus.shift(pupil.size // 2 * pupil.spacing_um)),
            ("_perfect", perfect_transfer(torus, pupil.wavelength_um * pupil.f_number, self.active_um)),
            ("_perfect_psf", pupil.psf(np.zeros(len(pupil.noll)))),
        ):
            object.__setattr__(self, name, value)

    def transfer(self, waves: Floats, precision: type[np.floating] = np.float64) -> AnyComplexes:
        """Half plane of the transfer function, 1 at zero frequency. waves: (modes,) waves RMS at the reference."""
        departure = (self.pupil.psf(waves) - self._perfect_psf).astype(precision)
        transfer = self.torus.half_spectrum_of_window(departure, self._finer)
        np.multiply(transfer, self._centred_pixel, out=transfer, casting="same_kind")
        transfer += self._perfect
        return transfer

    def by_cone(self, waves: Floats) -> Complexes:
        """Half plane of the transfer function's derivative by ln N of the cone, modes in waves held.

        By differences towards larger N, where the PSF is sampled well enough: right to about CONE_STEP^2.
        """
        here = self.pupil.f_number
        cones = [replace(self.pupil, f_number=here * np.exp(k * CONE_STEP)) for k in (1, 2)]
        a, b, c = (blur.transfer(waves) for blur in (self, *(replace(self, pupil=pupil) for pupil in cones)))
        return np.asarray((-3 * a + 4 * b - c) / (2 * CONE_STEP))

    def responses(self, psfs: Iterable[Floats32]) -> Iterator[AnyComplexes]:
        """Half planes that turn what `behind_pixel` gives into the spectra of what changes of the PSF change in the picture.

        psfs: (size, size) each, on the pupil's window, such as derivatives. One at a time, to spare memory.
        """
        for psf in psfs:
            yield self.torus.half_spectrum_of_window(psf, self._finer)

    def behind_pixel(self, spectrum: AnyComplexes) -> Complexes64:
        """Half plane of a drawing as pixels see it, in single precision: for `responses`, which are centred in their window."""
        return np.multiply(spectrum, self._centred_pixel, dtype=np.complex64, casting="same_kind")

    def spread(self, transfer: AnyComplexes) -> tuple[AnyComplexes, AnyComplexes]:
        """Transforms of t h(t), row and column component (pixels), of a transfer function's own kernel h.

        By central differences: exact to (2 pi t / L)^2 / 6 for light a distance t from its image on a torus of side L.
        """
        by_row, by_column = np.empty_like(transfer), np.empty_like(transfer)
        np.subtract(transfer[2:], transfer[:-2], out=by_row[1:-1])
        by_row[0] = transfer[1] - np.conj(np.roll(transfer[1, ::-1], 1))  # the row at frequency -1
        by_row[-1] = -transfer[-2]
        np.subtract(transfer[:, 2:], transfer[:, :-2], out=by_column[:, 1:-1])
        by_column[:, 0] = transfer[:, 1] - transfer[:, -1]
        by_column[:, -1] = transfer[:, 0] - transfer[:, -2]
        for kernel, side in zip((by_row, by_column), self.torus.pixels, strict=True):
            kernel *= 1j * side / (4 * np.pi)
        return by_row, by_column
