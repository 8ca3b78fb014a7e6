"""Measured edges: ranges, responses by the fit and by ISO 12233, rejected boxes; as JSON, as a table, and in a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from labkit.edges.esfr import EDITIONS, Esfr
from labkit.edges.found_edges import Box
from labkit.edges.response import Response
from labkit.errors import TargetError
from labkit.finder.picture import Picture, grey_image
from labkit.findings.findings import Finding, found
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan, leading_channel
from labkit.plan.sensor import MONO
from labkit.results.schema import FindingEntry
from labkit.storage.files import write_folder
from labkit.types import Floats
from labkit.uncertain import Uncertain

CURVE_POINTS = 40
DIGITS = 6
LINE_DIGITS = 2
MOST_DRAWN_PX = 2000  # of a photograph below its measurements, along its longer side
BOWED_PX = 0.3
"""Bow of an edge that a straight line takes for blur: 0.3 px cost 2 % of MTF50 at 0.35 cycles a pixel."""

HEADING = [
    *("box", "angle", "range", "or", "channel", "defocus, waves"),
    *("MTF50 of the fit, cycles/mm", "by ISO 12233"),
    *("MTF10, cycles/mm", "by ISO 12233", "chi2/pixel"),
]


@dataclass(frozen=True)
class ChannelEdge:
    """An edge in a colour.

    Attributes
    ----------
    defocus : waves RMS at the reference
    other_defocus : on the other side of best focus, if not excluded by the picture alone
    angle_deg, near, far : direction of the normal, and the radiances of both sides, counts
    chi2_per_pixel, pixels : of the fit
    fitted, iso : response by the fit, and by ISO 12233
    iso_problem : why the latter or its MTF50 is missing
    contradiction : standard errors between the photograph's response and the fit's before it was corrected; None where they
        agree
    other_blur : cause of a blur that no wavefront makes, in words; empty without one
    bow_px : of the edge
    """

    channel: str
    defocus: Uncertain
    other_defocus: Uncertain | None
    angle_deg: Uncertain
    near: Uncertain
    far: Uncertain
    chi2_per_pixel: float
    pixels: int
    fitted: Response
    iso: Esfr | None
    iso_problem: str = ""
    contradiction: float | None = None
    other_blur: str = ""
    bow_px: float = 0.0

    def disagreement(self, box: Box) -> list[Finding]:
        """Report what the lens does not explain, in a box: another blur, something unknown, or a straight line's error."""
        words = {"at": _box_words(box)}
        numbers: dict[str, Any] = {"box": box, "channel": self.channel}
        if self.other_blur:
            words["cause"] = self.other_blur
            return [found("edge-blurred-otherwise", None, words, **numbers)]
        if self.contradiction is not None:
            numbers["pull"] = self.contradiction
            return [found("edge-methods-disagree", None, words, **numbers)]
        straight = self.iso is not None and EDITIONS[self.iso.edition].order == 1
        if straight and self.bow_px > BOWED_PX:
            return [found("edge-bowed", None, words, **numbers, bow_px=self.bow_px)]
        return []

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "channels"."""
        return {
            "channel": self.channel,
            "defocus_waves": self.defocus,
            "other_defocus_waves": self.other_defocus,
            "near_counts": self.near,
            "far_counts": self.far,
            "esfr_problem": self.iso_problem or None,
            "esfr_edition": self.iso and self.iso.edition,
            "contradiction_stds": self.contradiction,
            "other_blur": self.other_blur or None,
            "bow_px": self.bow_px,
            "chi2_per_pixel": self.chi2_per_pixel,
            "pixels": self.pixels,
            **_responses(
                np.linspace(0, self.fitted.frequency_per_mm[-1], CURVE_POINTS),
                {"": self.fitted, "esfr_": self.iso},
            ),
        }

    @property
    def cells(self) -> list[str]:
        """Cells of the table from the channel on."""
        other = " or the reverse" if self.other_defocus else ""
        first = [self.channel, _shown(self.defocus) + other]
        return [*first, *_falls(self.fitted, self.iso), f"{self.chi2_per_pixel:.2f}"]


@dataclass(frozen=True)
class MeasuredEdge:
    """An edge in all its colours.

    Attributes
    ----------
    box : R0,C0,R1,C1 in the raw
    line : (2, 2) its ends, (row, column) in the raw
    range_mm : nan if the focus of the lens is unknown
    other : range on the other side of best focus, if not excluded by the data
    channels : the edge in each colour
    """

    box: Box
    line: Floats
    range_mm: Uncertain
    other: Uncertain | None
    channels: tuple[ChannelEdge, ...]

    @property
    def main(self) -> ChannelEdge:
        """Green, or the first colour, which represents the edge in a table."""
        every = {of.channel: of for of in self.channels}
        return every[leading_channel([*every])]

    @property
    def chi2_per_pixel(self) -> float:
        """χ² per pixel over all colours."""
        chi2 = sum(of.chi2_per_pixel * of.pixels for of in self.channels)
        return chi2 / sum(of.pixels for of in self.channels)

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "edges": the keys of the contract, then others."""
        main = self.main
        return {
            "box": self.box,
            "angle_deg": round(main.angle_deg.value, DIGITS),
            "range_mm": self.range_mm,
            "other_sign_mm": self.other,
            "mtf50_per_mm": main.fitted.mtf50,
            "esfr_mtf50_per_mm": main.iso and main.iso.mtf50.value,
            "chi2_per_pixel": self.chi2_per_pixel,
            "angle_std_deg": main.angle_deg.std,
            "line_px": self.line.round(LINE_DIGITS),
            "channels": [channel.as_json() for channel in self.channels],
        }

    @property
    def rows(self) -> list[list[str]]:
        """Rows of the table, one for each colour."""
        angle = f"{self.main.angle_deg.value:.2f}°"
        ranges = [_shown(self.range_mm), _shown(self.other)]
        return _rows(
            [_box_words(self.box), angle, *ranges], [c.cells for c in self.channels]
        )


