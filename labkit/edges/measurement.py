"""Photographs of a scene to ranges of its edges and responses across them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from labkit.analysis.measured_camera import check_same_camera
from labkit.edges.box_fit import BoxFit, BoxTask, fit_box
from labkit.edges.boxes import ChannelFrame, Place, read_frames
from labkit.edges.camera import Camera, camera_of, focus_law
from labkit.edges.common_fits import (
    contradictions,
    correlation,
    in_common,
    name_motion,
)
from labkit.edges.edge_fit import EdgeFit
from labkit.edges.esfr import EDITIONS, LATEST, Esfr
from labkit.edges.found_edges import Box
from labkit.edges.outcome import ChannelEdge, EdgesOutcome, MeasuredEdge, RejectedEdge
from labkit.edges.ranges import AS_LIKELY, EdgeRange, FocusLaw, edge_range
from labkit.errors import DataError
from labkit.findings.findings import Finding, each_once, found
from labkit.jobs.execute import Workers, default_workers
from labkit.jobs.threads import one_thread
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, leading_channel
from labkit.results import Results
from labkit.types import Floats, Progress, no_progress
from labkit.uncertain import Uncertain

MOST_EDGES = 60
NEAR_LINE_PX = 3  # pixels as near to a line show how far it extends
FINDING = "finding edges"
STEP = "fitting edges"


@one_thread
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
    edition: int = LATEST,
    force: bool = False,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> EdgesOutcome:
    """Measure straight edges of a scene: their ranges, and the camera's response across them.

    Parameters
    ----------
    images : a photograph, or several of the same scene with the camera at rest
    plan : the photographs' plan, or its path
    psf : results, or their folder, of a session with the same lens and aperture, whose
        wavefront and best focus are taken; None to fit the wavefront along
    boxes : (first row, first column, row and column after the last) around each edge, in
        raw pixels; none to search for edges
    focus_mm : the lens's best focus, in place of the session's
    channels : channels to measure; None for all
    one_range : whether all edges are at the same range
    most : largest number of edges in a search
    edition : of ISO 12233 for the e-SFR: 2023 or 2017
    force : whether to take a session of another camera
    workers : number of processes, by default as many as cores
    progress : called as the work goes on

    Returns
    -------
    the edges, and boxes without an edge with the reasons

    Raises
    ------
    RawError, DataError
        of unusable photographs and sessions, and without any edge

    >>> labkit.measure_edges("chart.dng", "plan.toml", psf="night-3").edges
    """
    _refuse_edition(edition)
    paths = [images] if isinstance(images, Path | str) else images
    plan = plan if isinstance(plan, Plan) else Plan.load(Path(plan))
    results = psf if psf is None or isinstance(psf, Results) else Results.load(psf)
    progress(0, 0, FINDING)
    photographs = read_frames([Path(path) for path in paths], plan)
    first = photographs[0]
    names = measured_channels(first, plan, channels, results)
    findings = [*first.notes]
    if results is not None:
        wrong = check_same_camera(results, plan, names, first.camera, force=force)
        findings += [found("psf-of-another-camera", difference=words) for words in wrong]
    law = focus_law(plan, results, names, focus_mm)
    if law is None:
        findings.append(found("ranges-not-determined"))
    places = [Place(box) for box in dict.fromkeys(boxes)]
    if not places:
        places = _found_places(
            ChannelFrame.of(first, leading_channel(names)), most, paths[0]
        )
    focused = None if law is None else float(np.mean(law.focus_mm))
    cameras = [camera_of(plan, name, results, first.full_light, focused) for name in names]
    every, why = _fitted(photographs, cameras, places, edition, workers, progress)
    fits = [of for of in every if of.ends and of.task.place not in why]
    if one_range:
        why |= contradictions(fits)
    fits = [of for of in fits if of.task.place not in why]
    fits = name_motion(in_common(fits, one_range))
    known = [[of for of in fits if of.task.place == place] for place in places]
    edges = tuple(_measured(of, law) for of in known if of)
    findings += _disagreements(edges)
    wavefront = _common_wavefront(fits) if results is None else {}
    findings += _apart(fits, wavefront) if results is None else []
    return EdgesOutcome(edges, _rejected(every, why), tuple(each_once(findings)), wavefront)


def _found_places(frame: ChannelFrame, most: int, path: Path | str) -> list[Place]:
    """Find edges. Raises DataError, which names the photograph's path, for none."""
    places = frame.find_places(most)
    if not places:
        raise DataError(
            f"{path}: no straight edge between two even sides was found; give one with --box"
        )
    return places


def _refuse_edition(edition: int) -> None:
    """Raise DataError for an edition that is not known."""
    if edition not in EDITIONS:
        allowed = ", ".join(map(str, EDITIONS))
        raise DataError(f"edition {edition} of ISO 12233: allowed are {allowed}")


def measured_channels(
    photograph: Photograph,
    plan: Plan,
    requested: Collection[str] | None,
    results: Results | None = None,
) -> tuple[str, ...]:
    """Return the requested channels, or all of plan, photograph and session. Raises DataError."""
    known = [c.name for c in plan.channel if photograph.has(c.name)]
    if absent := [name for name in requested or () if name not in known]:
        raise DataError(f"channel {', '.join(absent)}: allowed are {', '.join(known)}")
    wanted = requested or (known if results is None else results.channels)
    return tuple(name for name in known if name in wanted) or tuple(known)


