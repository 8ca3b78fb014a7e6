"""The results of a session: a wavefront for each range and channel, and best focus.

A fit makes the same objects as are read back from its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite, nan, pi

import numpy as np
from numpy.typing import ArrayLike

from labkit.key import Key
from labkit.optics import metrics
from labkit.optics.field import centre_px
from labkit.optics.lens import ThinLens
from labkit.optics.mtf import Curve, Direction, mtf
from labkit.optics.rim import ROUND, Rim
from labkit.optics.spectrum import Spectrum
from labkit.optics.strehl import strehl
from labkit.optics.wavefront import FittedWavefront, at_focus
from labkit.optics.zernike import is_even, twin_signs
from labkit.results.best_focus import BestFocus
from labkit.types import Floats
from labkit.uncertain import Uncertain

CORRELATION_ROUNDING = 1e-6
"""Of correlations, in results that are written as numbers of a file."""


@dataclass(frozen=True, slots=True)
class OtherOptimum:
    """Another optimum of the search.

    waves: (modes,) RMS; log_likelihood_below: difference of its log-likelihood to the best optimum's, 0 or more.
    """

    waves: Floats
    log_likelihood_below: float


@dataclass(frozen=True, slots=True)
class OptimumTest:
    """The test of whether a fit ended at the global optimum.

    Attributes
    ----------
    name : the decisive evidence: "residuals", "session", "starts" (many starts reached this optimum), or "parts" (a fit with
        parts of the camera beyond the model explains the residuals)
    accepted : whether the optimum is global
    p_value : chance of residuals as large as these
    starts : number of starts
    undetermined : combinations of modes not determined by the frames, in words
    others : other optima, the likeliest first
    explains : whether the residuals are noise alone, so that the model explains the data; independent of `accepted`
    """

    name: str
    accepted: bool
    p_value: float
    starts: int | None = None
    undetermined: tuple[str, ...] = ()
    others: tuple[OtherOptimum, ...] = ()
    explains: bool = True

    @property
    def next_below(self) -> float:
        """Difference of the log-likelihood to the next optimum; nan without another."""
        return self.others[0].log_likelihood_below if self.others else nan


@dataclass(frozen=True, slots=True)
class ResidualSpectrum:
    """Residuals by spatial frequency, a mean over all directions.

    cycles_per_px: (n,) of the raw's pixels; power: (n,) relative to the noise's, 1 for
    noise alone; without_parts: (n,) the same without the detected parts of the camera, None
    if there are none
    """

    cycles_per_px: Floats
    power: Floats
    without_parts: Floats | None = None


@dataclass(frozen=True, slots=True)
class PartTried:
    """A tested part of the camera.

    gain: predicted gain in log-likelihood over the model without the part, by the score test; adopted: whether the part
    joined the model.
    """

    name: str
    gain: float
    adopted: bool


@dataclass(frozen=True, slots=True)
class Residuals:
    """(frames, planes, rows, columns) counts of the fitted pixels, their model and its noise; nan where not used."""

    data: Floats
    model: Floats
    sigma: Floats

    def __post_init__(self) -> None:
        shape = self.data.shape
        if len(shape) != 4 or 0 in shape:
            raise ValueError(f"residuals of shape {shape}: frames, planes, rows, columns")
        if not shape == self.model.shape == self.sigma.shape:
            raise ValueError("residuals, model and noise differ in shape")
        if not all(a.dtype.kind == "f" for a in (self.data, self.model, self.sigma)):
            raise ValueError("residuals are no floating-point numbers")

    @property
    def normalised(self) -> Floats:
        """Data less model, in standard deviations of the noise."""
        return np.asarray((self.data - self.model) / self.sigma)


@dataclass(frozen=True, slots=True)
class Placement:
    """Places of the fitted pixels in the photographs, in pixels of the raw file, pixel centres at integers.

    origin_px, shape_px: (row, column) of the first pixel of the cut, and its (rows, columns). corners_px: (frames, 4, 2)
    [row, column] of the target's corners (0, 0), (0, w), (h, w), (h, 0) in each photograph, as fitted.
    """

    origin_px: tuple[int, int]
    shape_px: tuple[int, int]
    corners_px: Floats

    @property
    def centre_px(self) -> tuple[float, float]:
        """(row, column) of the tile's middle, see `labkit.optics.field.centre_px`."""
        row, column = centre_px(self.corners_px, self.origin_px, self.shape_px)
        return float(row), float(column)