@dataclass(frozen=True)
class RejectedEdge:
    """A box without a fit, the reason in one line, and responses by ISO 12233 of an edge that the model does not explain."""

    box: Box
    why: str
    responses: Mapping[str, Esfr] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "rejected"."""
        channels = [
            {"channel": name, **_responses(iso.frequency_per_mm, {"esfr_": iso})}
            for name, iso in self.responses.items()
        ]
        return {"box": self.box, "why": self.why, "channels": channels}

    @property
    def rows(self) -> list[list[str]]:
        """Rows of the table, one for each channel with a response."""
        cells = [
            [name, "not fitted", *_falls(None, iso), ""]
            for name, iso in self.responses.items()
        ]
        return _rows([_box_words(self.box), "", "", ""], cells)


@dataclass(frozen=True)
class EdgesOutcome:
    """All edges of a scene.

    Attributes
    ----------
    edges, rejected : measured edges, and boxes without a fit
    findings : warnings for the user
    wavefront : modes but defocus, waves RMS at the reference, if estimated with the edges
    """

    edges: tuple[MeasuredEdge, ...]
    rejected: tuple[RejectedEdge, ...]
    findings: tuple[Finding, ...] = ()
    wavefront: Mapping[int, Uncertain] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the answer by the contract, schema 1."""
        answer: dict[str, Any] = _json(
            {
                "schema": 1,
                "edges": [edge.as_json() for edge in self.edges],
                "rejected": [of.as_json() for of in self.rejected],
                "wavefront": self.wavefront or None,
                "warnings": [of.text for of in self.findings],
                "findings": [FindingEntry.of(of).written() for of in self.findings],
            }
        )
        return answer

    def rows(self) -> list[list[str]]:
        """Return a heading and a row for each edge and colour, those measured by ISO 12233 alone last."""
        rows = [row for edge in self.edges for row in edge.rows]
        return [HEADING, *rows, *(row for of in self.rejected for row in of.rows)]

    def write(self, folder: Path, image: Path, plan: Plan) -> list[Path]:
        """Write edges.json and the depth map edges.png, and return their paths.

        Raises InputError if they cannot be written.
        """
        from labkit.edges.depth_map import draw_depth_map
        from labkit.figure_style import png, styled

        backdrop = grey_picture(image, plan)
        with styled():
            picture = png(draw_depth_map(backdrop, self))
        text = json.dumps(self.as_json(), indent=1, allow_nan=False).encode() + b"\n"
        return write_folder(folder, {"edges.json": text, "edges.png": picture})


