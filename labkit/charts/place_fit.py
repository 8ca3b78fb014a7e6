"""The joint fit of all edges at one place of the frame, in one channel: one wavefront, a defocus for each photograph.

An edge shows defocus and astigmatism along its normal only, and of both together the size: a place starts from each
pattern of signs that the edges' own defoci allow, and the likeliest end is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.charts.chart_edges import Cell
from labkit.edges.box_fit import BoxFit, BoxTask, fit_box
from labkit.edges.camera import Camera
from labkit.edges.common_fits import joint_problem
from labkit.edges.comparison import Comparison
from labkit.edges.edge_fit import ROUGHLY, EdgeFit, EdgeProblem, LensPrior, fit_edges
from labkit.edges.esfr import Esfr
from labkit.edges.response import Response
from labkit.imaging.optics import Optics
from labkit.optics.zernike import noll_to_nm
from labkit.types import Floats

ASTIGMATIC = (5, 6)
FIELD_MODE_STD = {2: 0.2, 3: 0.1}
"""Waves RMS by radial order, of the prior at a place of the field; USUAL_MODE_STD for higher orders."""

START_STEPS = 21  # of each number that starts a fit
MODEL_WAVES = 0.03  # RMS that a single edge's own defocus may be wrong by, its other modes being unknown
MODEL_SHARE = 0.05  # the same, relative
MOST_PATTERNS = 3
UNLIKELY = 50.0  # chi-squared above the best start's


@dataclass(frozen=True)
class PlaceTask:
    """The edges of a place in one channel.

    Attributes
    ----------
    cell, camera : the place in the grid, and the camera in this channel
    boxes : the edges
    photograph : of each edge
    law_waves : (photographs,) defocus of each by the lens's law, of a common zero
    """

    cell: Cell
    camera: Camera
    boxes: tuple[BoxTask, ...]
    photograph: tuple[int, ...]
    law_waves: Floats


@dataclass(frozen=True)
class EdgeResponse:
    """An edge of the place.

    Attributes
    ----------
    photograph : its number
    middle_px : (row, column)
    angle_deg : of its normal, from x (right) towards y (down)
    length_px : of the line within its region
    fitted, iso : responses by the fit and by ISO 12233
    chi2_per_pixel : of the fit, against the camera's noise
    comparison : of its response by ISO 12233 with the joint fit's, where they contradict each other; None otherwise
    cause : of a blur that no lens makes, in words, empty without one
    """

    photograph: int
    middle_px: tuple[float, float]
    angle_deg: float
    length_px: float
    fitted: Response
    iso: Esfr | None
    chi2_per_pixel: float
    comparison: Comparison | None = None
    cause: str = ""


@dataclass(frozen=True)
class PlaceFit:
    """A fitted place, or why its edges could not be fitted.

    Attributes
    ----------
    cell, optics, channel : the place in the grid, and the camera there
    edges : fitted edges
    rejected : a sentence for each edge without a fit
    photographs : (depths,) numbers of those with fitted edges
    law_waves : (depths,) defocus of each by the lens's law
    waves, covariance : (depths + modes,) defoci and the other modes, waves RMS; its covariance
    """

    cell: Cell
    optics: Optics
    channel: str
    edges: tuple[EdgeResponse, ...] = ()
    rejected: tuple[str, ...] = ()
    photographs: tuple[int, ...] = ()
    law_waves: Floats = field(default_factory=lambda: np.zeros(0))
    waves: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def wavefront(self, depth: int) -> tuple[Floats, Floats]:
        """Return the modes (modes,) of one photograph, defocus first, and their covariance."""
        at = np.r_[depth, len(self.photographs) : self.waves.size]
        return self.waves[at], self.covariance[np.ix_(at, at)]


def place_prior(noll: Sequence[int]) -> LensPrior:
    """Return the prior of the modes but defocus (Noll's numbers) of an unknown lens away from its axis."""
    usual = LensPrior.unknown(len(noll))
    std = [
        FIELD_MODE_STD.get(noll_to_nm(j)[0], usual.covariance[k, k] ** 0.5)
        for k, j in enumerate(noll)
    ]
    return LensPrior(usual.mean, np.diag(np.square(std)))


def fit_place(task: PlaceTask) -> PlaceFit:
    """Fit all edges of a place together."""
    boxes = [fit_box(box) for box in task.boxes]
    fitted = [k for k, of in enumerate(boxes) if of.ends]
    rejected = tuple(of.why for of in boxes if not of.ends)
    empty = PlaceFit(task.cell, task.camera.optics, task.camera.channel, rejected=rejected)
    if not fitted:
        return empty
    photographs = sorted({task.photograph[k] for k in fitted})
    depths = [photographs.index(task.photograph[k]) for k in fitted]
    law = task.law_waves[photographs]
    known = [boxes[k] for k in fitted]
    problem, placed = joint_problem(known, depths)
    # what no lens makes is in no direction but its own: the place has the lens, and each edge what it shows more
    regions = tuple(replace(region, blur=None) for region in problem.regions)
    problem = replace(problem, regions=regions, lens=place_prior(problem.noll[1:]))
    try:
        joint = _likeliest(problem, known, law)
    except np.linalg.LinAlgError:
        return replace(
            empty, rejected=(*rejected, *("the information is singular" for _ in known))
        )
    edges = tuple(
        _edge(joint, replace(of, ends=(joint,)).compared(), task.photograph[k])
        for k, of in zip(fitted, placed, strict=True)
    )
    places = joint.state.places
    at = np.append(places.defoci, places.modes)
    return replace(
        empty,
        edges=edges,
        photographs=tuple(photographs),
        law_waves=law,
        waves=np.append(joint.state.defoci, joint.state.modes),
        covariance=joint.among(at),
    )


def _edge(joint: EdgeFit, of: BoxFit, photograph: int) -> EdgeResponse:
    """Return an edge of a joint fit."""
    edge = joint.state.edge(of.first)
    region = joint.problem.regions[of.first]
    _, along = region.across_and_along(edge)
    row, column = region.centre
    middle = (
        row + edge.distance_px * np.sin(edge.angle),
        column + edge.distance_px * np.cos(edge.angle),
    )
    return EdgeResponse(
        photograph,
        middle,
        float(np.degrees(edge.towards_light.angle)),
        float(np.ptp(along)),
        of.response,
        of.iso,
        of.chi2_per_pixel,
        of.comparison if of.contradicted else None,
        of.cause,
    )


def _likeliest(problem: EdgeProblem, boxes: Sequence[BoxFit], law: Floats) -> EdgeFit:
    """Return the likeliest end of the joint fit over the patterns of signs."""
    edges = np.concatenate([of.fit.state.edges for of in boxes])
    noise = np.median([of.fit.state.log_noise for of in boxes], axis=0)
    ends = []
    for defoci, astigmatism in _starts(problem, boxes, law):
        start = problem.start(defoci, edges, noise)
        for mode, waves in zip(ASTIGMATIC, astigmatism, strict=True):
            if mode in problem.noll:
                start.modes[problem.noll.index(mode) - 1] = waves
        ends.append(fit_edges(problem, start, ROUGHLY))
    best = max(ends, key=lambda end: end.objective)
    return fit_edges(problem, best.state)


def _starts(
    problem: EdgeProblem, boxes: Sequence[BoxFit], law: Floats
) -> list[tuple[Floats, Floats]]:
    """Return defoci (depths,) and astigmatism (2,) of the likeliest patterns of signs, by the edges' own defoci."""
    own, std = np.transpose([of.fit.defocus() for of in boxes])
    own = np.abs(own)
    error = np.sqrt(np.minimum(std, 1.0) ** 2 + MODEL_WAVES**2 + (MODEL_SHARE * own) ** 2)
    angle = np.array([of.fit.state.edge(0).angle for of in boxes])
    depth = [region.depth for region in problem.regions]
    most = own.max() + np.ptp(law) + MODEL_WAVES
    trial = np.linspace(-most, most, START_STEPS)
    numbers = np.stack(np.meshgrid(trial, trial, trial, indexing="ij")).reshape(3, -1)
    # Noll 5 and 6 along an azimuth act as a defocus
    astigmatic = np.sqrt(0.5) * np.array([np.sin(2 * angle), np.cos(2 * angle)])
    rows = np.vstack([np.ones_like(angle), astigmatic])
    signed = law[depth] + numbers.T @ rows
    misfit = (((np.abs(signed) - own) / error) ** 2).sum(axis=1)
    misfit += (numbers[1:] ** 2).sum(axis=0) / FIELD_MODE_STD[2] ** 2
    if not law.any():  # of one photograph the reverse is the same
        misfit = np.where(numbers[0] < 0, np.inf, misfit)
    found: dict[bytes, tuple[Floats, Floats]] = {}
    for k in np.argsort(misfit):
        if len(found) == MOST_PATTERNS or misfit[k] > misfit.min() + UNLIKELY:
            break
        pattern = (signed[k] > 0).tobytes()
        offset = numbers[0, k]
        defoci = law + np.where(offset == 0, MODEL_WAVES, offset)
        found.setdefault(pattern, (defoci, numbers[1:, k]))
    return [*found.values()]
