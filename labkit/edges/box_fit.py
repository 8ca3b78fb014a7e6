"""One box in one colour: the task of a worker, and its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.boxes import ChannelFrame, Place
from labkit.edges.camera import Camera
from labkit.edges.comparison import Comparison, compare, fitted_mean
from labkit.edges.defocus_sides import sides_of
from labkit.edges.edge_fit import EXACTLY, ROUGHLY, EdgeFit, EdgeProblem
from labkit.edges.esfr import LATEST, Esfr, Plane, esfr
from labkit.edges.first_fits import (
    RoughEdge,
    fit_depth,
    halves,
    refuse_structure,
    rough_edge,
)
from labkit.edges.other_blur import Measured, find_blur, fit_with_blur
from labkit.edges.ranges import Side
from labkit.edges.region import Region
from labkit.edges.response import Response, fitted_response
from labkit.edges.side_noise import noise_of_sides
from labkit.errors import DataError, FitError
from labkit.estimation.climb import NoisePrior

DIFFERENT = 6.0  # standard errors between the defoci of an edge's halves
DIFFERENT_WAVES = 0.08  # at least, waves RMS
DIFFERENT_SHARE = 0.1  # at least, of the defocus
REMOVED = 0.5  # of a contradiction, at most, that another blur leaves
MOST_LEFT = 0.06  # of the step: what residuals share with their neighbours, RMS
SINGULAR = "it holds no edge that can be fitted: the information is singular"


@dataclass(frozen=True)
class BoxTask:
    """A box in one colour.

    Attributes
    ----------
    place, camera : the box, and the camera in this colour
    regions : one for each frame
    planes : samples of the first frame for ISO 12233; empty if some are clipped
    edition : of the standard
    noises : of each frame, by the sides of the edge; empty before they are measured
    """

    place: Place
    camera: Camera
    regions: tuple[Region, ...]
    planes: tuple[Plane, ...]
    edition: int = LATEST
    noises: tuple[NoisePrior, ...] = ()

    @classmethod
    def of(
        cls,
        frames: Sequence[ChannelFrame],
        camera: Camera,
        place: Place,
        edition: int = LATEST,
    ) -> BoxTask:
        """Return the task of one box in all frames. Raises DataError for too few pixels."""
        regions = tuple(of.region(place, j) for j, of in enumerate(frames))
        # rounding adds to the read noise
        rounding = float(np.mean(frames[0].read(place).rounding))
        read_variance = camera.noise.read_variance + rounding
        noise = replace(camera.noise, read_variance=read_variance)
        camera = replace(camera, noise=noise)
        return cls(place, camera, regions, frames[0].planes(place), edition)

    @property
    def problem(self) -> EdgeProblem:
        """All frames of the box, of one depth."""
        camera = self.camera
        noises = self.noises or (camera.noise,) * len(self.regions)
        return EdgeProblem((camera.optics,), self.regions, noises, camera.lens)

    def measured(self) -> tuple[Esfr | None, str]:
        """Return the response by ISO 12233, and why it or its MTF50 is missing."""
        if not self.planes:
            return None, "clipped pixels are in the box"
        try:
            found = esfr(self.planes, self.camera.optics.pitch_um, self.edition)
        except DataError as error:
            return None, str(error)
        return found, found.problem

    def with_noise(self, rough: Sequence[RoughEdge]) -> BoxTask:
        """Return the task with the noise that both sides of each rough edge have."""
        noises = tuple(noise_of_sides(of, self.camera.noise) for of in rough)
        return replace(self, noises=noises)


@dataclass(frozen=True)
class BoxFit:
    """The fit of a box in one colour.

    Attributes
    ----------
    task : the box
    ends : ends of its fit, or of a fit with other boxes, the likeliest first; empty if the box was rejected
    sides : sides of best focus that it may be on, that of the fit first
    why : why it was rejected
    iso, iso_problem : response by ISO 12233; why it or its MTF50 is missing
    first, depth : places of the box's first region and of its defocus in the fit
    comparison : of the response by ISO 12233 with the fit's; None where there is none
    cause : of a blur that no wavefront makes, in words, empty without one
    """

    task: BoxTask
    ends: tuple[EdgeFit, ...] = ()
    sides: tuple[Side, ...] = ()
    why: str = ""
    iso: Esfr | None = None
    iso_problem: str = ""
    first: int = 0
    depth: int = 0
    comparison: Comparison | None = None
    cause: str = ""

    def compared(self) -> BoxFit:
        """Return the box with its fit compared with its response by ISO 12233."""
        task = self.task
        if self.iso is None or not self.ends:
            return self
        mean = fitted_mean(self.fit, self.first, task.place.slices)
        comparison = compare(task.planes, self.iso, mean, task.camera.optics.pitch_um)
        return replace(self, comparison=comparison)

    @property
    def chi2_per_pixel(self) -> float:
        """χ² per pixel against the camera's noise."""
        places = range(self.first, self.first + len(self.task.regions))
        residuals = np.concatenate([self.fit.residuals(k) for k in places])
        return float(np.mean(residuals**2))

    @property
    def contradicted(self) -> bool:
        """Return whether the photograph shows another response than the fit."""
        return self.comparison is not None and self.comparison.contradicts

    @property
    def response(self) -> Response:
        """The fitted response, with what the photograph's has more where the model contradicts it.

        Residuals beyond the camera's noise enlarge its errors by the root of χ².
        """
        fitted = fitted_response(self.fit, self.first)
        fitted = fitted.enlarged(max(1.0, np.sqrt(self.chi2_per_pixel)))
        if self.comparison is None or not self.contradicted:
            return fitted
        return self.comparison.corrected(fitted)

    @property
    def fit(self) -> EdgeFit:
        """The likeliest end."""
        return self.ends[0]

    @property
    def channel(self) -> str:
        """Name of the colour."""
        return self.task.camera.channel


