"""The transfer function of lens and pixel on a torus, and its derivatives (thesis 2.13, 2.45 corrected, Appendix H)."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from labkit.imaging.grid import Torus
from labkit.optics.psf import Pupil, diffraction_mtf
from labkit.types import Complexes, Floats


@dataclass(frozen=True)
class Blur:
    """Lens and pixel.

    pupil: its PSF's spacing is the torus's, or a whole fraction of it. active_um: width of the pixel's active square,
    whatever the sampling period. pixel: half plane of that square's transfer function.

    Diffraction's halo reaches far beyond any window. Averaged over its fringes it does not depend on the wavefront, so the
    transfer function is the closed form for a perfect lens plus the transform of PSF(wavefront) - PSF(none), which is small
    and compact. (A PSF simply cut at 160 um biases an f/2.8 fit by 0.02 waves.)
    """

    torus: Torus
    pupil: Pupil
    active_um: float
    pixel: Floats = field(init=False, repr=False, compare=False)
    _finer: int = field(init=False, repr=False, compare=False)
    _centred_pixel: Complexes = field(init=False, repr=False, compare=False)
    _perfect: Floats = field(init=False, repr=False, compare=False)
    _perfect_psf: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        torus, pupil = self.torus, self.pupil
        ratio = torus.spacing_um / pupil.spacing_um
        if abs(ratio - round(ratio)) > 1e-9:
            raise ValueError(
                f"the torus's spacing, {torus.spacing_um:g} um, is no multiple of the PSF's, {pupil.spacing_um:g} um"
            )
        pixel = np.sinc(torus.row_frequency * self.active_um) * np.sinc(torus.column_frequency * self.active_um)
        to_cutoff = pupil.wavelength_um * pupil.f_number
        perfect = diffraction_mtf(np.hypot(torus.row_frequency, torus.column_frequency) * to_cutoff) * pixel
        for name, value in (
            ("pixel", pixel),
            ("_finer", round(ratio)),
            ("_centred_pixel", pixel * torus.shift(pupil.size // 2 * pupil.spacing_um)),
            ("_perfect", perfect),
            ("_perfect_psf", pupil.psf(np.zeros(len(pupil.noll)))),
        ):
            object.__setattr__(self, name, value)

    def transfer(self, waves: Floats) -> Complexes:
        """Half plane of the transfer function, 1 at zero frequency. waves: (modes,) waves RMS at the reference."""
        return self._perfect + self.departure(self.pupil.psf(waves) - self._perfect_psf)

    def departure(self, psf: Floats) -> Complexes:
        """Half plane of the transfer function's departure for one of the PSF, (size, size) on the pupil's window."""
        departure = self.torus.half_spectrum_of_window(psf, self._finer)
        departure *= self._centred_pixel
        return departure

    def transfer_jacobian(self, waves: Floats, only: slice = slice(None)) -> Iterator[Complexes]:
        """Half planes of the transfer function's derivatives by each mode, or only some, one at a time to spare memory."""
        for slope in self.pupil.psf_jacobian(waves, only)[1]:
            yield self.departure(slope)

    def spread(self, transfer: Complexes) -> tuple[Complexes, Complexes]:
        """Transforms of t h(t), row and column component (um), of a transfer function's own kernel h.

        By central differences: exact to (2 pi t / L)^2 / 6 for light a distance t from its image on a torus of side L.
        """
        (rows, columns), spacing = self.torus.fine, self.torus.spacing_um
        before = np.conj(np.roll(transfer[1:2, ::-1], 1, axis=1))  # the row at frequency -1
        tall = np.concatenate([before, transfer, np.zeros_like(before)])
        by_row = (tall[2:] - tall[:-2]) * (1j * rows * spacing / (4 * np.pi))
        by_column = (np.roll(transfer, -1, 1) - np.roll(transfer, 1, 1)) * (1j * columns * spacing / (4 * np.pi))
        return by_row, by_column