def _fitted(
    photographs: Sequence[Photograph],
    cameras: Sequence[Camera],
    places: Sequence[Place],
    edition: int,
    workers: int | None,
    progress: Progress,
) -> tuple[list[BoxFit], dict[Place, str]]:
    """Fit each box in each channel; return also the boxes without a fit in most channels, and why."""
    tasks: list[BoxTask] = []
    faults: dict[Place, list[str]] = {place: [] for place in places}
    for camera in cameras:
        frames = [ChannelFrame.of(of, camera.channel) for of in photographs]
        for place in places:
            try:
                tasks.append(BoxTask.of(frames, camera, place, edition))
            except DataError as error:
                faults[place].append(str(error))
    tasks.sort(key=lambda task: places.index(task.place))
    fits: dict[int, BoxFit] = {}
    with Workers(min(workers or default_workers(), max(len(tasks), 1))) as run:
        progress(0, len(tasks), STEP)
        for index, fit in run(fit_box, tasks):
            fits[index] = fit
            progress(len(fits), len(tasks), STEP)
    every = [fits[index] for index in sorted(fits)]
    for of in every:
        faults[of.task.place] += [of.why] if of.why else []
    why = {at: of[0] for at, of in faults.items() if 2 * len(of) > len(cameras)}
    return every, why


def _rejected(
    boxes: Sequence[BoxFit], why: Mapping[Place, str]
) -> tuple[RejectedEdge, ...]:
    """Return the boxes without a fit, with responses by ISO 12233."""
    iso: dict[Place, dict[str, Esfr]] = {place: {} for place in why}
    for of in boxes:
        if of.iso is not None and of.task.place in iso:
            iso[of.task.place][of.channel] = of.iso
    return tuple(RejectedEdge(at.box, words, iso[at]) for at, words in why.items())


def _measured(boxes: Sequence[BoxFit], law: FocusLaw | None) -> MeasuredEdge:
    """Return an edge in all colours with a fit."""
    where = EdgeRange()
    known = [of for of in boxes if law and of.channel in law.channels]
    if law is not None and known:
        sides = [(of.channel, of.sides) for of in known]
        where = edge_range(law, sides, correlation(known))
    first = boxes[0]
    channels = tuple(map(_channel_edge, boxes))
    line = _line(first.fit, first.first)
    return MeasuredEdge(first.task.place.box, line, where.range_mm, where.other, channels)


def _channel_edge(of: BoxFit) -> ChannelEdge:
    """Return an edge in a colour."""
    fit = of.fit
    edge = fit.state.edge(of.first)
    error = fit.std.edge(of.first)
    bright = edge.towards_light
    near, far = (error.near, error.far) if edge.rise >= 0 else (error.far, error.near)
    least = max(side.log_likelihood for side in of.sides) - AS_LIKELY / 2
    others = [
        Uncertain(side.defocus, side.std, "waves")
        for side in of.sides[1:]
        if side.log_likelihood > least
    ]
    return ChannelEdge(
        of.channel,
        Uncertain(of.sides[0].defocus, of.sides[0].std, "waves"),
        others[0] if others else None,
        Uncertain(np.degrees(bright.angle), np.degrees(error.angle), "deg"),
        Uncertain(bright.near, near, "counts"),
        Uncertain(bright.far, far, "counts"),
        of.chi2_per_pixel,
        sum(region.counts.size for region in of.task.regions),
        of.response,
        of.iso,
        of.iso_problem,
        of.comparison.pull if of.comparison is not None and of.contradicted else None,
        of.cause,
        edge.bow_px,
    )


def _line(fit: EdgeFit, k: int) -> Floats:
    """Return the ends (2, 2) of a line within its region, (row, column)."""
    region = fit.problem.regions[k]
    edge = fit.state.edge(k)
    across, along = region.across_and_along(edge)
    normal = np.array([np.sin(edge.angle), np.cos(edge.angle)])
    near = along[np.abs(across) < NEAR_LINE_PX]
    ends = (near.min(), near.max()) if near.size else (0.0, 0.0)
    foot = region.centre + edge.distance_px * normal
    return np.asarray(foot + np.outer(ends, normal[::-1] * [1, -1]))


def _disagreements(edges: Sequence[MeasuredEdge]) -> list[Finding]:
    """Return what the lens does not explain of the edges."""
    return [
        finding
        for edge in edges
        for channel in edge.channels
        for finding in channel.disagreement(edge.box)
    ]


def _apart(boxes: Sequence[BoxFit], wavefront: Mapping[int, Uncertain]) -> list[Finding]:
    """Return whether no common wavefront explains several boxes."""
    apart = len(boxes) > 1 and not wavefront
    return [found("edges-without-common-wavefront")] if apart else []


def _common_wavefront(boxes: Sequence[BoxFit]) -> dict[int, Uncertain]:
    """Return the modes but defocus, estimated with the edges; none where each edge has its own."""
    if not boxes:
        return {}
    fit = boxes[0].fit
    if len(boxes) > 1 and all(of.fit is not fit for of in boxes[1:]):
        return {}
    modes = zip(fit.problem.noll[1:], fit.state.modes, fit.std.modes, strict=True)
    return {j: Uncertain(value, std, "waves") for j, value, std in modes}