def fit_box(task: BoxTask) -> BoxFit:
    """Fit a box. A rejected box has its reason, and its response by ISO 12233 if it holds an edge."""
    box = BoxFit(task)
    try:
        rough = [rough_edge(region) for region in task.regions]
        for of in rough:
            of.refuse_no_edge()
        iso, problem = task.measured()
        box = replace(box, iso=iso, iso_problem=problem)
        rough = [of.with_shape() for of in rough]
        for of in rough:
            of.refuse_uneven()
        task = task.with_noise(rough)
        ends = fit_depth(task.problem, rough, EXACTLY if task.camera.given else ROUGHLY)
        box = _with_other_blur(replace(box, task=task, ends=ends))
        ends = box.ends
        _refuse_contradiction(ends[0])
        sides = sides_of(ends) if task.camera.given else ()
    except (DataError, FitError) as error:
        return replace(box, ends=(), why=str(error))
    except np.linalg.LinAlgError:
        return replace(box, ends=(), why=SINGULAR)
    return replace(box, sides=sides)


def _with_other_blur(box: BoxFit) -> BoxFit:
    """Return a box with the kind of blur that its response calls for beside the lens's."""
    box = replace(box, task=replace(box.task, regions=box.fit.problem.regions)).compared()
    if box.comparison is None or not box.contradicted:
        return box
    measured = Measured.of(box.fit, box.comparison)
    other = find_blur(measured, box.fit.defocus()[0])
    if other is None:
        return box
    ends = fit_with_blur(box.ends, other)
    task = replace(box.task, regions=ends[0].problem.regions)
    fitted = replace(box, task=task, ends=ends).compared()
    # a cause is named only where its blur removes most of the contradiction
    if fitted.comparison is None or fitted.comparison.pull > REMOVED * box.comparison.pull:
        return box
    return replace(fitted, cause=other.cause)


def _refuse_contradiction(fit: EdgeFit) -> None:
    """Raise DataError for residuals that contradict one straight edge at one depth."""
    if parts := halves(fit):
        (one, one_std), (other, other_std) = (part.defocus() for part in parts)
        share = DIFFERENT_SHARE * max(abs(one), abs(other))
        allowed = max(DIFFERENT * np.hypot(one_std, other_std), DIFFERENT_WAVES, share)
        if abs(one - other) > allowed:
            raise DataError(
                f"it holds edges at different depths: its halves are out of focus by {one:.3f} ± {one_std:.3f} and "
                f"{other:.3f} ± {other_std:.3f} waves; take a box for each"
            )
    region = fit.problem.regions[0]
    of, _ = fit.problem.slopes(fit.state, 0)
    left = region.counts - of.mean
    refuse_structure(region, fit.state.edge(0), left, "the fit leaves", MOST_LEFT)
