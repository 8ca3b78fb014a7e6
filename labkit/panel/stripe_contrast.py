"""Predict the contrast of a panel's own stripes in photographs."""

from __future__ import annotations

from math import pi, sin

import numpy as np

from labkit.optics.lens import ThinLens, ground_sample_mm
from labkit.optics.mtf import mtf, pixel_mtf
from labkit.optics.wavefront import FittedWavefront
from labkit.panel import USUAL_APERTURE
from labkit.plan import Plan

LEAST_STRIPE_CONTRAST = 0.01
"""Amplitude, relative to white, of a pattern that spoils a fit: more than the noise of a pixel of 10 000 electrons."""

STRIPE_WIDTH = USUAL_APERTURE / 3
"""Lit width of a colour's stripe, as a share of the pixel's width."""

HARMONIC = 2 * sin(pi * STRIPE_WIDTH) / (pi * STRIPE_WIDTH)
"""Amplitude of a white panel's stripes in one colour, relative to their mean: the first term of their Fourier series."""


def stripe_contrast(
    plan: Plan, pitch_mm: float, range_mm: float, defocus_waves: float
) -> float:
    """Return the amplitude of a panel's stripes in a photograph, relative to white, for the channel that shows most contrast.

    Parameters
    ----------
    plan : lens, sensor and channels
    pitch_mm : pitch of the stripes
    range_mm : range of the panel
    defocus_waves : waves RMS at the plan's reference wavelength; the lens is otherwise perfect
    """
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    per_mm = (
        float(ground_sample_mm(lens, range_mm, 1e3)) / pitch_mm
    )  # on the sensor: 1e3 um of it see so many mm
    passed = []
    for channel in plan.channel:
        wavefront = FittedWavefront(
            (4,),
            np.array([defocus_waves]),
            np.zeros((1, 1)),
            channel.wavelength_nm,
            plan.reference_wavelength_nm,
            float(lens.working_f_number(range_mm)),
        )
        within = per_mm < wavefront.cutoff_per_mm
        passed.append(float(mtf(wavefront, per_mm, "x").value) if within else 0.0)
    return HARMONIC * max(passed) * float(pixel_mtf(per_mm, plan.sensor.active_um, "x"))
