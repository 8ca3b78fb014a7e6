"""`labkit edges`: photographs of a scene to ranges and responses of its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.analysis.measured_camera import check_same_camera
from labkit.edges.box_fit import BoxFit, BoxTask, box_task, fit_box
from labkit.edges.boxes import ChannelFrame, Place, checked_box, read_frames
from labkit.edges.camera import Camera, camera_of, focus_law
from labkit.edges.esfr import Esfr
from labkit.edges.found_edges import Box
from labkit.edges.joint import EdgeFit
from labkit.edges.one_range import contradicting
from labkit.edges.outcome import (
    ChannelEdge,
    EdgesOutcome,
    MeasuredEdge,
    RejectedEdge,
    box_words,
)
from labkit.edges.ranges import AS_LIKELY, EdgeRange, FocusLaw, edge_range
from labkit.edges.response import fitted_response
from labkit.edges.standing import Standing, correlation, standings
from labkit.errors import DataError
from labkit.execute import Workers, default_workers
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, leading_channel
from labkit.results import Results
from labkit.types import Floats, Progress, no_progress
from labkit.uncertain import Uncertain

MOST_EDGES = 60


@dataclass(frozen=True)
class Scene:
    """What is to be measured, and with what.

    images: frames of one scene, the camera at rest. results: of a session with the same lens and aperture, whose wavefront and
    best focus are taken; without, the wavefront is fitted along, common to all edges. boxes: R0,C0,R1,C1 of the raw; none:
    edges are looked for, ``most`` at most. focus_mm: what the lens is focused at, in place of the session's. channels: only
    these. one_range: all edges stand at the same range. force: take a session of another camera.
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
    scene: Scene, workers: int | None = None, progress: Progress = no_progress
) -> EdgesOutcome:
    """Edges of a scene: their ranges, and the camera's response across them by the fit and by ISO 12233.

    Raises RawError, DataError for frames that cannot be used; a box that gives no edge is in `EdgesOutcome.rejected`.
    """
    photographs = read_frames(scene.images, scene.plan)
    names = _channels(photographs[0], scene)
    law, warnings = _law(photographs[0], scene, names)
    places, rejected = _places(photographs[0], names, scene)
    focused = None if law is None else float(np.mean(law.focus_mm))
    white = photographs[0].full_light
    cameras = {
        name: camera_of(scene.plan, name, scene.results, white, focused) for name in names
    }
    fits, refused = _fitted(photographs, cameras, places, workers, progress)
    rejected += refused
    if scene.one_range:
        rejected += _drop_contradicting(fits)
    standing = standings(fits, scene.one_range)
    edges = [
        _measured(place, fits[place], standing, law) for place in places if place in fits
    ]
    return EdgesOutcome(
        tuple(edges),
        tuple(rejected),
        (*warnings, *_disagreements(edges)),
        _wavefront(standing, scene.results),
    )


def _disagreements(edges: Sequence[MeasuredEdge]) -> list[str]:
    """Say where the two methods contradict each other, a line for each box and channel."""
    return [
        f"box {box_words(edge.box)}, {channel.disagreement}"
        for edge in edges
        for channel in edge.channels
        if channel.disagreement
    ]


def _law(
    photograph: Photograph, scene: Scene, names: tuple[str, ...]
) -> tuple[FocusLaw | None, tuple[str, ...]]:
    """The lens's law, where something says what it is focused at; and warnings. Raises DataError for another camera's PSF."""
    warnings = [note.text for note in photograph.notes]
    if scene.results is not None:
        camera = photograph.camera
        warnings += check_same_camera(
            scene.results, scene.plan, names, camera, force=scene.force
        )
    law = focus_law(scene.plan, scene.results, names, scene.focus_mm)
    if law is None:
        warnings.append(
            "ranges are not determined: give --psf SESSION with a best focus, or --focus MM"
        )
    return law, tuple(dict.fromkeys(warnings))


def _channels(photograph: Photograph, scene: Scene) -> tuple[str, ...]:
    """Those wanted, or all that plan and photograph have, and the session too. Raises DataError."""
    known = [c.name for c in scene.plan.channel if photograph.has(c.name)]
    if absent := [name for name in scene.channels or () if name not in known]:
        raise DataError(f"channel {', '.join(absent)}: allowed are {', '.join(known)}")
    if scene.channels:
        return tuple(name for name in known if name in scene.channels)
    fitted = known if scene.results is None else scene.results.channels
    return tuple(name for name in known if name in fitted) or tuple(known)


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
) -> tuple[dict[Place, dict[str, BoxFit]], list[RejectedEdge]]:
    """Fits of each box by channel, and the boxes that gave none: those of which most channels gave none."""
    tasks: list[BoxTask] = []
    why: dict[Place, list[str]] = {place: [] for place in places}
    frames = {name: [ChannelFrame.of(of, name) for of in photographs] for name in cameras}
    for place in places:
        for name, camera in cameras.items():
            try:
                tasks.append(box_task(frames[name], camera, place))
            except DataError as error:
                why[place].append(f"{name}: {error}")
    fits: dict[Place, dict[str, BoxFit]] = {place: {} for place in places}
    responses: dict[Place, dict[str, Esfr]] = {place: {} for place in places}
    with Workers(min(workers or default_workers(), max(len(tasks), 1))) as run:
        progress(0, len(tasks), "fitting edges")
        for done, (index, fit) in enumerate(run(fit_box, tasks)):
            place, name = tasks[index].place, tasks[index].camera.channel
            if fit.iso is not None:
                responses[place][name] = fit.iso
            if fit.ends:
                fits[place][name] = fit
            else:
                why[place].append(f"{name}: {fit.why}")
            progress(done + 1, len(tasks), "fitting edges")
    kept = {place: of for place, of in fits.items() if of and len(of) >= len(why[place])}
    rejected = [place for place in places if place not in kept]
    return kept, [
        RejectedEdge(at.box, why[at][0].partition(": ")[2], responses[at])
        for at in rejected
    ]


