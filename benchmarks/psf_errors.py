"""PSFs of a fitted session against those of its bench, in units of the errors that the fit states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import fourier_shift
from scipy.optimize import minimize

from labkit.drivers.simulated.optics import REFERENCE_NM, point_spread, working_f_number
from labkit.drivers.simulated.world import TrueLens, Truth
from labkit.optics.metrics import psf
from labkit.results import Results, Wavefront
from labkit.types import Floats

SAMPLES_PER_AIRY, REACH = 4, 96
"""To lambda N, and from the middle: a window of 48 lambda N, whose light sums to one in both PSFs."""


def psf_errors(results: Results, lens: TrueLens, truth: Truth) -> list[list[float]]:
    """Of each wavefront, the summed absolute error of its PSF and the error that it states.

    The stated error is the mean of the sum, for errors as large as those of the wavefront's modes and cone: sqrt(2 / pi) times
    the sum of the samples' standard errors.
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
