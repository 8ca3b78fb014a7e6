"""The point-spread function of a pupil with a Zernike wavefront, and its derivatives (thesis, Appendix H).

Orientation: pupil coordinates point as the sensor's do, x to the right (columns), y down
(rows); theta = atan2(y, x). A path difference that grows to the right moves the light to
the right: the field is the forward transform of the pupil function, as in the diffraction
integral. The thesis writes the inverse transform: its pupil is rotated by 180 degrees,
which changes the sign of every odd mode.

The aperture is drawn on a grid with a smooth edge, so that its transform hardly depends on the samples' place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
import scipy.fft
from numpy.polynomial import Polynomial

from labkit.arrays import positive, real_array
from labkit.optics.rim import ROUND, ROUND_RIM, Rim, along
from labkit.optics.zernike import modes_at
from labkit.types import Complexes, Complexes64, Floats, Floats32

KERNEL_REACH = 3  # of a disc's edge's kernel, in samples
OUTLINE_REACH = 6  # of any outline's
DEGREE = 5  # of the spline that smooths it
FLATTER = (0.25, 13 / 240, 139 / 12096)
"""Powers of the second difference that undo the spline's blur up to the eighth order of the frequency."""
ARC_SPACING = 0.5  # samples between the ends of an outline's arcs


def smooth_disc(offsets: Floats, radius: float) -> Floats:
    """Return a disc smoothed by the kernel of central Lagrange interpolation over six samples.

    A transform of samples repeats with their frequency. The error of a field by its copies
    and by the smooth edge grows with the sixth power of the distance from the centre; for a
    disc shaded by area, with the first and second power.

    Parameters
    ----------
    offsets : (n,), coordinates of the samples along either axis from the disc's centre,
        samples
    radius : samples, 2 or more

    Returns
    -------
    (n, n), about 0 to 1

    Raises
    ------
    ValueError
        for offsets of another shape or not finite, and for a radius that is not positive

    Notes
    -----
    G. Strang and G. Fix, in Constructive Aspects of Functional Analysis (CIME, 1971).
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    axis, places = np.unique(np.abs(offsets), return_inverse=True)
    along = axis[:, None]
    across = axis[None, :]
    distance = np.hypot(along, across)
    octant = (distance < radius).astype(float)
    edge = (np.abs(distance - radius) < KERNEL_REACH * np.sqrt(2)) & (
        along >= across
    )  # where chords end steeply
    at, weight = (
        np.concatenate(each)
        for each in zip(*map(_gauss, range(-KERNEL_REACH, KERNEL_REACH)), strict=True)
    )
    rows, columns = np.nonzero(edge)
    half_chord = np.sqrt(np.maximum(radius**2 - (axis[columns, None] - at) ** 2, 0.0))
    inside = _primitive(half_chord - axis[rows, None]) - _primitive(
        -half_chord - axis[rows, None]
    )
    octant[rows, columns] = octant[columns, rows] = inside @ weight
    return np.asarray(octant[np.ix_(places, places)])


@lru_cache
def _kernel(piece: int) -> Polynomial:
    """Return the kernel between two whole numbers: 1 at 0, and 0 at the other samples."""
    others = [
        node for node in range(piece - KERNEL_REACH + 1, piece + KERNEL_REACH + 1) if node
    ]
    product = Polynomial.fromroots(others)
    return product / product(0.0)


@lru_cache
def _integral(piece: int) -> Polynomial:
    """Return the kernel's integral from the piece's lower end."""
    return _kernel(piece).integ(lbnd=piece)


@lru_cache
def _gauss(piece: int) -> tuple[Floats, Floats]:
    """Return nodes and weights of an integral times the kernel, over one of its pieces."""
    at, weight = np.polynomial.legendre.leggauss(KERNEL_REACH + 2)
    at = piece + (1 + at) / 2
    return at, weight / 2 * _kernel(piece)(at)


def _primitive(t: Floats) -> Floats:
    """Return the kernel's integral from 0 to t, which is 1/2 beyond its reach."""
    s = np.minimum(np.abs(t), KERNEL_REACH)
    total = np.zeros_like(t)
    for piece in range(KERNEL_REACH):
        total += _integral(piece)(np.clip(s, piece, piece + 1))
    return np.copysign(total, t)


