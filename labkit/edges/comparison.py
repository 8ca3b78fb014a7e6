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
from labkit.edges.response import Response, with_errors
from labkit.errors import DataError
from labkit.types import Floats

TOO_FAR = 4.5  # standard errors of the largest difference among a few dozen frequencies
REPEATED_TO = 0.002  # to which the steps repeat
LOST_SHARE = 0.1  # of a difference, at most, by bins and window
HIGHEST_COMPARED = (
    0.75  # cycles a sample; beyond, copies of the response are larger than it
)


@dataclass(frozen=True)
class Comparison:
    """The difference of the photograph's response from the fit's.

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
        return float(np.max(np.abs(self.difference) / np.hypot(self.noise, REPEATED_TO)))

    @property
    def contradicts(self) -> bool:
        """Return whether the difference is more than noise."""
        return self.pull > TOO_FAR

    def corrected(self, response: Response) -> Response:
        """Return the fit's response with the difference added, for a model that the photograph contradicts.

        Errors hold the noise of the difference and its unknown share that the bins and the window changed.
        """
        every = response.frequency_per_mm
        at = self.frequency_per_mm
        # beyond what was compared the last difference is unknown
        difference = np.interp(every, at, self.difference, left=0.0, right=0.0)
        noise = np.interp(every, at, self.noise, left=0.0)
        unknown = np.where(
            every > at[-1], abs(self.difference[-1]), LOST_SHARE * abs(difference)
        )
        errors = [response.std, noise, unknown]
        std = np.linalg.norm(errors, axis=0)
        value = response.value + difference
        return with_errors(every, value, std)


def compare(
    planes: tuple[Plane, ...], measured: Esfr, mean: Floats, pitch_um: float
) -> Comparison | None:
    """Return the difference of the response by ISO 12233 from a fit's; None where the fit's cannot be measured.

    Parameters
    ----------
    planes : the photograph's samples
    measured : their response
    mean : (n,) mean counts by the fit, of the pixels that the planes' samples are numbered by
    pitch_um : of the photograph's pixels
    """
    drawn = [replace(plane, values=mean[plane.index]) for plane in planes]
    try:
        modelled = esfr(drawn, pitch_um, measured.edition)
    except DataError:
        return None
    highest = HIGHEST_COMPARED / (planes[0].step * pitch_um * 1e-3)
    every = measured.frequency_per_mm
    used = (every > 0) & (every <= highest)
    value = np.interp(every[used], modelled.frequency_per_mm, modelled.value)
    return Comparison(every[used], measured.value[used] - value, measured.noise[used])


def pixels_of(box: tuple[slice, slice]) -> tuple[Floats, Floats]:
    """Return rows and columns (n,) of the pixels of a box, in the order that samples are numbered by."""
    rows, columns = (each.ravel() for each in np.mgrid[box].astype(float))
    return rows, columns


def fitted_mean(fit: EdgeFit, k: int, box: tuple[slice, slice]) -> Floats:
    """Return the mean counts (n,) of the pixels of a box by the fit of its region, the fit's k-th."""
    rows, columns = pixels_of(box)
    region = fit.problem.regions[k]
    whole = replace(region, rows=rows, columns=columns, counts=np.zeros_like(rows))
    mean, _, _ = mean_and_slopes(
        whole,
        fit.state.edge(k),
        fit.problem.optics_of(k),
        fit.problem.wavefront(fit.state, k),
    )
    return mean