@dataclass(frozen=True)
class Wavefront:
    """The wavefront of a channel at a range, estimated from photographs.

    range_mm: as stated by the plan, None where unknown; measured_range_mm: where the rail was read to stand. noll: the
    modes; waves: (modes,) OPD in waves RMS at reference_wavelength_nm; covariance: (modes, modes). f_number,
    f_number_std: of the cone that reaches the sensor. lambda_n: wavelength times f-number, um, the scale of diffraction
    on the sensor, with an error that includes the wavelength's, but no doubt about the pixel pitch; None for a fit
    outside the session's estimate. blur: diameter of defocus's geometric blur on the sensor, um, negative before best
    focus, 8 N times the peak to valley of defocus: known better than defocus in waves, which hangs on the f-number.
    wavelength_nm: as estimated, or as stated if the photographs call it exact. poses: (frames, 8) of the target; gain:
    counts per electron; read_noise: counts. missing: parts of the camera that a model which does not explain the data
    seems to lack; residual_spectrum: of what it leaves. spectrum: of the light, about its wavelength, as the plan
    states it or the photographs call for it. rim: of the pupil; f-number and modes are those of the circle with the
    full pupil's clear area, which a cat's eye cuts. tile: (row, column), None for the whole frame. pulls: (modes,) of a
    tile's own fit less the prediction of all other tiles, over the standard errors; None without a field. sign_open:
    whether the `twin`, whose even modes have the other sign, is as likely: from one range it always is.

    >>> w = labkit.Results.load("night-3")[3200, "G"]
    >>> w.best.strehl, w.best.rms_nm, w.best.mtf50("x")  # the lens, without defocus
    >>> w[4], w.strehl, w.mtf([50.0]).std, w.psf(spacing_um=1), w.opd(256)  # the photographs, defocus included
    """

    range_mm: float | None
    measured_range_mm: float | None
    channel: str
    wavelength_nm: float
    reference_wavelength_nm: float
    f_number: float
    noll: tuple[int, ...]
    waves: Floats
    covariance: Floats
    poses: Floats
    gain: float
    read_noise: float
    chi2_per_pixel: float
    test: OptimumTest | None = None
    seconds: float = nan
    frames: tuple[str, ...] = ()
    f_number_std: float = nan
    lambda_n: Uncertain | None = None
    blur: Uncertain | None = None
    missing: tuple[str, ...] = ()
    spectrum: Spectrum = field(default_factory=Spectrum)
    rim: Rim = ROUND
    residual_spectrum: ResidualSpectrum | None = field(default=None, repr=False)
    placement: Placement | None = None
    residuals: Residuals | None = field(default=None, repr=False)
    tile: tuple[int, int] | None = None
    pulls: Floats | None = field(default=None, repr=False)
    sign_open: bool = False
    widest_light_nm: float = 0.0

    def __post_init__(self) -> None:
        if self.sign_open and not any(map(is_even, self.noll)):
            object.__setattr__(self, "sign_open", False)
        if self.blur is not None:
            blur = replace(self.blur, sign_open=self.sign_open)
            object.__setattr__(self, "blur", blur)
        modes = len(self.noll)
        if self.waves.shape != (modes,) or self.covariance.shape != (modes, modes):
            raise ValueError(
                f"{modes} modes, {self.waves.size} coefficients and a covariance of shape {self.covariance.shape}"
            )
        if len(set(self.noll)) != modes:
            raise ValueError(f"{self.key.label} has a mode twice")
        refuse_no_covariance(f"the covariance of {self.key.label}", self.covariance)
        if self.poses.ndim != 2 or not len(self.poses):
            raise ValueError(f"{self.key.label} has poses of shape {self.poses.shape}")
        if self.residuals is not None and len(self.residuals.data) != len(self.poses):
            raise ValueError(
                f"{self.key.label} has residuals of {len(self.residuals.data)} photographs and {len(self.poses)} poses"
            )

    def __getitem__(self, mode: int) -> Uncertain:
        """The coefficient of a Noll mode, waves RMS. Raises KeyError for a mode not estimated."""
        if mode not in self.noll:
            raise KeyError(
                f"Noll mode {mode}: estimated are {self.noll[0]} to {self.noll[-1]}"
            )
        index = self.noll.index(mode)
        sign_open = self.sign_open and is_even(mode)
        return Uncertain(
            float(self.waves[index]), float(self.std[index]), "waves", sign_open
        )

    @property
    def twin(self) -> Wavefront:
        """The wavefront turned by half a turn and negated: its even modes have the other sign, its images are the same."""
        signs = twin_signs(self.noll)
        return replace(
            self,
            waves=self.waves * signs,
            covariance=self.covariance * np.outer(signs, signs),
            rim=self.rim.turned(pi),
            blur=None if self.blur is None else replace(self.blur, value=-self.blur.value),
        )

    @property
    def key(self) -> Key:
        """The identity of this wavefront; ``str(w.key)`` names its arrays in files: ``3200_G``."""
        return Key(self.range_mm, self.channel, self.tile)

    @property
    def std(self) -> Floats:
        """(modes,) standard errors, waves RMS."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def defocus(self) -> Uncertain | None:
        """Noll mode 4, waves RMS, where estimated."""
        return self[4] if 4 in self.noll else None

    @property
    def working_f_number(self) -> Uncertain:
        """Working f-number, by the full pupil's clear area."""
        return Uncertain(self.f_number, self.f_number_std)

    @property
    def outer_f_number(self) -> Uncertain:
        """Working f-number of the circle around the pupil, as if nothing limited or obstructed the pupil."""
        return Uncertain(self.f_number / self.rim.outer, self.f_number_std / self.rim.outer)

    @property
    def accepted(self) -> bool:
        """Return whether the optimum was tested and not rejected."""
        return self.test is not None and self.test.accepted

    @property
    def fitted(self) -> FittedWavefront:
        """The same as `labkit.optics.metrics` takes it."""
        cone = (self.f_number, self.f_number_std if isfinite(self.f_number_std) else 0.0)
        return FittedWavefront(
            self.noll,
            self.waves,
            self.covariance,
            self.wavelength_nm,
            self.reference_wavelength_nm,
            *cone,
            self.spectrum,
            self.widest_light_nm,
            self.rim,
            None if self.lambda_n is None else self.lambda_n.std / self.lambda_n.value,
        )

    @cached_property
    def best(self) -> BestFocus:
        """The lens at best focus: Strehl ratio, RMS, MTF and more of the wavefront without its defocus."""
        return BestFocus(self.at_focus())

    @property
    def strehl(self) -> Uncertain:
        """Strehl ratio of the photographs, defocus included; `best` has the lens's."""
        return strehl(self.fitted)

    def at_focus(self) -> FittedWavefront:
        """The wavefront without its defocus, with its covariance; `best` has its numbers."""
        return at_focus(self.fitted)

    def rms(self, without: tuple[int, ...] = ()) -> Uncertain:
        """Root of the sum of squares over the modes, but for some; waves RMS. Defocus is included; `best.rms` is without."""
        return metrics.rms(self.fitted, without)

    def opd(self, samples: int) -> Floats:
        """(samples, samples) optical path difference over the pupil, waves at the reference; nan outside."""
        return metrics.opd_map(self.fitted, samples).value

    def psf(self, spacing_um: float, size: int | None = None) -> Floats:
        """(size, size) point-spread function of the optics alone, unit sum, rows down and columns right as on the sensor.

        Of all its light: weighted over the spectrum, where the channel has one.
        size: odd; by default the window reaches 32 lambda N from its centre.
        """
        return metrics.psf_value(self.fitted, spacing_um, size)

    def mtf(self, frequency_per_mm: ArrayLike, direction: Direction | float = "x") -> Curve:
        """MTF of the optics alone with standard errors, along "x" (right), "y" (down), or degrees from x towards y."""
        return mtf(self.fitted, frequency_per_mm, direction)