def smooth_outline(offsets: Floats, edges: Sequence[Floats]) -> Floats:
    """Return a region of any outline, smoothed by a kernel of splines.

    The kernel is the B-spline of degree 5 with corrected lowest frequencies: the error of a
    field grows with the sixth power of the distance from the centre, as in `smooth_disc`.
    By Green's theorem a sample is a sum over the edges.

    Parameters
    ----------
    offsets : (n,), coordinates of the samples along either axis, samples, 1 apart; they
        reach 6 samples beyond the region
    edges : closed chains of arcs as of `labkit.optics.rim.Rim.edges`, samples, an arc APART
        or less

    Returns
    -------
    (n, n), about 0 to 1, rows along y

    Notes
    -----
    M. Unser, IEEE Signal Processing Magazine 16, 22 (1999).
    """
    size = len(offsets)
    passed = np.zeros(size * size)  # what is clear between a sample and the next
    for node, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True):
        points = [along(edge, 0.5 + 0.5 * node) for edge in edges]
        x, y = np.concatenate([place for place, _ in points]).T - offsets[0]
        steps = 0.5 * weight * np.concatenate([slope for _, slope in points])
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        by_column = _spline(x - column, DEGREE + 1)
        by_row = _spline(y - row, DEGREE) * steps[:, 1]
        columns = column - KERNEL_REACH + np.arange(DEGREE + 2)[:, None]
        rows = row - KERNEL_REACH + 1 + np.arange(DEGREE + 1)[:, None]
        passed += np.bincount(
            (rows[:, None] * size + columns).ravel(),
            (by_row[:, None] * by_column).ravel(),
            size * size,
        )
    region = np.cumsum(passed.reshape(size, size)[:, ::-1], axis=1)[:, ::-1]
    flatten = _flatten(size)
    return np.asarray(flatten @ region @ flatten)


@lru_cache(maxsize=16)
def _flatten(size: int) -> Floats:
    """Return the matrix (size, size) that corrects the lowest frequencies of samples along an axis."""
    differ = 2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    flatten = np.eye(size)
    power = np.eye(size)
    for factor in FLATTER:
        power = power @ differ
        flatten += factor * power
    return flatten


def smooth_edges_field(size: int) -> Floats:
    """Return what the kernel of `smooth_outline` leaves of a field along either axis of its window (size,): 1 in the middle."""
    away = np.pi * (np.arange(size) / size - 0.5)
    flatter = np.polynomial.polynomial.polyval(4 * np.sin(away) ** 2, (1.0, *FLATTER))
    return np.asarray(np.sinc(away / np.pi) ** (DEGREE + 1) * flatter)


def _spline(t: Floats, degree: int) -> Floats:
    """Return (degree + 1, points) B-splines of whole knots at t past a knot, in the order of their ends."""
    values = np.ones((1, t.size))
    for d in range(1, degree + 1):
        wider = np.zeros((d + 1, t.size))
        for m in range(d + 1):
            if m:
                wider[m] += (t + d - m) / d * values[m - 1]
            if m < d:
                wider[m] += (m + 1 - t) / d * values[m]
        values = wider
    return values


Field = TypeVar("Field", Complexes, Complexes64)
"""A field of light, in either precision."""


