"""The transfer function of lens and pixel on a torus, and its derivatives (thesis 2.13, 2.45 corrected, Appendix H)."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.imaging.grid import Torus
from labkit.imaging.halo import perfect_lens
from labkit.imaging.parts import Part
from labkit.optics.psf import Pupil
from labkit.optics.spectrum import Spectrum
from labkit.types import AnyComplexes, Complexes, Complexes64, Floats, Floats32

CONE_STEP = 2e-3  # of ln N in its differences
# of a spectrum's variance in its differences: a share of itself, and far above what sampling pupils of other sizes errs by
WIDTH_STEP, LEAST_STEP = 0.2, 3e-4


@dataclass(frozen=True)
class Blur:
    """Lens, light, pixel, and what the camera adds.

    pupil: the torus's sides are whole numbers of its PSF's samples; its wavelength is the one that the spectrum's nodes are
    relative to. active_um: width of the pixel's active square, whatever the sampling period. parts, given: of the camera,
    to be estimated and known. beyond: half plane of the transfer function of all that lies behind the lens.

    Diffraction's halo reaches far beyond any window. Averaged over its fringes it does not depend on the wavefront, so the
    transfer function is the closed form for a perfect lens plus the transform of PSF(wavefront) - PSF(none), which is small
    and compact. (A PSF simply cut at 160 um biases an f/2.8 fit by 0.02 waves.)
    """

    torus: Torus
    pupil: Pupil
    active_um: float
    spectrum: Spectrum = field(default_factory=Spectrum)
    parts: tuple[Part, ...] = ()
    given: tuple[Part, ...] = ()
    beyond: Floats = field(init=False, repr=False, compare=False)
    _finer: float = field(init=False, repr=False, compare=False)
    _centred: Complexes = field(init=False, repr=False, compare=False)
    _lights: tuple[tuple[float, Pupil], ...] = field(init=False, repr=False, compare=False)
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
        beyond = np.sinc(torus.row_frequency * self.active_um) * np.sinc(torus.column_frequency * self.active_um)
        for part in (*self.given, *self.parts):
            beyond *= part.transfer(*self._per_pixel)
        shares = zip(self.spectrum.weights, self.spectrum.nodes, strict=True)
        lights = tuple((share, self._of(node)) for share, node in shares)
        perfect = sum(share * perfect_lens(torus, light.wavelength_um * light.f_number) for share, light in lights)
        for name, value in (
            ("beyond", beyond),
            ("_finer", finer),
            ("_centred", beyond * torus.shift(pupil.size // 2 * pupil.spacing_um)),
            ("_lights", lights),
            ("_perfect", perfect * beyond),
            ("_perfect_psf", sum(share * light.psf(np.zeros(len(pupil.noll))) for share, light in lights)),
        ):
            object.__setattr__(self, name, value)

    @property
    def _per_pixel(self) -> tuple[Floats, Floats]:
        """Frequencies of the half plane along rows and columns, cycles a pixel."""
        return self.torus.row_frequency * self.torus.pitch_um, self.torus.column_frequency * self.torus.pitch_um

    def _of(self, node: float) -> Pupil:
        """The pupil in another light."""
        return self.pupil if node == 1 else replace(self.pupil, wavelength_um=node * self.pupil.wavelength_um)

    @property
    def simple(self) -> "Blur":
        """In light of the nominal wavelength alone: quicker, and near enough for the slopes that a climb goes by."""
        return self if len(self._lights) == 1 else replace(self, spectrum=Spectrum())

    def psf(self, waves: Floats) -> Floats:
        """(size, size) the lens's PSF as `Pupil.psf` gives it, in all light. waves: (modes,) waves RMS at the reference."""
        return np.asarray(sum(share * light.psf(waves) for share, light in self._lights))

    def psf_slopes(self, waves: Floats, only: slice = slice(None)) -> Iterator[Floats32]:
        """Its derivatives by each mode, or only some, as `Pupil.psf_slopes` gives them."""
        if len(self._lights) == 1:
            yield from self.pupil.psf_slopes(waves, only)
            return
        shares = [np.float32(share) for share, _ in self._lights]
        for of_mode in zip(*(light.psf_slopes(waves, only) for _, light in self._lights), strict=True):
            yield np.asarray(sum(share * slope for share, slope in zip(shares, of_mode, strict=True)))

    def transfer(self, waves: Floats, precision: type[np.floating] = np.float64) -> AnyComplexes:
        """Half plane of the transfer function, 1 at zero frequency. waves: (modes,) waves RMS at the reference."""
        departure = (self.psf(waves) - self._perfect_psf).astype(precision)
        transfer = self.torus.half_spectrum_of_window(departure, self._finer)
        np.multiply(transfer, self._centred, out=transfer, casting="same_kind")
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

    def by_width(self, waves: Floats) -> Complexes:
        """Half plane of its derivative by the spectrum's variance, by differences: right to a sixth, as pupils of other sizes
        are sampled differently, which is enough to climb by. Raises ValueError where the spectrum is given.
        """
        if self.spectrum.variance is None:
            raise ValueError("the spectrum is given: it has no width to be estimated")
        here = self.spectrum.variance
        step = max(WIDTH_STEP * abs(here), LEAST_STEP)
        up, down = (replace(self, spectrum=Spectrum.of_width(here + by)).transfer(waves) for by in (step, -step))
        return np.asarray((up - down) / (2 * step))

    def by_parts(self, waves: Floats) -> Iterator[Complexes]:
        """Half planes of its derivatives by the numbers of each part."""
        transfers = [part.transfer(*self._per_pixel) for part in self.parts]
        bare = np.asarray(replace(self, parts=()).transfer(waves) if self.parts else 0j)
        for k, part in enumerate(self.parts):
            others = math.prod((transfer for i, transfer in enumerate(transfers) if i != k), start=bare)
            for slope in part.slopes(*self._per_pixel):
                yield np.asarray(others * slope)

    def responses(self, psfs: Iterable[Floats32]) -> Iterator[AnyComplexes]:
        """Half planes that turn what `behind_pixel` gives into the spectra of what changes of the PSF change in the picture.

        psfs: (size, size) each, on the pupil's window, such as derivatives. One at a time, to spare memory.
        """
        for psf in psfs:
            yield self.torus.half_spectrum_of_window(psf, self._finer)

    def behind_pixel(self, spectrum: AnyComplexes) -> Complexes64:
        """Half plane of a drawing as pixels see it, in single precision: for `responses`, which are centred in their window."""
        return np.multiply(spectrum, self._centred, dtype=np.complex64, casting="same_kind")

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
