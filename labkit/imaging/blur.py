"""The transfer function of lens and pixel on a torus, and its derivatives (thesis 2.13, 2.45 corrected, Appendix H)."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TypeVar

import numpy as np

from labkit.imaging.far_light import far_light
from labkit.imaging.grid import Torus
from labkit.imaging.halo import perfect_lens, perfect_lens_slope
from labkit.imaging.parts import Part, rim_of
from labkit.imaging.window import fading
from labkit.optics.psf import Pupil
from labkit.optics.rim import Rim
from labkit.optics.spectrum import Spectrum
from labkit.types import AnyComplexes, AnyFloats, Complexes, Complexes64, Floats, Floats32

AnyArray = TypeVar("AnyArray", Floats, Complexes, Complexes64, AnyComplexes)
"""A half plane of any kind."""

RIM_STEP = 1e-5  # of a rim's number, in its differences: 1e-3 samples of a pupil


@dataclass(frozen=True)
class Blur:
    """Lens, light, pixel, and further blur of the camera.

    pupil: the torus's sides are whole numbers of its PSF's samples; the spectrum's nodes
    are relative to its wavelength. active_um: width of the pixel's active square, whatever
    the sampling period. spectrum: of the light, with its parts' included. parts, given:
    parts of the camera, estimated and known.

    Diffraction's halo reaches far beyond any window. Averaged over its fringes the halo
    does not depend on the wavefront, so the transfer function is the closed form for a
    perfect lens plus the transform of PSF(wavefront) - PSF(none), which is small and
    compact. (A PSF simply cut at 160 um biases an f/2.8 fit by 0.02 waves.) The difference
    fades out towards its window's borders: otherwise rings would enter and leave as
    f-number or wavelength change. The perfect lens of a pupil that is no disc is the disc
    with the same halo; what departs from its light beyond the window is added.
    """

    torus: Torus
    pupil: Pupil
    active_um: float
    spectrum: Spectrum = field(default_factory=Spectrum)
    parts: tuple[Part, ...] = ()
    given: tuple[Part, ...] = ()
    _finer: float = field(init=False, repr=False, compare=False)
    _fading: Floats = field(init=False, repr=False, compare=False)
    _pixel: tuple[Floats, Floats] = field(
        init=False, repr=False, compare=False
    )  # along rows (m, 1) and columns (1, n)
    _centred: tuple[Complexes, Complexes] = field(
        init=False, repr=False, compare=False
    )  # with the shift to the window
    _camera: Floats | None = field(
        init=False, repr=False, compare=False
    )  # half plane of its parts, if there are any
    _halo: Pupil = field(init=False, repr=False, compare=False)
    _perfect: Floats = field(init=False, repr=False, compare=False)
    _perfect_psf: Floats = field(init=False, repr=False, compare=False)
    _beyond: Floats = field(init=False, repr=False, compare=False)  # see `FarLight`

    def __post_init__(self) -> None:
        torus = self.torus
        pupil = self.pupil
        finer = torus.spacing_um / pupil.spacing_um
        if max(abs(side * finer - round(side * finer)) for side in torus.fine) > 1e-6:
            raise ValueError(
                f"the torus's sides, {torus.fine} samples of {torus.spacing_um:g} um, are no multiples of the PSF's spacing, "
                f"{pupil.spacing_um:g} um"
            )
        pupil.check_sampling(min(self.spectrum.nodes))
        pixel = (
            np.sinc(torus.row_frequency * self.active_um),
            np.sinc(torus.column_frequency * self.active_um),
        )
        shift = torus.shift(pupil.size // 2 * pupil.spacing_um)
        parts = [
            part.transfer(*self._per_pixel)
            for part in (*self.given, *self.parts)
            if not part.idle
        ]
        halo = pupil.halo
        airy_um = halo.wavelength_um * halo.f_number
        beyond = np.zeros((1, 1)) if pupil.rim.is_round else far_light(torus, pupil).beyond
        perfect = sum(
            share * (perfect_lens(torus, node * airy_um) + node * beyond)
            for share, node in self.spectrum.shares
        )
        for name, value in (
            ("_finer", finer),
            ("_fading", fading(pupil.size)),
            ("_pixel", pixel),
            (
                "_centred",
                tuple(along * turn for along, turn in zip(pixel, shift, strict=True)),
            ),
            ("_camera", math.prod(parts) if parts else None),
            ("_perfect", perfect),
            ("_beyond", beyond),
            ("_halo", halo),
            ("_perfect_psf", self._psf(halo, np.zeros(len(halo.noll)))),
        ):
            object.__setattr__(self, name, value)
        _times(self._perfect, *self._pixel)

    @property
    def _per_pixel(self) -> tuple[Floats, Floats]:
        """Frequencies of the half plane along rows and columns, cycles a pixel."""
        return (
            self.torus.row_frequency * self.torus.pitch_um,
            self.torus.column_frequency * self.torus.pitch_um,
        )

    def _through_camera(self, transfer: AnyArray) -> AnyArray:
        """Multiply a half plane in place by the transfer function of the camera's parts, and return it."""
        return transfer if self._camera is None else _times(transfer, self._camera)

    @property
    def beyond(self) -> Floats:
        """Half plane of the transfer function of everything behind the lens."""
        return self._through_camera(_times(np.ones(self._perfect.shape), *self._pixel))

    @property
    def simple(self) -> "Blur":
        """The blur at the nominal wavelength alone: quicker, and near enough for the slopes of a climb."""
        return self if len(self.spectrum.nodes) == 1 else replace(self, spectrum=Spectrum())

    def psf(self, waves: Floats) -> Floats:
        """Return the lens's (size, size) PSF as `Pupil.psf`, over all wavelengths.

        waves: (modes,) waves RMS at the reference wavelength
        """
        return self._psf(self.pupil, waves)

    def _psf(self, pupil: Pupil, waves: Floats) -> Floats:
        """Return the PSF of any pupil over all wavelengths."""
        psf = np.zeros((pupil.size, pupil.size))
        waves = pupil.checked(waves)
        for share, node in self.spectrum.shares:
            psf += share * pupil.stretched(waves / node, node)
        return psf

    def psf_slopes(self, waves: Floats, only: slice = slice(None)) -> Iterator[Floats32]:
        """Yield the PSF's derivatives by all or some modes, as `Pupil.psf_slopes`."""
        if len(self.spectrum.nodes) == 1:
            yield from self._in_light(self.spectrum.nodes[0]).psf_slopes(waves, only)
            return
        shares = [np.float32(share) for share in self.spectrum.weights]
        every = zip(
            *(self._in_light(node).psf_slopes(waves, only) for node in self.spectrum.nodes),
            strict=True,
        )
        for of_mode in every:
            yield np.asarray(
                sum(share * slope for share, slope in zip(shares, of_mode, strict=True))
            )

    def _in_light(self, node: float) -> Pupil:
        """Return the pupil at one of the spectrum's wavelengths."""
        return (
            self.pupil
            if node == 1
            else replace(self.pupil, wavelength_um=node * self.pupil.wavelength_um)
        )

    def transfer(
        self, waves: Floats, precision: type[np.floating] = np.float64
    ) -> AnyComplexes:
        """Return the half plane of the transfer function, 1 at zero frequency.

        waves: (modes,) waves RMS at the reference wavelength
        """
        return self._through_camera(self._bare(waves, precision))

    def _bare(self, waves: Floats, precision: type[np.floating]) -> AnyComplexes:
        """Return the half plane of the transfer function without the camera's parts."""
        return self._of(
            (self.psf(waves) - self._perfect_psf).astype(precision), self._perfect
        )

    def _of(self, departure: Floats | Floats32, perfect: Floats) -> AnyComplexes:
        """Return the half plane of a departure (size, size) of the PSF through the pixel, plus a perfect
        lens's.

        perfect: half plane that includes the pixel
        """
        transfer = _times(self._spectrum_of_window(departure), *self._centred)
        transfer += perfect
        return transfer

    def _spectrum_of_window(self, departure: Floats | Floats32) -> AnyComplexes:
        """Return the half plane of the DFT of a departure (size, size), its borders faded out."""
        faded = departure * self._fading.astype(departure.dtype)
        faded *= self._fading.astype(departure.dtype)[:, None]
        return self.torus.half_spectrum_of_window(faded, self._finer)

    def by_f_number(self, waves: Floats) -> Complexes64:
        """Return the half plane of the transfer function's derivative by ln N, in single precision.

        N is the working f-number; the modes stay constant in waves.
        """
        departure = np.zeros((self.pupil.size, self.pupil.size))
        perfect = np.zeros(self._perfect.shape)
        halo = self._halo
        flat = np.zeros(len(halo.noll))
        airy_um = halo.wavelength_um * halo.f_number
        for share, node in self.spectrum.shares:
            for sign, pupil, at in ((1, self.pupil, waves), (-1, halo, flat)):
                departure += sign * share * pupil.stretched_slope(at / node, node)
            perfect += share * perfect_lens_slope(self.torus, node * airy_um)
            perfect += share * node * self._beyond
        return self._through_camera(
            self._of(departure.astype(np.float32), _times(perfect, *self._pixel))
        )

    def by_light(self, waves: Floats, slopes: Mapping[float, float]) -> Complexes64:
        """Return the half plane of the transfer function's derivative by a number of the light.

        slopes: of each node's weight, by node; their sum is 0
        """
        departure = np.zeros((self.pupil.size, self.pupil.size))
        perfect = np.zeros(self._perfect.shape)
        halo = self._halo
        flat = np.zeros(len(halo.noll))
        airy_um = halo.wavelength_um * halo.f_number
        for node, slope in slopes.items():
            departure += slope * (
                self.pupil.stretched(waves / node, node) - halo.stretched(flat, node)
            )
            perfect += slope * perfect_lens(self.torus, node * airy_um)
            perfect += slope * node * self._beyond
        return self._through_camera(
            self._of(departure.astype(np.float32), _times(perfect, *self._pixel))
        )

    def _by_rims(self, waves: Floats, first: int) -> Iterator[Complexes64]:
        """Yield half planes of the derivatives by the rim's numbers, of the parts from `first` on."""
        nearby = [
            rims
            for k, part in enumerate(self.parts[first:], first)
            if part.of_rim
            for rims in self._rims(k)
        ]
        if not nearby:
            return
        shares = [np.float32(share) for share in self.spectrum.weights]
        every = zip(
            *(
                self._in_light(node).psf_rim_slopes(waves, nearby)
                for node in self.spectrum.nodes
            ),
            strict=True,
        )
        mean = float(np.dot(self.spectrum.weights, self.spectrum.nodes))
        far = far_light(self.torus, self.pupil).slopes(nearby)
        for slopes, beyond in zip(every, far, strict=True):
            slope = sum(share * one for share, one in zip(shares, slopes, strict=True))
            spectrum = _times(self._spectrum_of_window(np.asarray(slope)), *self._centred)
            spectrum += _times(mean * beyond, *self._pixel)
            yield self._through_camera(spectrum)

    def _rims(self, k: int) -> Iterator[tuple[Rim, Rim, float]]:
        """Yield rims above and below the present rim along each number of a part, within its bounds, and their
        distance.
        """
        part = self.parts[k]
        values = np.array(self.parts[k].values)
        rest = (*self.given, *self.parts[:k]), self.parts[k + 1 :]
        for step in RIM_STEP * np.eye(len(values)):
            above = part.at(values + step)
            below = part.at(values - step)
            apart = np.linalg.norm(np.subtract(above.values, below.values))
            yield (
                rim_of((*rest[0], above, *rest[1])),
                rim_of((*rest[0], below, *rest[1])),
                float(apart),
            )

    def by_parts(self, waves: Floats, first: int = 0) -> Iterator[Complexes64]:
        """Yield half planes of the derivatives by the numbers of each part from `first` on, in single
        precision.
        """
        if not self.parts[first:]:
            return
        places = [frequency.astype(np.float32) for frequency in self._per_pixel]
        active = {
            k: part.transfer(*places) for k, part in enumerate(self.parts) if not part.idle
        }
        given = [part.transfer(*places) for part in self.given if not part.idle]
        bare = _times(self._bare(waves, np.float32), *given)
        by_rims = self._by_rims(waves, first)
        for k, part in enumerate(self.parts[first:], first):
            for light in part.light_slopes():
                yield self.by_light(waves, light)
            if part.of_rim:
                yield from islice(by_rims, len(part.labels))
            slopes = part.slopes(*places)
            others = (
                _times(bare.copy(), *(transfer for i, transfer in active.items() if i != k))
                if slopes
                else bare
            )
            for slope in slopes:
                yield np.asarray(others * slope.astype(np.float32, copy=False))

    def responses(self, psfs: Iterable[Floats32]) -> Iterator[AnyComplexes]:
        """Yield half planes that turn the result of `behind_pixel` into the spectra of an image's changes.

        psfs: (size, size) changes of the PSF on the pupil's window, such as derivatives;
        one at a time, to save memory
        """
        for psf in psfs:
            yield self._spectrum_of_window(psf)

    def behind_pixel(self, spectrum: AnyComplexes) -> Complexes64:
        """Return the half plane of a drawing through the pixel, in single precision, for `responses`.

        The result is centred in the window of `responses`.
        """
        return self._through_camera(_times(spectrum.astype(np.complex64), *self._centred))

    def spread(self, transfer: AnyComplexes) -> tuple[AnyComplexes, AnyComplexes]:
        """Return the transforms of t h(t), row and column component (pixels), of a transfer function's kernel
        h.

        Central differences are exact to (2 pi t / L)^2 / 6 for light a distance t from its
        image on a torus of side L.
        """
        by_row = np.empty_like(transfer)
        by_column = np.empty_like(transfer)
        np.subtract(transfer[2:], transfer[:-2], out=by_row[1:-1])
        by_row[0] = transfer[1] - np.conj(
            np.roll(transfer[1, ::-1], 1)
        )  # the row at frequency -1
        by_row[-1] = -transfer[-2]
        np.subtract(transfer[:, 2:], transfer[:, :-2], out=by_column[:, 1:-1])
        by_column[:, 0] = transfer[:, 1] - transfer[:, -1]
        by_column[:, -1] = transfer[:, 0] - transfer[:, -2]
        for kernel, side in zip((by_row, by_column), self.torus.pixels, strict=True):
            kernel *= 1j * side / (4 * np.pi)
        return by_row, by_column


def _times(transfer: AnyArray, *factors: AnyFloats | AnyComplexes) -> AnyArray:
    """Multiply a half plane in place by other half planes or single lines, and return the product.

    A half plane of a large target takes 70 MB.
    """
    for factor in factors:
        precision = transfer.dtype if np.iscomplexobj(factor) else transfer.real.dtype
        np.multiply(transfer, factor.astype(precision, copy=False), out=transfer)
    return transfer