@dataclass(frozen=True)
class Pupil:
    """A pupil sampled so that one FFT leads to the PSF on the requested grid.

    wavelength_um, reference_um: of the light, and of the unit of wavefronts. f_number:
    working f-number. spacing_um: of the PSF. size: samples along a side of the PSF's
    window. noll: the modes of the wavefront, over the circle with the full pupil's clear
    area, like the f-number. rim: of the clear area. amplitude: (n, n) aperture with a smooth edge, its
    centre in the middle. modes: (modes, n, n) Zernike polynomials there.

    Sampling the pupil folds light from beyond the window back into the window; `Blur`
    corrects this.
    """

    wavelength_um: float
    reference_um: float
    f_number: float
    spacing_um: float
    size: int
    noll: tuple[int, ...]
    rim: Rim = ROUND
    amplitude: Floats = field(init=False, repr=False, compare=False)
    modes: Floats = field(init=False, repr=False, compare=False)
    _offsets: Floats = field(init=False, repr=False, compare=False)
    _tilt: Complexes = field(
        init=False, repr=False, compare=False
    )  # brings the PSF's centre to the middle of its window

    def __post_init__(self) -> None:
        for name in ("wavelength_um", "reference_um"):
            positive(name, getattr(self, name), "um")
        positive("f_number", self.f_number, "unitless")
        self.check_sampling()
        half = (
            int(np.ceil(self.radius)) + KERNEL_REACH
            if self.rim.is_round
            else int(np.ceil(self.radius * self.rim.longest)) + OUTLINE_REACH
        )
        offsets = np.arange(-half, half + 1.0)
        y, x = offsets[:, None] / self.radius, offsets[None, :] / self.radius
        tilt = np.exp(2j * np.pi * (self.size // 2) / self.size * offsets)
        object.__setattr__(self, "_offsets", offsets)
        object.__setattr__(self, "_tilt", np.outer(tilt, tilt))
        object.__setattr__(self, "amplitude", self._amplitude(self.rim))
        object.__setattr__(self, "modes", modes_at(self.noll, x, y))

    def check_sampling(self, stretch: float = 1.0) -> None:
        """Raise ValueError if the grid is too coarse for the PSF, stretched by a factor as of `stretched`."""
        nyquist_um = stretch * self.wavelength_um * self.f_number / (2 * self.rim.reach)
        if not 0 < self.spacing_um <= nyquist_um * (1 + 1e-9):
            raise ValueError(
                f"spacing {self.spacing_um:g} um undersamples a PSF whose Nyquist spacing is {nyquist_um:g} um"
            )

    @property
    def radius(self) -> float:
        """Radius of the pupil, in samples."""
        return self.size * self.spacing_um / (2 * self.wavelength_um * self.f_number)

    def _amplitude(self, rim: Rim) -> Floats:
        """Return (n, n) the aperture with a rim, on this pupil's grid, with the light of the full pupil."""
        if rim.is_round:
            return smooth_disc(self._offsets, self.radius)
        vertices = int(np.ceil(2 * np.pi * self.radius / ARC_SPACING))
        edges = [self.radius * edge for edge in rim.edges(vertices)]
        return np.asarray(smooth_outline(self._offsets, edges) / np.sqrt(rim.area))

    def _to_image(self, pupil: Field) -> Field:
        """Transform onto the PSF's window, its centre in the middle; the caller normalises.

        The first pass has only as many columns as the pupil. Because the pupil begins at
        [0, 0], the phases of all fields turn alike; only products of a field with another's
        conjugate are used.
        """
        columns = scipy.fft.fft(pupil * self._tilt.astype(pupil.dtype), self.size, axis=0)
        return np.asarray(scipy.fft.fft(columns, self.size, axis=1))

    def checked(self, waves: Floats) -> Floats:
        """Return a wavefront's modes as numbers, or raise ValueError."""
        return real_array("waves", waves, (len(self.noll),), "waves RMS, one for each mode")

    def _pupil_function(self, waves: Floats) -> Complexes:
        return np.asarray(self.amplitude * self._turn(waves))

    def _turn(self, waves: Floats) -> Complexes:
        """Return (n, n) the wavefront's phase factor."""
        phase = (
            2
            * np.pi
            * self.reference_um
            / self.wavelength_um
            * np.tensordot(self.checked(waves), self.modes, 1)
        )
        return np.asarray(np.exp(1j * phase))

    @property
    def _light(self) -> float:
        """Sum of |field|^2 with all light counted: the pupil's area, by Parseval.

        The sum of the squared amplitudes is less by 1/(4 radius), because their edge is
        grey. With this sum as the norm every frequency but zero would be too large by as
        much. A little more, 1/(3 radius), put 0.003 waves into a defocus of 1.2.
        """
        return np.pi * self.radius**2 * self.size**2

    def psf(self, waves: Floats) -> Floats:
        """Return the (size, size) PSF: the share of all light on each sample, centre at [size // 2, size // 2].

        The PSF sums to a little under one, because the halo reaches beyond the window.
        waves: (modes,) waves RMS at the reference wavelength. Thesis (2.13), (H.1)-(H.3),
        corrected: lambda_ref / lambda.
        """
        return np.asarray(
            np.abs(self._to_image(self._pupil_function(waves))) ** 2 / self._light
        )

    def psf_jacobian(
        self, waves: Floats, only: slice = slice(None)
    ) -> tuple[Floats, Floats]:
        """Return the PSF, and (modes, size, size) its derivatives by all or some modes, per wave RMS. Thesis
        (H.7), (H.11).
        """
        pupil = self._pupil_function(waves)
        field = self._to_image(pupil)
        slopes = np.empty((len(self.modes[only]), self.size, self.size))
        for slope, product in zip(
            slopes, self._products(pupil, np.conj(field), self.modes[only]), strict=True
        ):
            slope[:] = product.imag
        return np.asarray(np.abs(field) ** 2 / self._light), slopes

    def psf_slopes(self, waves: Floats, only: slice = slice(None)) -> Iterator[Floats32]:
        """Yield the derivatives of `psf_jacobian`, (size, size) each, in single precision: within 1e-6 of the
        largest.
        """
        pupil = self._pupil_function(waves).astype(np.complex64)
        turned = np.conj(self._to_image(pupil)).astype(np.complex64, copy=False)
        for product in self._products(pupil, turned, self.modes[only]):
            yield product.imag

    def _products(self, pupil: Field, turned: Field, modes: Floats) -> Iterator[Field]:
        """Yield fields whose imaginary parts are the PSF's derivatives by some modes, in the input's precision.

        turned: the pupil's field, conjugate; it is scaled here
        """
        turned *= -4 * np.pi * self.reference_um / self.wavelength_um / self._light
        for mode in modes:
            product = self._to_image(pupil * mode.astype(pupil.real.dtype))
            product *= turned
            yield product

    def psf_rim_slopes(
        self, waves: Floats, nearby: Sequence[tuple[Rim, Rim, float]]
    ) -> Iterator[Floats32]:
        """Yield the PSF's derivatives by numbers of the rim, (size, size) each, in single precision.

        nearby: for each number two neighbouring rims, and their distance in this number
        """
        pupil = self.outlined
        turn = pupil._turn(waves).astype(np.complex64)
        field = pupil._to_image(pupil.amplitude.astype(np.float32) * turn)
        turned = np.conj(field) * np.float32(2 / self._light)
        for above, below, apart in nearby:
            change = (pupil._amplitude(above) - pupil._amplitude(below)) / apart
            product = pupil._to_image(change.astype(np.float32) * turn)
            product *= turned
            yield product.real

    @property
    def outlined(self) -> "Pupil":
        """The same pupil with its amplitude by `smooth_outline`, even for a disc."""
        return replace(self, rim=ROUND_RIM) if self.rim.is_round else self

    @property
    def halo(self) -> "Pupil":
        """The disc whose perfect image has the same halo, averaged over all directions: itself where this is a disc, else
        one without modes.
        """
        if self.rim.is_round:
            return self
        f_number = self.f_number * self.rim.halo
        return replace(self, f_number=f_number, rim=ROUND_RIM, noll=())

    def psf_at(
        self, waves: Floats, at_um: Floats, only: slice = slice(None)
    ) -> tuple[Floats, Floats]:
        """Return the PSF at places (n,) along both axes, um from its centre, and (modes, n, n) its derivatives,
        or some.

        The scale is as in `psf`, but the grid is free and nothing folds at the window's
        borders; `size` and `spacing_um` only set the pupil's sampling. R. Soummer et al.,
        Opt. Express 15, 15935 (2007).
        """
        turn = np.exp(
            -2j * np.pi / (self.size * self.spacing_um) * np.outer(at_um, self._offsets)
        )
        pupil = self._pupil_function(waves)
        field = turn @ pupil @ turn.T
        factor = 4 * np.pi * self.reference_um / self.wavelength_um / self._light
        slopes = np.empty((len(self.noll[only]), *field.shape))
        for slope, mode in zip(slopes, self.modes[only], strict=True):
            np.multiply(
                -factor, (np.conj(field) * (turn @ (pupil * mode) @ turn.T)).imag, out=slope
            )
        return np.asarray(np.abs(field) ** 2 / self._light), slopes

    def stretched(self, waves: Floats, stretch: float) -> Floats:
        """Return the (size, size) PSF of a larger f-number on its own grid.

        The pupil's samples stay and the transform is stretched, so the result is smooth in
        the factor to 1e-15; resampling the pupil would be smooth to 5e-7. Other wavelengths
        follow in the same way, with phases of 1 / their wavelength.
        """
        if stretch == 1:
            return self.psf(waves)
        field = self._to_stretched_image(self._pupil_function(waves), stretch)
        return np.asarray(np.abs(field) ** 2 / (self._light * stretch**2))

    def stretched_slope(self, waves: Floats, stretch: float) -> Floats:
        """Return the slope (size, size) of `stretched` by the factor's logarithm."""
        pupil = self._pupil_function(waves)
        offsets = 2j * np.pi / (self.size * stretch) * self._offsets
        places = np.arange(self.size) - self.size // 2
        field, down, right = (
            self._to_stretched_image(one, stretch)
            for one in (pupil, pupil * offsets[:, None], pupil * offsets)
        )
        change = places[:, None] * down + places * right
        light = self._light * stretch**2
        return np.asarray(2 * ((np.conj(field) * change).real - np.abs(field) ** 2) / light)

    def _to_stretched_image(self, pupil: Complexes, stretch: float) -> Complexes:
        """Return `_to_image` of a larger f-number, on the same places; the transform of the whole grid is fast."""
        if stretch == 1:
            return self._to_image(pupil)
        places = (np.arange(self.size) - self.size // 2) / (self.size * stretch)
        turn = np.exp(-2j * np.pi * np.outer(places, self._offsets))
        return np.asarray(turn @ pupil @ turn.T)


def diffraction_mtf(frequency: Floats) -> Floats:
    """Return the MTF of a perfect circular pupil at frequencies in units of the incoherent cutoff 1/(lambda N)."""
    nu = np.minimum(np.abs(real_array("frequency", frequency, None, "1/(lambda N)")), 1.0)
    return np.asarray(2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2)))