@dataclass(frozen=True, slots=True)
class Lens:
    """The lens that all ranges and channels have in common.

    f_number: at infinity; range_zero: what is to be added to the stated ranges to have the true ones, from the front
    principal plane, mm; wavelengths_nm: of each channel, as estimated, or as stated if the photographs call that exact.
    """

    focal_length: Uncertain
    f_number: Uncertain
    pupil_magnification: Uncertain
    range_zero: Uncertain
    wavelengths_nm: dict[str, Uncertain] = field(default_factory=dict)

    @property
    def thin(self) -> ThinLens:
        """The lens by its estimated numbers, without their errors."""
        return ThinLens(
            self.focal_length.value, self.f_number.value, self.pupil_magnification.value
        )


@dataclass(frozen=True)
class Focus:
    """Best focus of each channel and one pupil magnification for all.

    ``focus["G"]`` is a range in mm. covariance: of the channels' best focus in order, then of the pupil magnification.
    residual_waves: measured less fitted defocus of each channel's ranges; residual_std_waves: its standard errors, where they
    are known. chi2_per_freedom: None where there are as many unknowns as measurements. identifiable: whether these ranges
    determine the pupil magnification.
    """

    best_focus_mm: dict[str, Uncertain]
    pupil_magnification: Uncertain
    identifiable: bool
    residual_waves: dict[str, tuple[float, ...]]
    covariance: Floats | None = None
    chi2_per_freedom: float | None = None
    residual_std_waves: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.covariance is not None:
            size = len(self.best_focus_mm) + 1
            if self.covariance.shape != (size, size):
                raise ValueError(
                    f"the covariance of best focus has shape {self.covariance.shape}; ({size}, {size}) is needed"
                )
            refuse_no_covariance("the covariance of best focus", self.covariance)
        for channel, std in self.residual_std_waves.items():
            rest = self.residual_waves.get(channel, ())
            if len(std) != len(rest):
                raise ValueError(
                    f"{channel} has {len(rest)} residuals and {len(std)} errors of them"
                )

    def residuals(self, channel: str) -> list[Uncertain]:
        """Defocus residuals of a channel's ranges, waves RMS; an unknown error is nan."""
        rest = self.residual_waves.get(channel, ())
        std = self.residual_std_waves.get(channel, (nan,) * len(rest))
        return [Uncertain(*pair, "waves") for pair in zip(rest, std, strict=True)]

    def __getitem__(self, channel: str) -> Uncertain:
        """Best focus of a channel, mm. Raises KeyError for a channel not fitted."""
        if channel not in self.best_focus_mm:
            raise KeyError(
                f"channel {channel!r}: fitted are {', '.join(self.best_focus_mm)}"
            )
        return self.best_focus_mm[channel]


