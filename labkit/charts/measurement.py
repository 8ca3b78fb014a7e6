"""Photographs of a chart to the lens over the field."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labkit.charts.chart_edges import ChartEdges, chart_edges, grid, is_aligned
from labkit.charts.focal_surface import (
    FOCUS_KINDS,
    FocalSurface,
    PlaceFocus,
    enlarged,
    focal_surface,
    law_misfit,
    place_focus,
)
from labkit.charts.geometry import chart_geometry
from labkit.charts.outcome import ChartEdge, ChartOutcome, ChartPlace
from labkit.charts.patterns import Cell
from labkit.charts.place_fit import PlaceFit, PlaceTask, fit_place
from labkit.edges.box_fit import BoxTask
from labkit.edges.boxes import ChannelFrame, Place, read_frames
from labkit.edges.camera import Camera, camera_of
from labkit.edges.measurement import FINDING, measured_channels
from labkit.errors import DataError
from labkit.findings.findings import Finding, each_once, found
from labkit.jobs.execute import Workers, default_workers
from labkit.jobs.threads import one_thread
from labkit.optics.field import FieldFrame
from labkit.optics.lens import ThinLens, defocus_waves
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, leading_channel
from labkit.types import Floats, Progress, no_progress

PLACES_ACROSS = 7
EDGES_EACH = 2  # of either direction, at a place
CONTRADICTED = 1e-3  # probability of the defoci if the law and the ranges were right
FITTING = "fitting places"
UNKNOWN_CAUSE = "motion, or a program that changed the photograph"


@one_thread
def measure_chart(
    images: Path | str | Sequence[Path | str],
    plan: Plan | Path | str,
    *,
    ranges_mm: Sequence[float] = (),
    channels: Sequence[str] | None = None,
    columns: int = PLACES_ACROSS,
    each: int = EDGES_EACH,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> ChartOutcome:
    """Measure a lens over the field by the straight edges of a chart.

    Parameters
    ----------
    images : photographs of a checkerboard or of slanted squares, one lens and one focus
    plan : the photographs' plan, or its path
    ranges_mm : range of the chart in each photograph, from the lens; two ranges or more
        give the sign of the focus errors
    channels : channels to measure; None for all
    columns : places along the frame's rows, an odd number
    each : largest number of edges of either direction at a place, in each photograph
    workers : number of processes, by default one for each core
    progress : called as the work goes on

    Returns
    -------
    responses of edges and places, focal surfaces where two ranges or more are given, and the
    lens's distortion with the chart's pose; the last two alone for a chart of small squares

    Raises
    ------
    RawError, DataError
        of photographs that cannot be used, and where no chart is found

    >>> labkit.measure_chart("chart.dng", "plan.toml").rows()
    """
    paths = [
        Path(path) for path in ([images] if isinstance(images, Path | str) else images)
    ]
    plan = plan if isinstance(plan, Plan) else Plan.load(Path(plan))
    ranges = _ranges(paths, ranges_mm)
    if columns < 3 or columns % 2 == 0 or each < 1:
        raise DataError(
            f"{columns} places across, {each} edges: an odd number of places from 3 on and 1 edge or more are needed"
        )
    progress(0, 0, FINDING)
    photographs = read_frames(paths, plan)
    first = photographs[0]
    names = measured_channels(first, plan, channels)
    cells = grid(first.shape, columns)
    charts = _found(paths, photographs, leading_channel(names), cells, each)
    law = _law_waves(plan, ranges, len(paths))
    tasks = [
        task
        for name in names
        for task in _tasks(
            photographs,
            charts,
            camera_of(plan, name, None, first.full_light, _middle(ranges)),
            law,
        )
    ]
    fits = _fitted(tasks, workers, progress)
    frame = FieldFrame(first.shape, plan.sensor.pixel_pitch_um)
    return _outcome(fits, frame, plan, ranges, charts, first.notes)


def _ranges(paths: Sequence[Path], ranges_mm: Sequence[float]) -> tuple[float, ...]:
    """Return the range of each photograph, none if unknown. Raises DataError."""
    if ranges_mm and len(ranges_mm) != len(paths):
        raise DataError(
            f"{len(ranges_mm)} ranges for {len(paths)} photographs: give --range MM once for each, in their order"
        )
    if not all(mm > 0 for mm in ranges_mm):
        raise DataError(
            f"ranges {', '.join(f'{mm:g}' for mm in ranges_mm)} mm: each must be above 0"
        )
    return tuple(ranges_mm)


def _middle(ranges: Sequence[float]) -> float | None:
    """Return the range whose image the focus errors are counted from, the mean in 1 / range; None without ranges."""
    return float(1 / np.mean(1 / np.array(ranges))) if ranges else None


def _law_waves(plan: Plan, ranges: Sequence[float], photographs: int) -> Floats:
    """Return the defocus (photographs,) by the lens's law, for a lens focused at the middle of the ranges.

    Zeros for one range or none: the sign of defocus is open then.
    """
    middle = _middle(ranges)
    if middle is None or len(set(ranges)) < 2:
        return np.zeros(photographs)
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    if min(ranges) <= lens.focal_length_mm:
        raise DataError(
            f"a range of {min(ranges):g} mm is not beyond the focal length, {lens.focal_length_mm:g} mm"
        )
    return defocus_waves(
        lens, np.array(ranges), middle, plan.reference_wavelength_nm, plan.fit.convention
    )


def _found(
    paths: Sequence[Path],
    photographs: Sequence[Photograph],
    channel: str,
    cells: tuple[int, int],
    each: int,
) -> list[ChartEdges]:
    """Return the edges of each photograph. Raises DataError."""
    charts = []
    for path, photograph in zip(paths, photographs, strict=True):
        try:
            charts.append(chart_edges(ChannelFrame.of(photograph, channel), cells, each))
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    return charts


def _tasks(
    photographs: Sequence[Photograph],
    charts: Sequence[ChartEdges],
    camera: Camera,
    law: Floats,
) -> list[PlaceTask]:
    """Return the tasks of a channel, one for each place of the grid."""
    boxes: dict[Cell, list[tuple[int, BoxTask]]] = {}
    for k, (photograph, chart) in enumerate(zip(photographs, charts, strict=True)):
        frame = ChannelFrame.of(photograph, camera.channel)
        for cell, places in chart.places.items():
            for place in places:
                if (task := _box(frame, camera, place)) is not None:
                    boxes.setdefault(cell, []).append((k, task))
    return [
        PlaceTask(
            cell,
            camera,
            tuple(task for _, task in every),
            tuple(k for k, _ in every),
            photographs[0].pixels(camera.channel).period,
            law,
        )
        for cell, every in sorted(boxes.items())
    ]


def _box(frame: ChannelFrame, camera: Camera, place: Place) -> BoxTask | None:
    """Return the task of an edge; None where this channel has too few pixels."""
    try:
        return BoxTask.of([frame], camera, place)
    except DataError:
        return None


def _fitted(
    tasks: Sequence[PlaceTask], workers: int | None, progress: Progress
) -> list[PlaceFit]:
    """Fit all places."""
    fits: dict[int, PlaceFit] = {}
    with Workers(min(workers or default_workers(), max(len(tasks), 1))) as run:
        progress(0, len(tasks), FITTING)
        for index, fit in run(fit_place, tasks):
            fits[index] = fit
            progress(len(fits), len(tasks), FITTING)
    return [fits[index] for index in sorted(fits)]


def _outcome(
    fits: Sequence[PlaceFit],
    frame: FieldFrame,
    plan: Plan,
    ranges: Sequence[float],
    charts: Sequence[ChartEdges],
    notes: Sequence[Finding],
) -> ChartOutcome:
    """Return everything measured. Raises DataError where no edge could be fitted."""
    places: list[ChartPlace] = []
    foci: dict[str, list[PlaceFocus]] = {}
    of_photograph = dict(enumerate(ranges))
    for fit in fits:
        edges = [
            ChartEdge(fit.channel, of, frame, of_photograph.get(of.photograph))
            for of in fit.edges
        ]
        for depth, photograph in enumerate(fit.photographs):
            own = tuple(edge for edge in edges if edge.of.photograph == photograph)
            places.append(ChartPlace(fit, depth, own, of_photograph.get(photograph)))
        if edges:
            middle = np.mean([edge.height_mm for edge in edges], axis=0)
            foci.setdefault(fit.channel, []).append(place_focus(fit, middle))
    rejected = [why for fit in fits for why in fit.rejected]
    if rejected and not places:
        raise DataError(f"no edge of the chart could be measured: {rejected[0]}")
    lattices = [(of.pattern.cells, of.points_px) for of in charts]
    left_out = {
        "cut": sum(of.cut for of in charts),
        "clipped": sum(of.clipped for of in charts),
        "uneven": sum(of.uneven for of in charts),
        "small": sum(of.small for of in charts),
        "spare": sum(of.spare for of in charts),
        "not_fitted": len(rejected),
    }
    outcome = ChartOutcome(
        frame,
        tuple(edge for place in places for edge in place.edges),
        tuple(places),
        left_out,
        {name: enlarged(every) for name, every in foci.items()},
        {name: _surfaces(enlarged(every), plan) for name, every in foci.items()},
        charts[0].pattern.kind,
        chart_geometry(lattices, frame, _image_distance_mm(plan, ranges)),
    )
    return replace(
        outcome, findings=tuple(each_once([*notes, *_findings(outcome, charts, rejected)]))
    )


def _image_distance_mm(plan: Plan, ranges: Sequence[float]) -> float:
    """Return the distance of the sensor from the lens, focused at the middle of the ranges, or at infinity without."""
    focal_mm = plan.lens.focal_length_mm
    middle = _middle(ranges)
    return focal_mm if middle is None else focal_mm * middle / (middle - focal_mm)


def _surfaces(foci: Sequence[PlaceFocus], plan: Plan) -> Mapping[str, FocalSurface]:
    """Return the focal surfaces of a channel, none where the sign of defocus is open."""
    if any(of.sign_open for of in foci):
        return {}
    every = {
        kind: focal_surface(foci, kind, plan.lens.stated_f_number) for kind in FOCUS_KINDS
    }
    return {kind: of for kind, of in every.items() if of is not None}


def _findings(
    outcome: ChartOutcome, charts: Sequence[ChartEdges], rejected: Sequence[str]
) -> list[Finding]:
    """Return what a user should see as warnings."""
    findings = []
    left = outcome.left_out
    if not outcome.edges:
        side = np.median([of.side_px for of in charts])
        findings.append(
            found("chart-squares-small", side_px=float(side), least_px=charts[0].least_px)
        )
    elif any(left[name] for name in ("cut", "clipped", "uneven")):
        findings.append(
            found(
                "chart-edges-left-out",
                cut=left["cut"],
                clipped=left["clipped"],
                uneven=left["uneven"],
            )
        )
    for pose in outcome.geometry.poses if outcome.geometry else ():
        if pose.bent:
            number = pose.photograph + 1
            findings.append(found("chart-not-flat", number=number, rms_px=pose.rms_px))
    if rejected:
        why = Counter(rejected).most_common(1)[0][0]
        findings.append(found("chart-edges-not-fitted", count=len(rejected), why=why))
    findings += _other_blur(outcome)
    along = sum(is_aligned(edge.of.angle_deg) for edge in outcome.edges)
    if along:
        findings.append(
            found("chart-edges-along-pixels", count=along, edges=len(outcome.edges))
        )
    unknown = sum(not (of.known("S") and of.known("T")) for of in outcome.places)
    if unknown:
        findings.append(
            found("chart-directions-missing", count=unknown, places=len(outcome.places))
        )
    for name, every in outcome.foci.items():
        factor, p = law_misfit(every)
        if p < CONTRADICTED:
            findings.append(found("chart-ranges-contradicted", channel=name, factor=factor))
    if any(of.sign_open for every in outcome.foci.values() for of in every):
        findings.append(found("chart-focus-sign-open"))
    return findings


def _other_blur(outcome: ChartOutcome) -> list[Finding]:
    """Return for each channel how many edges are blurred as no lens does, and the commonest cause."""
    findings = []
    for name in outcome.channels:
        edges = [edge.of for edge in outcome.edges if edge.channel == name]
        odd = [of for of in edges if of.cause or of.comparison is not None]
        if odd:
            causes = Counter(of.cause for of in odd if of.cause)
            cause = causes.most_common(1)[0][0] if causes else UNKNOWN_CAUSE
            findings.append(
                found(
                    "chart-edges-blurred-otherwise",
                    count=len(odd),
                    edges=len(edges),
                    channel=name,
                    cause=cause,
                )
            )
    return findings
