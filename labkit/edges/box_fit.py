"""One box in one colour: what travels to a worker, and what comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.edges.boxes import ChannelFrame, Place
from labkit.edges.camera import Camera
from labkit.edges.esfr import Esfr, Plane, esfr
from labkit.edges.joint import EXACTLY, ROUGHLY, EdgeFit, EdgeProblem
from labkit.edges.profile import sides_of
from labkit.edges.ranges import Side
from labkit.edges.region import Region
from labkit.edges.search import (
    coherent_rms,
    fit_depth,
    halves,
    refuse_no_edge,
    refuse_uneven,
    rough_edge,
)
from labkit.errors import DataError, FitError

DIFFERENT = 6.0  # standard errors of a difference of defocus between an edge's halves
DIFFERENT_WAVES, DIFFERENT_SHARE = (
    0.08,
    0.1,
)  # of it, at least: waves RMS, and share of the defocus
MOST_LEFT = 0.06  # of the step: what residuals have in common with their neighbours, RMS


@dataclass(frozen=True)
class BoxTask:
    """Regions of one box, a frame each, and the first frame's planes; none where ISO 12233 cannot be applied, and why."""

    place: Place
    camera: Camera
    regions: tuple[Region, ...]
    rounding_variance: float
    planes: tuple[Plane, ...]
    iso_problem: str

    @property
    def problem(self) -> EdgeProblem:
        """All frames of the box, one depth."""
        noise = self.camera.noise
        noise = replace(noise, read_variance=noise.read_variance + self.rounding_variance)
        return EdgeProblem(
            (self.camera.optics,),
            self.regions,
            (noise,) * len(self.regions),
            self.camera.lens,
        )


@dataclass(frozen=True)
class BoxFit:
    """ends: of the fit, the likelier first; none where the box was rejected, and why. sides: of best focus, on which it may
    stand, where the wavefront is given."""

    task: BoxTask
    ends: tuple[EdgeFit, ...] = ()
    sides: tuple[Side, ...] = ()
    why: str = ""
    iso: Esfr | None = None
    iso_problem: str = ""


def box_task(frames: Sequence[ChannelFrame], camera: Camera, place: Place) -> BoxTask:
    """Return the task of one box in all frames. Raises DataError for too few pixels."""
    regions = tuple(of.region(place, j) for j, of in enumerate(frames))
    planes, problem = tuple[Plane, ...](), ""
    try:
        planes = tuple(frames[0].planes(place))
    except DataError as error:
        problem = str(error)
    rounding = float(np.mean(frames[0].rounding[place.slices]))
    return BoxTask(place, camera, regions, rounding, planes, problem)


def fit_box(task: BoxTask) -> BoxFit:
    """Do it. What cannot be fitted comes back with its reason, and with its response by ISO 12233 if it has an edge."""
    rough = []
    try:
        for region in task.regions:
            rough.append(rough_edge(region))
            refuse_no_edge(region, rough[-1])
    except DataError as error:
        return BoxFit(task, why=str(error))
    iso, problem = _by_the_standard(task)
    try:
        for region, found in zip(task.regions, rough, strict=True):
            refuse_uneven(region, found)
        ends = fit_depth(task.problem, rough, EXACTLY if task.camera.given else ROUGHLY)
        _refuse_contradiction(ends[0])
        sides = sides_of(ends) if task.camera.given else ()
    except (DataError, FitError) as error:
        return BoxFit(task, why=str(error), iso=iso, iso_problem=problem)
    except np.linalg.LinAlgError:
        why = "it holds no edge that can be fitted: the information is singular"
        return BoxFit(task, why=why, iso=iso, iso_problem=problem)
    return BoxFit(task, ends, sides, iso=iso, iso_problem=problem)


def _by_the_standard(task: BoxTask) -> tuple[Esfr | None, str]:
    """The response by ISO 12233, and why it or its MTF50 is lacking."""
    if not task.planes:
        return None, task.iso_problem
    try:
        found = esfr(task.planes, task.camera.optics.pitch_um)
    except DataError as error:
        return None, str(error)
    return found, found.problem


def _refuse_contradiction(fit: EdgeFit) -> None:
    """Raise DataError where an edge's residuals contradict one straight edge at one depth."""
    parts = halves(fit)
    if parts is not None:
        (one, one_std), (other, other_std) = (part.defocus() for part in parts)
        apart, std = abs(one - other), float(np.hypot(one_std, other_std))
        if apart > max(
            DIFFERENT * std, DIFFERENT_WAVES, DIFFERENT_SHARE * max(abs(one), abs(other))
        ):
            raise DataError(
                f"it holds edges at different depths: its halves are out of focus by {one:.3f} ± {one_std:.3f} and "
                f"{other:.3f} ± {other_std:.3f} waves; take a box for each"
            )
    region, edge = fit.problem.regions[0], fit.state.edge(0)
    of, _ = fit.problem.slopes(fit.state, 0)
    left = coherent_rms(region, edge, region.counts - of.mean) / abs(edge.far - edge.near)
    if left > MOST_LEFT:
        raise DataError(
            f"it holds no straight edge between two even sides: what the fit leaves varies by {left:.0%} of the step, at "
            f"most {MOST_LEFT:.0%} is allowed; take a smaller box"
        )
