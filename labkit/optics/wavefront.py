"""A fitted wavefront: its modes, their covariance, and their beam."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.arrays import positive, real_array
from labkit.optics.rim import ROUND, Rim
from labkit.optics.spectrum import Spectrum
from labkit.optics.zernike import modes_at
from labkit.types import Floats

DEFOCUS = 4

FARTHEST_WAVES = 12.0
"""RMS defocus, in the light's own wavelength, up to which a wavefront is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedWavefront:
    """A wavefront with its errors and its light.

    Pupil coordinates as in `labkit.optics.psf`: x to the right along the sensor's rows, y
    down.

    Parameters
    ----------
    noll : the modes
    waves : (modes,) path difference, waves RMS at the reference wavelength
    covariance : (modes, modes) of waves; nan if unknown, infinite on the diagonal for a
        mode that the data leave open
    f_number : working f-number
    f_number_std : its standard error, which enters depths of focus as if independent of the modes'
    rim : of the pupil; the f-number is that of the circle with the full pupil's clear area,
        over which the modes are Noll's; a cat's eye cuts the full pupil
    spectrum : of the light, about its wavelength; all wavelengths have the same path
        difference, in length
    scale_std : relative standard error of lambda N, which enters lengths in the image as if
        independent of the modes'; None for that of the f-number
    widest_nm : for an unknown spectrum, the largest standard deviation of the light that
        the photographs allow; 0 if known

    Raises
    ------
    ValueError
        for repeated or impossible modes, and for arrays of other shapes
    """

    noll: tuple[int, ...]
    waves: Floats
    covariance: Floats
    wavelength_nm: float
    reference_nm: float
    f_number: float
    f_number_std: float = 0.0
    spectrum: Spectrum = field(default_factory=Spectrum)
    widest_nm: float = 0.0
    rim: Rim = ROUND
    scale_std: float | None = None

    def __post_init__(self) -> None:
        modes = len(self.noll)
        if len(set(self.noll)) < modes or any(j < 1 for j in self.noll):
            raise ValueError(
                f"noll = {self.noll}: Noll's modes are counted from 1, and each is given once"
            )
        for name in ("wavelength_nm", "reference_nm"):
            positive(name, getattr(self, name), "nm")
        positive("f_number", self.f_number, "unitless")
        object.__setattr__(
            self,
            "waves",
            real_array("waves", self.waves, (modes,), "waves RMS, one for each mode"),
        )
        covariance = np.asarray(self.covariance, float)
        if covariance.shape != (modes, modes):
            raise ValueError(
                f"covariance has shape {covariance.shape}; {(modes, modes)} is needed (waves RMS squared)"
            )
        if not np.allclose(covariance, covariance.T, rtol=1e-8, equal_nan=True):
            raise ValueError(
                f"covariance, shape {covariance.shape}: it is not symmetric (waves RMS squared)"
            )
        object.__setattr__(self, "covariance", covariance)

    @property
    def wavelength_um(self) -> float:
        """Wavelength, um."""
        return 1e-3 * self.wavelength_nm

    @property
    def reference_um(self) -> float:
        """Reference wavelength, um."""
        return 1e-3 * self.reference_nm

    @property
    def std(self) -> Floats:
        """(modes,) standard errors of the modes, waves RMS at the reference wavelength."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def cutoff_per_mm(self) -> float:
        """Cutoff frequency on the sensor, 1/(lambda N), in cycles/mm, of the shortest wavelength.

        A pupil that is no disc passes more along its largest width.
        """
        shortest_um = min(self.spectrum.nodes) * self.wavelength_um
        return self.rim.reach * 1e3 / (shortest_um * self.f_number)

    @property
    def lights(self) -> list[tuple[float, FittedWavefront]]:
        """Shares of the light, each with the wavefront at one wavelength: their PSFs add up."""
        if self.spectrum == Spectrum():
            return [(1.0, self)]
        return [
            (
                share,
                replace(self, wavelength_nm=node * self.wavelength_nm, spectrum=Spectrum()),
            )
            for share, node in self.spectrum.shares
        ]

    def in_light(self, std_nm: float) -> FittedWavefront:
        """Return the wavefront in light of another standard deviation of its wavelengths.

        A spectrum keeps its form. Light of one wavelength becomes symmetric about it, and
        is at most `labkit.optics.spectrum.WIDEST_SPECTRUM` of the wavelength broad.
        """
        spectrum = self.spectrum.with_variance((std_nm / self.wavelength_nm) ** 2)
        return replace(self, spectrum=spectrum, widest_nm=0.0)

    @property
    def in_possible_lights(self) -> tuple[FittedWavefront, ...]:
        """The wavefront in light midway to the broadest that the photographs allow, and in the broadest; none if it is known.

        These wavefronts are without errors: only values are compared.

        A number can change more in the narrower light, where diffraction rings that broad light washes out meet the blur's
        wider rim.
        """
        if not self.widest_nm > 0:
            return ()
        own_nm = self.wavelength_nm * max(self.spectrum.variance, 0.0) ** 0.5
        midway_nm = (own_nm + self.widest_nm) / 2
        none = np.zeros_like(self.covariance)
        exact = replace(self, covariance=none, f_number_std=0.0, scale_std=0.0)
        return exact.in_light(midway_nm), exact.in_light(self.widest_nm)

    @property
    def exact(self) -> bool:
        """Return whether the wavefront has no errors: numbers computed from it need no derivatives."""
        return not (self.covariance.any() or self.f_number_std or self.scale_std)

    @property
    def radians_per_wave(self) -> float:
        """Phase, at the light's nominal wavelength, of one wave of path at the reference wavelength."""
        return 2 * np.pi * self.reference_um / self.wavelength_um

    @property
    def f_number_relative_std(self) -> float:
        """Relative standard error of the f-number."""
        return self.f_number_std / self.f_number

    @property
    def scale_relative_std(self) -> float:
        """Relative standard error of lambda N, the scale of lengths in the image."""
        return self.f_number_relative_std if self.scale_std is None else self.scale_std

    def index(self, j: int) -> int:
        """Return the index of Noll mode j in `noll`. Raises ValueError for a missing mode."""
        if j not in self.noll:
            raise ValueError(
                f"Noll mode {j} is not among the fitted: {', '.join(map(str, self.noll))}"
            )
        return self.noll.index(j)

    def without(self, modes: Collection[int]) -> FittedWavefront:
        """Return the wavefront without some Noll modes and their covariances; missing modes are no error."""
        kept = [k for k, j in enumerate(self.noll) if j not in modes]
        noll = tuple(self.noll[k] for k in kept)
        return replace(
            self,
            noll=noll,
            waves=self.waves[kept],
            covariance=self.covariance[np.ix_(kept, kept)],
        )

    def mapped(self, noll: tuple[int, ...], matrix: Floats) -> FittedWavefront:
        """Return the wavefront of modes `noll` whose coefficients are a matrix (len(noll), modes) times these."""
        return replace(
            self,
            noll=noll,
            waves=matrix @ self.waves,
            covariance=matrix @ self.covariance @ matrix.T,
        )

    def opd(self, x: Floats, y: Floats) -> Floats:
        """Return the path difference at points of the pupil, waves at the reference wavelength.

        x, y: of one shape, the pupil's radius is 1
        """
        return np.asarray(np.tensordot(self.waves, modes_at(self.noll, x, y), 1))

    def variance(self, gradient: Floats) -> Floats:
        """Return the (...) variance of numbers with gradients (modes, ...) by the coefficients, by the delta
        method.
        """
        known = np.isfinite(np.diag(self.covariance))
        part = np.tensordot(self.covariance[np.ix_(known, known)], gradient[known], 1)
        variance = np.sum(gradient[known] * part, axis=0).clip(0)
        for value, slope in zip(
            np.diag(self.covariance)[~known], gradient[~known], strict=True
        ):
            variance = variance + np.where(slope != 0, value, 0.0)
        return np.asarray(variance)


def at_focus(wavefront: FittedWavefront) -> FittedWavefront:
    """Return the wavefront at best focus: without Noll 4, and without its errors.

    Best focus is the focus of zero Noll defocus, in a round clear pupil that of least RMS. To
    second order in the other modes it also has the highest Strehl ratio; with strong higher
    orders, or in a pupil of another shape, the two differ.
    """
    return wavefront.without((DEFOCUS,))
