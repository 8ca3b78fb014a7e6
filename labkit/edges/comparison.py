"""The fitted response against the one by ISO 12233, at every frequency, both measured in the same way.

The fit's mean counts go through the standard's steps as the photograph's do, so what the method adds, by its bins, window and
line, is in both. What remains is noise, which the bins' scatter shows, or a fault of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.edge_fit import EdgeFit
from labkit.edges.esfr import Esfr, Plane, esfr
from labkit.edges.region import mean_and_slopes
from labkit.edges.response import Response, crossing
from labkit.errors import DataError
from labkit.types import Floats

TOO_FAR = 4.5  # standard errors of the largest difference among a few dozen frequencies
ALIKE = 0.002  # to which the steps repeat
HIGHEST = 0.75  # cycles a sample; beyond, copies of the response are larger than it


@dataclass(frozen=True)
class Comparison:
    """What the photograph's response has more than the fit's.

    Attributes
    ----------
    frequency_per_mm, difference, noise : (f,)
    """

    frequency_per_mm: Floats
    difference: Floats
    noise: Floats

    @property
    def pull(self) -> float:
        """Largest difference in standard errors."""
        return float(np.max(np.abs(self.difference) / np.hypot(self.noise, ALIKE)))

    @property
    def contradicts(self) -> bool:
        """Return whether the difference is more than noise."""
        return self.pull > TOO_FAR

    def widened(self, response: Response) -> Response:
        """Return the fit's response with the difference in its errors, where it is more than noise."""
        excess = np.sqrt((self.difference**2 - self.noise**2).clip(0))
        # between its zeros the difference is as unknown as beside them
        near = np.pad(excess, 1, mode="edge")
        excess = np.max([near[:-2], near[1:-1], near[2:]], axis=0)
        every = response.frequency_per_mm
        further = np.interp(every, self.frequency_per_mm, excess)
        std = np.hypot(response.std, further)
        falls = (crossing(every, response.value, std, level) for level in (0.5, 0.1))
        return Response(every, response.value, std, *falls)


def compare(
    planes: tuple[Plane, ...], box: tuple[slice, slice], measured: Esfr, fit: EdgeFit, k: int
) -> Comparison | None:
    """Return what the response by ISO 12233 has more than a region's fit; None where the fit's cannot be measured.

    Parameters
    ----------
    planes, box : the photograph's samples, and the rows and columns of the box that they are of
    measured : their response
    fit, k : the fit, and the place of its region
    """
    region = fit.problem.regions[k]
    rows, columns = (each.ravel() for each in np.mgrid[box].astype(float))
    whole = replace(region, rows=rows, columns=columns, counts=np.zeros_like(rows))
    mean, _, _ = mean_and_slopes(
        whole,
        fit.state.edge(k),
        fit.problem.optics_of(k),
        fit.problem.wavefront(fit.state, k),
    )
    drawn = [replace(plane, values=mean[plane.index]) for plane in planes]
    pitch_um = fit.problem.optics_of(k).pitch_um
    try:
        modelled = esfr(drawn, pitch_um, measured.edition)
    except DataError:
        return None
    highest = HIGHEST / (planes[0].step * pitch_um * 1e-3)
    every = measured.frequency_per_mm
    used = (every > 0) & (every <= highest)
    value = np.interp(every[used], modelled.frequency_per_mm, modelled.value)
    return Comparison(every[used], measured.value[used] - value, measured.noise[used])
