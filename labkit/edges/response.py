"""The camera's MTF across an edge, as its fit has it: pixel and all, each value with its standard error."""

from dataclasses import dataclass

import numpy as np

from labkit.edges.edge_fit import EdgeFit
from labkit.edges.esfr import crossing
from labkit.edges.spread import camera_slice
from labkit.types import Floats
from labkit.uncertain import Uncertain

RESPONSE_POINTS = 400


@dataclass(frozen=True)
class FittedResponse:
    """Response of one edge: (n,) frequency_per_mm along its normal, value, std; its first falls to 0.5 and to
    0.1, cycles/mm.
    """

    frequency_per_mm: Floats
    value: Floats
    std: Floats
    mtf50: Uncertain
    mtf10: Uncertain


def fitted_response(fit: EdgeFit, k: int = 0) -> FittedResponse:
    """Return the response of one region's edge, up to twice the raw's Nyquist frequency or the lens's cutoff.

    Errors are by the delta method, from defocus and the other modes as the fit knows them.
    """
    optics, region = fit.problem.optics_of(k), fit.problem.regions[k]
    highest = min(1 / optics.pitch_um, 1 / (optics.airy_um * min(optics.light.nodes)))
    frequency = np.linspace(0, highest, RESPONSE_POINTS)
    of = camera_slice(
        optics, fit.problem.waves(fit.state, k), fit.state.edge(k).angle, frequency
    )
    value = np.abs(of.value)
    phase = np.divide(np.conj(of.value), value, out=np.ones_like(of.value), where=value > 0)
    gradient = (of.by_waves * phase).real
    covariance = fit.wavefront_covariance(region.depth)
    std = np.sqrt(np.einsum("if,ij,jf->f", gradient, covariance, gradient).clip(0))
    per_mm = 1e3 * frequency
    return FittedResponse(
        per_mm,
        value,
        std,
        crossing(per_mm, value, std, 0.5),
        crossing(per_mm, value, std, 0.1),
    )
