"""The camera's response across an edge, pixel and all, each value with its standard error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labkit.edges.edge_fit import EdgeFit
from labkit.edges.region import BLUR_NUMBERS
from labkit.edges.spread import EdgeBlur, camera_slice
from labkit.imaging.optics import Optics
from labkit.optics.mtf import modulus
from labkit.types import Floats
from labkit.uncertain import Uncertain

RESPONSE_POINTS = 400
UNKNOWN_FREQUENCY = Uncertain(np.nan, np.nan, "cycles/mm")


@dataclass(frozen=True)
class Response:
    """The response across an edge, along its normal.

    Attributes
    ----------
    frequency_per_mm, value, std : (n,) on the sensor
    mtf50, mtf10 : first fall to 0.5 and to 0.1, cycles/mm; nan without a fall, and where unknown
    """

    frequency_per_mm: Floats
    value: Floats
    std: Floats
    mtf50: Uncertain
    mtf10: Uncertain

    def at(self, per_mm: float) -> Uncertain:
        """Return the response at a frequency; 0 beyond the lens's cutoff."""
        every = self.frequency_per_mm
        value, std = (
            float(np.interp(per_mm, every, of, right=0.0)) for of in (self.value, self.std)
        )
        return Uncertain(value, std)

    def enlarged(self, factor: float) -> Response:
        """Return the response with errors enlarged by a factor."""
        return with_errors(self.frequency_per_mm, self.value, factor * self.std)


def with_errors(per_mm: Floats, value: Floats, std: Floats) -> Response:
    """Return a response (n,) at frequencies (n,), with errors (n,)."""
    falls = (crossing(per_mm, value, std, level) for level in (0.5, 0.1))
    return Response(per_mm, value, std, *falls)


def fitted_response(fit: EdgeFit, k: int = 0) -> Response:
    """Return the response of a region's edge, up to twice the raw's Nyquist frequency or the lens's cutoff.

    Errors are by the delta method, from defocus and the other modes as the fit knows them.
    """
    problem = fit.problem
    edge = fit.state.edge(k)
    blur = problem.regions[k].blur_of(edge)
    places = problem.wavefront(fit.state.places, k)
    if blur is not None:
        places = np.append(
            places, fit.state.places.edges[k, list(BLUR_NUMBERS[: blur.kind.size])]
        )
    return response_along(
        problem.optics_of(k),
        problem.wavefront(fit.state, k),
        fit.among(places),
        edge.angle,
        blur,
    )


def response_along(
    optics: Optics,
    waves: Floats,
    covariance: Floats,
    azimuth: float,
    blur: EdgeBlur | None = None,
) -> Response:
    """Return the response of a camera along an azimuth.

    Parameters
    ----------
    optics : of a channel
    waves, covariance : (modes,) of its wavefront, RMS at the reference; (modes + numbers,) squared of wavefront and blur
    azimuth : radians from x (right) towards y (down)
    blur : of an edge, that no wavefront makes
    """
    highest = min(1 / optics.pitch_um, 1 / (optics.airy_um * min(optics.light.nodes)))
    frequency = np.linspace(0, highest, RESPONSE_POINTS)
    of = camera_slice(optics, waves, azimuth, frequency, blur)
    value, gradient = modulus(of.value, np.concatenate([of.by_waves, of.by_blur]))
    std = np.sqrt(np.einsum("if,ij,jf->f", gradient, covariance, gradient).clip(0))
    return with_errors(1e3 * frequency, value, std)


def crossing(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Return the frequency at which a curve first falls to a level, by lines between its samples; nan without a fall."""
    k = int(np.argmax(value < level))
    if k == 0:
        return UNKNOWN_FREQUENCY
    slope = (value[k] - value[k - 1]) / (frequency[k] - frequency[k - 1])
    at = frequency[k - 1] + (level - value[k - 1]) / slope
    error = np.interp(at, frequency, std) / abs(slope)
    return Uncertain(at, error, "cycles/mm")
