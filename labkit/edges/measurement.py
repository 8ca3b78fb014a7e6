"""Photographs of a scene to ranges of its edges and responses across them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.analysis.measured_camera import check_same_camera
from labkit.edges.box_fit import BoxFit, BoxTask, box_task, fit_box
from labkit.edges.boxes import ChannelFrame, Place, checked_box, read_frames
from labkit.edges.camera import Camera, camera_of, focus_law
from labkit.edges.common_fits import Fits, contradictions, correlation, in_common
from labkit.edges.edge_fit import EdgeFit
from labkit.edges.esfr import Esfr
from labkit.edges.found_edges import Box
from labkit.edges.outcome import ChannelEdge, EdgesOutcome, MeasuredEdge, RejectedEdge
from labkit.edges.ranges import AS_LIKELY, EdgeRange, FocusLaw, edge_range
from labkit.edges.response import fitted_response
from labkit.errors import DataError
from labkit.execute import Workers, default_workers
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, leading_channel
from labkit.results import Results
from labkit.types import Floats, Progress, no_progress
from labkit.uncertain import Uncertain

MOST_EDGES = 60
NEAR_LINE_PX = 3  # pixels as near to a line show how far it extends


@dataclass(frozen=True)
class Scene:
    """Photographs of a scene, and their camera.

    Attributes
    ----------
    images : frames of one scene, the camera at rest
    plan : the camera
    results : of a session with the same lens and aperture, for its wavefront and best focus; None: the wavefront is
        estimated with the edges
    boxes : R0,C0,R1,C1 of the raw; if empty, edges are searched for
    focus_mm : range at which the lens is focused, in place of the session's
    channels : only these
    one_range : whether all edges are at the same range
    most : number of edges to search for
    force : accept a session of another camera
    """

    images: Sequence[Path]
    plan: Plan
    results: Results | None = None
    boxes: Sequence[Box] = ()
    focus_mm: Uncertain | None = None
    channels: Sequence[str] | None = None
    one_range: bool = False
    most: int = MOST_EDGES
    force: bool = False


def measure_edges(
    images: Path | str | Sequence[Path | str],
    plan: Plan | Path | str,
    *,
    psf: Results | Path | str | None = None,
    boxes: Sequence[Box] = (),
    focus_mm: Uncertain | None = None,
    channels: Sequence[str] | None = None,
    one_range: bool = False,
    most: int = MOST_EDGES,
    force: bool = False,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> EdgesOutcome:
    """Measure straight edges of a scene: their ranges, and the camera's response across them.

    Parameters
    ----------
    images : one photograph, or several of one scene with the camera at rest
    plan : the photographs' plan, or its path
    psf : results, or their folder, of a session with the same lens and aperture, whose
        wavefront and best focus are taken; None to fit the wavefront along
    boxes : (first row, first column, row and column after the last) around each edge, in
        raw pixels; none to search for edges
    focus_mm : range that the lens is focused at, in place of the session's
    channels : channels to measure; None for all
    one_range : whether all edges are at one range
    most : largest number of edges that are searched for
    force : whether to take a session of another camera
    workers : number of processes, by default one for each core
    progress : called as the work goes on

    Returns
    -------
    the edges, and boxes that give no edge with the reasons

    Raises
    ------
    RawError, DataError
        of photographs and sessions that cannot be used, and where no edge is found

    >>> labkit.measure_edges("chart.dng", "plan.toml", psf="night-3").edges
    """
    given = [images] if isinstance(images, Path | str) else images
    results = psf if psf is None or isinstance(psf, Results) else Results.load(psf)
    scene = Scene(
        [Path(image) for image in given],
        plan if isinstance(plan, Plan) else Plan.load(Path(plan)),
        results,
        boxes,
        focus_mm,
        channels,
        one_range,
        most,
        force,
    )
    return edges_of(scene, workers, progress)


def edges_of(
    scene: Scene, workers: int | None = None, progress: Progress = no_progress
) -> EdgesOutcome:
    """Measure the ranges of a scene's edges, and the camera's response across them, by a fit and by ISO 12233.

    Parameters
    ----------
    scene : the photographs
    workers : number of processes; None for one a core
    progress : called with the step under way

    Returns
    -------
    measured edges, and boxes without an edge

    Raises
    ------
    RawError, DataError : a photograph cannot be used
    """
    photographs = read_frames(scene.images, scene.plan)
    names = _channels(photographs[0], scene)
    law, warnings = _law(photographs[0], scene, names)
    places, rejected = _places(photographs[0], names, scene)
    focused = None if law is None else float(np.mean(law.focus_mm))
    cameras = {
        name: camera_of(scene.plan, name, scene.results, photographs[0].full_light, focused)
        for name in names
    }
    fits, refused = _fitted(photographs, cameras, places, workers, progress)
    rejected += refused
    if scene.one_range:
        for place, words in contradictions(fits).items():
            gone = fits.pop(place)
            iso = {name: of.iso for name, of in gone.items() if of.iso is not None}
            rejected.append(RejectedEdge(place.box, words, iso))
    fits = in_common(fits, scene.one_range)
    edges = [_measured(place, fits[place], law) for place in places if place in fits]
    warnings += [words for edge in edges for words in edge.disagreements]
    wavefront = _wavefront(fits) if scene.results is None else {}
    return EdgesOutcome(tuple(edges), tuple(rejected), tuple(warnings), wavefront)


def _channels(photograph: Photograph, scene: Scene) -> tuple[str, ...]:
    """Return the requested channels, or all of plan, photograph and session. Raises DataError."""
    known = [c.name for c in scene.plan.channel if photograph.has(c.name)]
    if absent := [name for name in scene.channels or () if name not in known]:
        raise DataError(f"channel {', '.join(absent)}: allowed are {', '.join(known)}")
    fitted = known if scene.results is None else scene.results.channels
    wanted = scene.channels or fitted
    return tuple(name for name in known if name in wanted) or tuple(known)


def _law(
    photograph: Photograph, scene: Scene, names: tuple[str, ...]
) -> tuple[FocusLaw | None, list[str]]:
    """Return the lens's law if its focus is known, and warnings. Raises DataError for a session of another camera."""
    warnings = [note.text for note in photograph.notes]
    if scene.results is not None:
        warnings += check_same_camera(
            scene.results, scene.plan, names, photograph.camera, force=scene.force
        )
    law = focus_law(scene.plan, scene.results, names, scene.focus_mm)
    if law is None:
        warnings.append(
            "ranges are not determined: give --psf SESSION with a best focus, or --focus MM"
        )
    return law, list(dict.fromkeys(warnings))