def refuse_no_covariance(name: str, matrix: Floats) -> None:
    """Raise ValueError for a matrix (n, n) that is not symmetric, or has a variance below 0; nan stands for unknown."""
    if matrix.ndim != 2 or matrix.shape != matrix.T.shape:
        raise ValueError(f"{name} has shape {matrix.shape}; it is square")
    variances = np.diag(matrix)
    known = np.isfinite(variances)
    matrix = matrix[np.ix_(known, known)]
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} has an unknown number between known variances")
    scale = np.sqrt(np.abs(np.diag(matrix)))
    with np.errstate(over="ignore"):
        # one after the other: the product of two small scales may be 0
        positive = np.where(scale > 0, scale, 1.0)
        scaled = matrix / positive / positive[:, np.newaxis]
    if not np.isfinite(scaled).all():
        raise ValueError(f"{name} has a variance below 0")
    if not np.allclose(scaled, scaled.T, rtol=0, atol=CORRELATION_ROUNDING):
        raise ValueError(f"{name} is not symmetric")
    try:
        # it exists where no eigenvalue is below the rounding's, and takes a tenth of the time of eigenvalues
        np.linalg.cholesky(
            scaled + CORRELATION_ROUNDING * len(scaled) * np.eye(len(scaled))
        )
    except np.linalg.LinAlgError:
        raise ValueError(f"{name} has a variance below 0") from None


FOCAL_LENGTH_MM = "focal_length_mm"
F_NUMBER_AT_INFINITY = "f_number"
LN_MAGNIFICATION = "ln_pupil_magnification"
BEST_FOCUS_MM = "best_focus_mm"
COLOUR_UM = "colour_um"
MODE_WAVES = "waves"
"""Names of numbers. `waves.G.7`: Noll mode 7 of G; `colour_um.R`: focal length of R less the leading channel's;
`best_focus_mm.G`: of the leading channel."""


@dataclass(frozen=True, slots=True, eq=False)
class StatedNumber:
    """A number known before the session, and its part in the errors.

    value, std: as known before. moves: (n,) changes of the common numbers for a change of
    this number by one standard error.
    """

    value: float
    std: float
    moves: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CommonNumbers:
    """Numbers of the lens with their joint covariance.

    Attributes
    ----------
    names : n names, such as `waves.G.7`
    values : (n,)
    covariance : (n, n) with all errors
    stated : numbers known before the session, by name, such as `f_number` or `wavelength_nm.G`

    Raises
    ------
    ValueError
        sizes differ, or the covariance is none
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    stated: Mapping[str, StatedNumber] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.names)
        sizes = {self.values.shape, *(one.moves.shape for one in self.stated.values())}
        if sizes != {(n,)} or self.covariance.shape != (n, n) or len(set(self.names)) != n:
            raise ValueError(f"{n} common numbers differ in number from their errors")
        refuse_no_covariance("the covariance of the common numbers", self.covariance)