class Backdrop(NamedTuple):
    """A photograph that measurements are drawn over.

    Attributes
    ----------
    grey : (rows, columns), about 0 to 1; of a large photograph means over squares of pixels
    extent_px : left, right, bottom and top of it in pixels of the raw, whose centres are at integers
    """

    grey: Floats
    extent_px: tuple[float, float, float, float]

    @property
    def tallness(self) -> float:
        """Height over width."""
        left, right, bottom, top = self.extent_px
        return (bottom - top) / (right - left)


def grey_picture(image: Path, plan: Plan) -> Backdrop:
    """Return a photograph's grey picture, as fine as it is drawn."""
    photograph = read_photograph(image, plan.sensor)
    picture = Picture.of(photograph)
    pattern = photograph.pattern
    step = picture.binning(max(photograph.shape) // MOST_DRAWN_PX)
    if step > 1:
        means = picture.part((0, 0), picture.shape, step)
        light, pattern = np.asarray(means - photograph.black.mean(), np.float64), MONO
    else:
        light = photograph.light
    try:
        grey = np.asarray(grey_image(light, pattern), np.float64)
    except TargetError:  # nearly even
        rows, columns = photograph.shape
        grey = light[:rows, :columns] / photograph.full_light
    rows, columns = (step * size for size in grey.shape)
    return Backdrop(grey, (-0.5, columns - 0.5, rows - 0.5, -0.5))


def _responses(at: Floats, responses: Mapping[str, Response | None]) -> dict[str, Any]:
    """Return entries of an edge's responses by the prefixes of their keys, and the curves at frequencies (n,)."""
    entries: dict[str, Any] = {}
    curve = {"per_mm": at}
    for prefix, of in responses.items():
        entries[f"{prefix}mtf50_per_mm"] = of and of.mtf50
        entries[f"{prefix}mtf10_per_mm"] = of and of.mtf10
        if of is not None:
            name = prefix.rstrip("_") or "fit"
            curve[name] = np.interp(at, of.frequency_per_mm, of.value)
            curve[f"{name}_std"] = np.interp(at, of.frequency_per_mm, of.std)
    return {**entries, "curve": curve}


def _json(value: Any) -> Any:
    """Return a value for JSON: numbers not finite become null, arrays have six digits."""
    match value:
        case Uncertain():
            return value.as_json()
        case np.ndarray():
            return _json(value.round(DIGITS).tolist())
        case float():
            return value if math.isfinite(value) else None
        case list() | tuple():
            return [_json(each) for each in value]
        case dict():
            return {str(name): _json(each) for name, each in value.items()}
    return value


def _rows(head: Sequence[str], cells: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return rows of a table, of which the first has the head."""
    return [[*(head if k == 0 else [""] * len(head)), *row] for k, row in enumerate(cells)]


def _falls(fitted: Response | None, iso: Response | None) -> list[str]:
    """Return the cells of MTF50 and MTF10, by the fit and by ISO 12233."""
    falls = [(of.mtf50, of.mtf10) if of else (None, None) for of in (fitted, iso)]
    return [
        "" if each is None else _shown(Uncertain(each.value, each.std))
        for level in zip(*falls, strict=True)
        for each in level
    ]


def _shown(value: Uncertain | None) -> str:
    """Return a number's cell."""
    if value is None:
        return ""
    return str(value) if math.isfinite(value.value) else "-"


def _box_words(box: Sequence[int]) -> str:
    """Return a box as the command line takes it."""
    return ",".join(map(str, box))