def _places(
    photograph: Photograph, names: Sequence[str], scene: Scene
) -> tuple[list[Place], list[RejectedEdge]]:
    """Return usable boxes and the others, or found edges. Raises DataError if none is found."""
    if not scene.boxes:
        channel = ChannelFrame.of(photograph, leading_channel(names))
        places = channel.find_places(scene.most)
        if not places:
            raise DataError(
                f"{scene.images[0]}: no straight edge between two even sides was found; give one with --box"
            )
        return places, []
    problems = {box: checked_box(box, photograph.shape) for box in scene.boxes}
    rejected = [RejectedEdge(box, why) for box, why in problems.items() if why is not None]
    return [Place(box) for box, why in problems.items() if why is None], rejected


def _fitted(
    photographs: list[Photograph],
    cameras: dict[str, Camera],
    places: Sequence[Place],
    workers: int | None,
    progress: Progress,
) -> tuple[Fits, list[RejectedEdge]]:
    """Fit each box in each channel; boxes that give no fit in most channels are rejected."""
    tasks: list[BoxTask] = []
    fits: Fits = {place: {} for place in places}
    why: dict[Place, list[str]] = {place: [] for place in places}
    iso: dict[Place, dict[str, Esfr]] = {place: {} for place in places}
    frames = {name: [ChannelFrame.of(of, name) for of in photographs] for name in cameras}
    for place in places:
        for name, camera in cameras.items():
            try:
                tasks.append(box_task(frames[name], camera, place))
            except DataError as error:
                why[place].append(str(error))
    with Workers(min(workers or default_workers(), max(len(tasks), 1))) as run:
        progress(0, len(tasks), "fitting edges")
        for done, (index, fit) in enumerate(run(fit_box, tasks)):
            place = tasks[index].place
            name = tasks[index].camera.channel
            if fit.iso is not None:
                iso[place][name] = fit.iso
            if fit.ends:
                fits[place][name] = fit
            else:
                why[place].append(fit.why)
            progress(done + 1, len(tasks), "fitting edges")
    kept = {place: of for place, of in fits.items() if of and len(of) >= len(why[place])}
    rejected = [place for place in places if place not in kept]
    return kept, [RejectedEdge(at.box, why[at][0], iso[at]) for at in rejected]


