"""PSFs of a fitted session against those of its bench, in units of the errors that the fit states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import fourier_shift
from scipy.optimize import minimize

from labkit.drivers.simulated.optics import REFERENCE_NM, point_spread, working_f_number
from labkit.drivers.simulated.world import TrueLens, Truth
from labkit.optics.metrics import psf, psf_value
from labkit.optics.wavefront import FittedWavefront
from labkit.results import Results, Wavefront
from labkit.types import Floats

SAMPLES_PER_AIRY, REACH = 4, 96
"""To lambda N, and from the middle: a window of 48 lambda N, whose light sums to one in both PSFs."""

DRAWS = 60
"""Wavefronts drawn from the errors of one: a chance is known to 0.06."""


def psf_errors(results: Results, lens: TrueLens, truth: Truth) -> list[list[float]]:
    """Of each wavefront, the summed absolute error of its PSF and the error that it states.

    The stated error is the mean of the sum, for errors as large as those of the wavefront's modes and of lambda N: sqrt(2 / pi)
    times the sum of the samples' standard errors.
    """
    errors = []
    for w in results.wavefronts:
        assert w.range_mm is not None
        errors.append([*_error(w, lens, truth.waves(w.range_mm, w.channel))])
    return errors


def _error(w: Wavefront, lens: TrueLens, waves: Mapping[int, float]) -> tuple[float, float]:
    """Error and stated error of a wavefront's PSF."""
    spacing_um = w.wavelength_nm * 1e-3 * w.f_number / SAMPLES_PER_AIRY
    ours = psf(w.fitted, spacing_um, 2 * REACH + 1)
    true = true_psf(lens, w.channel, waves, spacing_um)
    stated = float(np.sqrt(2 / np.pi) * ours.std.sum())
    moved = moved_to_fit(true / true.sum(), ours.value)
    return float(np.abs(ours.value - moved).sum()), stated


def psf_chance(w: Wavefront, lens: TrueLens, truth: Truth, seed: int) -> float:
    """Return the chance of a PSF error smaller than the true one, by the stated errors of modes and of lambda N.

    Uniform over many sessions where errors are as stated. The light is the fit's: what its unknown width adds to stated errors
    is left out. Errors are L1, without the shift of the PSF.

    Parameters
    ----------
    w : a wavefront of the session
    seed : of the drawn wavefronts
    """
    rng = np.random.default_rng(seed)
    fitted = w.fitted
    assert w.range_mm is not None
    spacing_um = fitted.wavelength_um * fitted.f_number / SAMPLES_PER_AIRY
    ours = psf_value(fitted, spacing_um, 2 * REACH + 1)
    true = true_psf(lens, w.channel, truth.waves(w.range_mm, w.channel), spacing_um)
    error = _without_shift(moved_to_fit(true / true.sum(), ours) - ours, ours)
    smaller = sum(
        _without_shift(psf_value(one, spacing_um, 2 * REACH + 1) - ours, ours) < error
        for one in _drawn(fitted, rng)
    )
    return (smaller + 0.5) / (DRAWS + 1)


def _drawn(fitted: FittedWavefront, rng: np.random.Generator) -> Iterator[FittedWavefront]:
    """Yield wavefronts drawn from the errors of one; modes that the data leave open stay as they are."""
    known = np.isfinite(np.diag(fitted.covariance))
    covariance = np.where(np.outer(known, known), fitted.covariance, 0.0)
    for waves in rng.multivariate_normal(fitted.waves, covariance, DRAWS):
        scale = 1 + fitted.scale_relative_std * rng.standard_normal()
        yield replace(fitted, waves=waves, f_number=fitted.f_number * scale)


def _without_shift(change: Floats, psf_values: Floats) -> float:
    """Return the summed absolute change of a PSF, less the shift that fits it best by least squares."""
    slopes = np.stack([slope.ravel() for slope in np.gradient(psf_values)], axis=1)
    shift, *_ = np.linalg.lstsq(slopes, change.ravel(), rcond=None)
    return float(np.abs(change.ravel() - slopes @ shift).sum())


def true_psf(
    lens: TrueLens, colour: str, waves: Mapping[int, float], spacing_um: float
) -> Floats:
    """The bench's PSF of the optics alone, (2 REACH + 1, same), in all of a colour's light."""
    cone = working_f_number(
        lens.f_number_in(colour),
        lens.best_focus_mm[colour],
        lens.focal_length_in(colour),
        lens.pupil_magnification,
    )
    total = np.zeros((2 * REACH + 1,) * 2)
    for nm, share in lens.lines_in(colour):
        here = {**waves, 4: waves[4] + lens.defocus_within(colour, nm)}
        total += share * point_spread(
            here, nm, cone, spacing_um, REACH, REFERENCE_NM, lens.pupil
        )
    return total


def moved_to_fit(true: Floats, ours: Floats) -> Floats:
    """The true PSF moved to where it fits ours best, by the summed absolute difference: where a picture lies is its pose."""
    transform = np.fft.fftn(true)

    def moved(shift: Floats) -> Floats:
        return np.asarray(np.fft.ifftn(fourier_shift(transform, shift)).real)

    def at(shift: Floats) -> float:
        return float(np.abs(ours - moved(shift)).sum())

    corners = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    best = minimize(
        at,
        np.zeros(2),
        method="Nelder-Mead",
        options={"initial_simplex": corners, "xatol": 1e-3, "fatol": 1e-6},
    )
    return moved(best.x)
