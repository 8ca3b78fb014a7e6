"""A chart's measurement: the response across each edge and at each place, by image height and direction."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from labkit.charts.chart_edges import is_aligned
from labkit.charts.focal_surface import FOCUS_KINDS, FocalSurface, PlaceFocus
from labkit.charts.geometry import ChartGeometry
from labkit.charts.place_fit import EdgeResponse, PlaceFit
from labkit.edges.outcome import Backdrop
from labkit.edges.response import Response, response_along, with_errors
from labkit.findings.findings import Finding
from labkit.optics.field import FieldFrame
from labkit.storage.files import write_folder
from labkit.types import Floats
from labkit.uncertain import Uncertain

LEVELS_PER_MM = (10.0, 20.0, 40.0)
HALF_SECTOR_DEG = 22.5
"""Between the radius, its perpendicular and the directions midway: an edge belongs to the nearest."""

EDGE_KINDS = {
    "T": "tangential",
    "S": "sagittal",
    "O": "neither: 45° to the radius",
    "C": "centre",
}
UNKNOWN_MTF = 0.1  # standard error of a response from which a place says nothing
JSON_DECIMALS = 6

PLACE_HEADING = ["place", "height, mm", "azimuth", "channel", "edges"]


@dataclass(frozen=True)
class ChartEdge:
    """An edge of the chart.

    Attributes
    ----------
    channel, of : its colour and its fit
    frame : coordinates
    range_mm : of its photograph, None if unknown
    """

    channel: str
    of: EdgeResponse
    frame: FieldFrame
    range_mm: float | None

    @cached_property
    def height_mm(self) -> Floats:
        """(y, x) of its middle from the frame's centre."""
        return self.frame.heights_mm(self.of.middle_px)

    @property
    def radial_deg(self) -> float:
        """Angle between the edge's normal and the radius, 0 to 90."""
        azimuth = np.degrees(np.arctan2(*self.height_mm))
        return float(abs((self.of.angle_deg - azimuth + 90) % 180 - 90))

    @property
    def kind(self) -> str:
        """T if the normal is along the radius, S if it is across, O midway, C about the centre."""
        if np.hypot(*self.height_mm) < self.of.length_px * 1e-3 * self.frame.pixel_pitch_um:
            return "C"
        if self.radial_deg <= HALF_SECTOR_DEG:
            return "T"
        return "S" if self.radial_deg >= 90 - HALF_SECTOR_DEG else "O"

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "edges"."""
        iso = self.of.iso
        return {
            "channel": self.channel,
            "range_mm": self.range_mm,
            "middle_px": list(self.of.middle_px),
            **_place(self.height_mm),
            "angle_deg": self.of.angle_deg,
            "to_radius_deg": self.radial_deg,
            "kind": self.kind,
            "along_pixels": is_aligned(self.of.angle_deg),
            "chi2_per_pixel": self.of.chi2_per_pixel,
            "contradiction_stds": self.of.comparison and self.of.comparison.pull,
            "other_blur": self.of.cause or None,
            **_responses(self.of.fitted),
            "esfr_mtf50_per_mm": None if iso is None else iso.mtf50,
        }


@dataclass(frozen=True)
class ChartPlace:
    """A place of the frame in one photograph and channel.

    Attributes
    ----------
    fit, depth : the joint fit, and the photograph's number in it
    edges : the photograph's edges there
    range_mm : of the photograph, None if unknown
    """

    fit: PlaceFit
    depth: int
    edges: tuple[ChartEdge, ...]
    range_mm: float | None

    @cached_property
    def height_mm(self) -> Floats:
        """(y, x) from the frame's centre: the mean of the edges'."""
        return np.asarray(np.mean([edge.height_mm for edge in self.edges], axis=0))

    @cached_property
    def responses(self) -> dict[str, Response]:
        """Responses along the radius, T, and across, S, by the joint wavefront, and what edges of the direction show more."""
        waves, covariance = self.fit.wavefront(self.depth)
        radial = float(np.arctan2(*self.height_mm))
        return {
            kind: self._corrected(
                kind, response_along(self.fit.optics, waves, covariance, radial + turn)
            )
            for kind, turn in (("S", np.pi / 2), ("T", 0.0))
        }

    def _corrected(self, kind: str, response: Response) -> Response:
        """Return a response with the mean of what the edges of its direction show more, where they contradict the wavefront."""
        own = [edge.of.comparison for edge in self.edges if edge.kind in (kind, "C")]
        if not any(own):
            return response
        every = [response if of is None else of.corrected(response) for of in own]
        values = np.array([of.value for of in every])
        own_std = np.mean([of.std for of in every], axis=0)
        std = np.hypot(own_std, values.std(axis=0))
        value = values.mean(axis=0)
        return with_errors(response.frequency_per_mm, value, std)

    def known(self, kind: str) -> bool:
        """Return whether the edges determine S or T: on a diagonal, edges at 45° do not, whatever the fit's error."""
        of = self.responses[kind]
        along = any(edge.kind in (kind, "C") for edge in self.edges)
        return along and float(of.std.max()) < UNKNOWN_MTF

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "places"."""
        return {
            "cell": list(self.fit.cell),
            "channel": self.fit.channel,
            "range_mm": self.range_mm,
            **_place(self.height_mm),
            "edges": len(self.edges),
            **{
                EDGE_KINDS[kind]: _responses(of) if self.known(kind) else None
                for kind, of in self.responses.items()
            },
        }

    @property
    def row(self) -> list[str]:
        """Cells of the table."""
        y, x = self.height_mm
        cells = [
            ",".join(map(str, self.fit.cell)),
            f"{np.hypot(y, x):.2f}",
            f"{np.degrees(np.arctan2(y, x)):.0f}°",
            self.fit.channel,
            str(len(self.edges)),
        ]
        for kind, of in self.responses.items():
            numbers = [Uncertain(of.mtf50.value, of.mtf50.std), *map(of.at, LEVELS_PER_MM)]
            cells += [str(each) if self.known(kind) else "-" for each in numbers]
        return cells


@dataclass(frozen=True)
class ChartOutcome:
    """A chart over the frame.

    Attributes
    ----------
    frame : coordinates
    edges, places : measured edges, and places with their joint fits
    left_out : number of edges that were not measured, by reason
    foci : focus errors of the places by channel
    surfaces : focal surfaces by channel: medial, S and T; empty where the sign of defocus is open
    kind : of the chart, in words
    geometry : distortion and pose; None for a chart of few points
    findings : what a user should see as warnings
    """

    frame: FieldFrame
    edges: tuple[ChartEdge, ...]
    places: tuple[ChartPlace, ...]
    left_out: Mapping[str, int]
    foci: Mapping[str, tuple[PlaceFocus, ...]]
    surfaces: Mapping[str, Mapping[str, FocalSurface]]
    kind: str
    geometry: ChartGeometry | None
    findings: tuple[Finding, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured channels."""
        return tuple(dict.fromkeys(place.fit.channel for place in self.places))

    def as_json(self) -> dict[str, Any]:
        """Return the answer as JSON, schema 1."""
        answer: dict[str, Any] = _json(
            {
                "schema": 1,
                "chart": self.kind,
                "frame_px": list(self.frame.shape_px),
                "edges": [edge.as_json() for edge in self.edges],
                "places": [place.as_json() for place in self.places],
                "left_out": self.left_out,
                "geometry": self.geometry and self.geometry.as_json(),
                "focus": {
                    name: [of.as_json() for of in every]
                    for name, every in self.foci.items()
                },
                "focal_surfaces": {
                    name: {kind: of.as_json() for kind, of in every.items()}
                    for name, every in self.surfaces.items()
                },
                "warnings": [of.text for of in self.findings],
            }
        )
        return answer

    def rows(self) -> list[list[str]]:
        """Return a heading and a row for each place."""
        names = ["MTF50", *(f"at {level:g}/mm" for level in LEVELS_PER_MM)]
        heading = PLACE_HEADING + [f"{kind} {name}" for kind in "ST" for name in names]
        return [heading, *(place.row for place in self.places)]

    @property
    def sharpest(self) -> int:
        """Number of the photograph with the largest median MTF50, which figures show."""
        every: dict[int, list[float]] = {}
        for edge in self.edges:
            every.setdefault(edge.of.photograph, []).append(edge.of.fitted.mtf50.value)
        return max(every, key=lambda k: float(np.nanmedian(every[k])), default=0)

    def focus_rows(self) -> list[list[str]]:
        """Return a heading and a row for the focus errors of each place."""
        rows = [[name, *of.row] for name, every in self.foci.items() for of in every]
        kinds = [f"{kind} focus" for kind in FOCUS_KINDS]
        return [["channel", "place", "y, mm", "x, mm", *kinds, "T − S"], *rows]

    def surface_rows(self) -> list[list[str]]:
        """Return a heading and a row for each focal surface; nothing without surfaces."""
        rows = [
            [f"{channel} {kind}", *of.cells]
            for channel, every in self.surfaces.items()
            for kind, of in every.items()
        ]
        return [["focal surface", *FocalSurface.HEADING], *rows] if rows else []

    def write(self, folder: Path, backdrop: Backdrop) -> list[Path]:
        """Write chart.json and the figures, and return their paths.

        backdrop : the sharpest photograph. Raises InputError if they cannot be written.
        """
        from labkit.charts.figures import draw_figures
        from labkit.figure_style import png, styled

        text = json.dumps(self.as_json(), indent=1, allow_nan=False).encode() + b"\n"
        files = {"chart.json": text}
        with styled():
            for name, figure in (
                draw_figures(self, backdrop) if self.edges else {}
            ).items():
                files[f"{name}.png"] = png(figure)
        return write_folder(folder, files)


def _place(height_mm: Floats) -> dict[str, Any]:
    """Return entries of a place."""
    y, x = height_mm
    return {
        "y_mm": y,
        "x_mm": x,
        "height_mm": np.hypot(y, x),
        "azimuth_deg": np.degrees(np.arctan2(y, x)),
    }


def _responses(of: Response) -> dict[str, Any]:
    """Return entries of a response."""
    levels = {f"mtf_at_{level:g}_per_mm": of.at(level) for level in LEVELS_PER_MM}
    return {"mtf50_per_mm": of.mtf50, **levels}


def _json(value: Any) -> Any:
    """Return a value for JSON: numbers that are not finite become null."""
    match value:
        case Uncertain():
            return value.as_json()
        case float() | np.floating():
            return round(float(value), JSON_DECIMALS) if np.isfinite(value) else None
        case np.bool_():
            return bool(value)
        case Sequence() if not isinstance(value, str):
            return [_json(each) for each in value]
        case Mapping():
            return {str(name): _json(each) for name, each in value.items()}
    return value