def _drop_contradicting(fits: dict[Place, dict[str, BoxFit]]) -> list[RejectedEdge]:
    """Take out boxes that contradict the one range that all are declared to have."""
    rejected: dict[Place, str] = {}
    for name in dict.fromkeys(name for of in fits.values() for name in of):
        having = [
            place for place, of in fits.items() if name in of and place not in rejected
        ]
        found = contradicting([fits[place][name] for place in having])
        rejected |= {having[k]: words for k, words in found.items()}
    gone = {place: fits.pop(place) for place in rejected}
    iso = {
        place: {name: of.iso for name, of in gone[place].items() if of.iso is not None}
        for place in gone
    }
    return [RejectedEdge(place.box, words, iso[place]) for place, words in rejected.items()]


def _measured(
    place: Place,
    fits: dict[str, BoxFit],
    standing: dict[tuple[Place, str], Standing],
    law: FocusLaw | None,
) -> MeasuredEdge:
    """An edge in all colours that gave a fit."""
    channels = tuple(
        _channel_edge(name, of, standing[place, name]) for name, of in fits.items()
    )
    where = EdgeRange(Uncertain(np.nan, np.nan, "mm"), None)
    names = [name for name in fits if law is not None and name in law.channels]
    if law is not None and names:
        of_box = [standing[place, name] for name in names]
        sides = [(name, of.sides) for name, of in zip(names, of_box, strict=True)]
        where = edge_range(law, sides, correlation(of_box))
    first = standing[place, channels[0].channel]
    return MeasuredEdge(
        place.box, _line(first.fit, first.first), where.range_mm, where.other, channels
    )


def _channel_edge(name: str, of: BoxFit, standing: Standing) -> ChannelEdge:
    fit, k, sides = standing.fit, standing.first, standing.sides
    edge, error = fit.state.edge(k), fit.edge_std(k)
    bright = edge.towards_light
    near, far = (error[2], error[3]) if edge.far >= edge.near else (error[3], error[2])
    residuals = [fit.residuals(k + j) for j in range(len(of.task.regions))]
    pixels = sum(r.size for r in residuals)
    top = max(side.log_likelihood for side in sides)
    other = next((s for s in sides[1:] if top - s.log_likelihood < AS_LIKELY / 2), None)
    return ChannelEdge(
        name,
        Uncertain(sides[0].defocus, sides[0].std, "waves"),
        None if other is None else Uncertain(other.defocus, other.std, "waves"),
        Uncertain(np.degrees(bright.angle), np.degrees(error[0]), "deg"),
        Uncertain(bright.near, near, "counts"),
        Uncertain(bright.far, far, "counts"),
        sum(float(r @ r) for r in residuals) / pixels,
        pixels,
        fitted_response(fit, k),
        of.iso,
        of.iso_problem,
    )


def _line(fit: EdgeFit, k: int) -> Floats:
    """(2, 2) ends of the line within its region, (row, column)."""
    region, edge = fit.problem.regions[k], fit.state.edge(k)
    _, along = region.across_and_along(edge)
    normal, tangent = (
        np.array([np.sin(edge.angle), np.cos(edge.angle)]),
        np.array([np.cos(edge.angle), -np.sin(edge.angle)]),
    )
    foot = np.array(region.centre) + edge.distance_px * normal
    across = np.abs(region.across_and_along(edge)[0]) < 3
    ends = (along[across].min(), along[across].max()) if across.any() else (0.0, 0.0)
    return np.array([foot + at * tangent for at in ends])


def _wavefront(
    standing: dict[tuple[Place, str], Standing], results: Results | None
) -> dict[int, Uncertain]:
    """Modes but defocus, where they were fitted along."""
    if results is not None or not standing:
        return {}
    fit = next(iter(standing.values())).fit
    modes = fit.problem.noll[1:]
    std = np.sqrt(np.diag(fit.covariance))[: len(modes)]
    return {
        j: Uncertain(float(v), float(s), "waves")
        for j, v, s in zip(modes, fit.state.modes, std, strict=True)
    }
