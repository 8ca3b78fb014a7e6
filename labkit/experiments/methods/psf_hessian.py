"""Second derivatives of a point-spread function by the modes of its wavefront (thesis, Appendix H)."""

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np
import scipy.fft

from labkit.arrays import real_array
from labkit.optics.psf import Pupil
from labkit.types import Complexes, Floats


def psf_hessian(pupil: Pupil, waves: Floats) -> Iterator[tuple[int, int, Floats]]:
    """Yield second derivatives of `Pupil.psf`, one pair of modes at a time to save memory.

    Parameters
    ----------
    pupil : the pupil, with the modes of its wavefront
    waves : (modes,), waves RMS at the reference wavelength

    Yields
    ------
    i, j : places of two modes, i <= j
    derivative : (size, size), per wave RMS squared

    Raises
    ------
    ValueError
        for a wavefront of another shape, or not finite

    Notes
    -----
    Thesis (H.11) for a wavefront linear in its modes, corrected: lambda_ref / lambda, and
    the normalisation.
    """
    waves = real_array("waves", waves, (len(pupil.noll),), "waves RMS, one for each mode")
    radians = 2 * np.pi * pupil.reference_um / pupil.wavelength_um
    function = pupil.amplitude * np.exp(1j * radians * np.tensordot(waves, pupil.modes, 1))

    def to_image(function: Complexes) -> Complexes:
        # the pupil begins at [0, 0]: a phase common to all fields, which the products with a conjugate cancel
        return np.asarray(
            scipy.fft.fftshift(scipy.fft.fft2(function, (pupil.size, pupil.size)))
        )

    field = to_image(function)
    by_mode = [to_image(function * mode) for mode in pupil.modes]
    light = (
        np.pi * pupil.radius**2 * pupil.size**2
    )  # sum of |field|^2, as `Pupil.psf` counts it
    factor = 2 * radians**2 / light
    for i, j in combinations_with_replacement(range(len(by_mode)), 2):
        twice = to_image(function * pupil.modes[i] * pupil.modes[j])
        product = np.conj(by_mode[i]) * by_mode[j] - np.conj(field) * twice
        yield i, j, np.asarray(factor * product.real)