def _measured(place: Place, fits: dict[str, BoxFit], law: FocusLaw | None) -> MeasuredEdge:
    """Return an edge in all colours that gave a fit."""
    where = EdgeRange(Uncertain(np.nan, np.nan, "mm"), None)
    known = {name: of for name, of in fits.items() if law and name in law.channels}
    if law is not None and known:
        sides = [(name, of.sides) for name, of in known.items()]
        where = edge_range(law, sides, correlation([*known.values()]))
    first = next(iter(fits.values()))
    return MeasuredEdge(
        place.box,
        _line(first.fit, first.first),
        where.range_mm,
        where.other,
        tuple(_channel_edge(name, of) for name, of in fits.items()),
    )


def _channel_edge(name: str, of: BoxFit) -> ChannelEdge:
    """Return an edge in one colour."""
    edge = of.fit.state.edge(of.first)
    error = of.fit.edge_std(of.first)
    bright = edge.towards_light
    near, far = error[2:] if edge.far >= edge.near else error[:1:-1]
    residuals = np.concatenate(
        [of.fit.residuals(of.first + j) for j in range(len(of.task.regions))]
    )
    least = max(side.log_likelihood for side in of.sides) - AS_LIKELY / 2
    foci = [
        Uncertain(side.defocus, side.std, "waves")
        for k, side in enumerate(of.sides)
        if k == 0 or side.log_likelihood > least
    ]
    return ChannelEdge(
        name,
        foci[0],
        foci[1] if len(foci) > 1 else None,
        Uncertain(np.degrees(bright.angle), np.degrees(error[0]), "deg"),
        Uncertain(bright.near, near, "counts"),
        Uncertain(bright.far, far, "counts"),
        float(np.mean(residuals**2)),
        residuals.size,
        fitted_response(of.fit, of.first),
        of.iso,
        of.iso_problem,
    )


def _line(fit: EdgeFit, k: int) -> Floats:
    """Return the ends (2, 2) of a line within its region, (row, column)."""
    region = fit.problem.regions[k]
    edge = fit.state.edge(k)
    across, along = region.across_and_along(edge)
    sine = np.sin(edge.angle)
    cosine = np.cos(edge.angle)
    foot = np.array(region.centre) + edge.distance_px * np.array([sine, cosine])
    near = along[np.abs(across) < NEAR_LINE_PX]
    ends = (near.min(), near.max()) if near.size else (0.0, 0.0)
    return foot + np.outer(ends, [cosine, -sine])


def _wavefront(fits: Fits) -> dict[int, Uncertain]:
    """Return the modes but defocus, estimated with the edges."""
    if not fits:
        return {}
    fit = next(iter(next(iter(fits.values())).values())).fit
    std = np.sqrt(np.diag(fit.covariance))
    modes = zip(fit.problem.noll[1:], fit.state.modes, std, strict=False)
    return {j: Uncertain(float(v), float(s), "waves") for j, v, s in modes}
