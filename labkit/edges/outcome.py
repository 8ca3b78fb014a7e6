"""Measured edges: ranges, responses by the fit and by ISO 12233, rejected boxes; as JSON, as a table, and in a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labkit.edges.esfr import Esfr
from labkit.edges.found_edges import Box
from labkit.edges.response import FittedResponse
from labkit.errors import TargetError
from labkit.files import write_atomically, writing
from labkit.finder.find_target import grey_image
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan, leading_channel
from labkit.types import Floats
from labkit.uncertain import Uncertain

CURVE_POINTS = 40
DIGITS = 6
DISAGREEMENT_STDS = 4.0
"""Standard errors of a difference, beyond which two methods disagree."""

METHOD_SHARE = 0.12
"""Relative to MTF50: what the window of ISO 12233 adds to a strongly blurred edge's in a box of 36 pixels."""

HEADING = [
    *("box", "angle", "range", "or", "channel", "defocus, waves"),
    *("MTF50 of the fit, cycles/mm", "by ISO 12233"),
    *("MTF10, cycles/mm", "by ISO 12233", "chi2/pixel"),
]


@dataclass(frozen=True)
class ChannelEdge:
    """An edge in one colour.

    Attributes
    ----------
    defocus : waves RMS at the reference
    other_defocus : on the other side of best focus, if the picture alone does not exclude it
    angle_deg, near, far : direction of the normal, and the radiances of both sides, counts
    chi2_per_pixel, pixels : of the fit
    fitted, iso : response by the fit, and by ISO 12233
    iso_problem : why the latter or its MTF50 is missing
    """

    channel: str
    defocus: Uncertain
    other_defocus: Uncertain | None
    angle_deg: Uncertain
    near: Uncertain
    far: Uncertain
    chi2_per_pixel: float
    pixels: int
    fitted: FittedResponse
    iso: Esfr | None
    iso_problem: str = ""

    @property
    def disagreement(self) -> str:
        """Sentence on the difference of MTF50 by ISO 12233 and by the fit; empty if their errors allow it."""
        fit = self.fitted.mtf50
        iso = None if self.iso is None else self.iso.mtf50
        if iso is None or not math.isfinite(iso.value - fit.value):
            return ""
        allowed = (
            DISAGREEMENT_STDS * math.hypot(fit.std, iso.std) + METHOD_SHARE * fit.value
        )
        if abs(iso.value - fit.value) <= allowed:
            return ""
        return (
            f"channel {self.channel}: MTF50 is {fit} by the fit and {iso} by ISO 12233, more apart than their errors allow: "
            "see whether the box holds one straight edge between even sides"
        )

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "channels"."""
        fit = self.fitted
        iso = self.iso
        at = np.linspace(0, fit.frequency_per_mm[-1], CURVE_POINTS)
        curve = {"per_mm": at} | {
            name: np.interp(at, fit.frequency_per_mm, values)
            for name, values in (("fit", fit.value), ("fit_std", fit.std))
        }
        if iso is not None:
            for name, values in (("esfr", iso.value), ("esfr_std", iso.std)):
                curve[name] = np.interp(at, iso.frequency_per_mm, values)
        return {
            "channel": self.channel,
            "defocus_waves": self.defocus,
            "other_defocus_waves": self.other_defocus,
            "near_counts": self.near,
            "far_counts": self.far,
            "mtf50_per_mm": fit.mtf50,
            "mtf10_per_mm": fit.mtf10,
            "esfr_mtf50_per_mm": iso and iso.mtf50,
            "esfr_mtf10_per_mm": iso and iso.mtf10,
            "esfr_problem": self.iso_problem or None,
            "chi2_per_pixel": self.chi2_per_pixel,
            "pixels": self.pixels,
            "curve": curve,
        }

    @property
    def cells(self) -> list[str]:
        """Cells of the table from the channel on."""
        other = " or the reverse" if self.other_defocus is not None else ""
        return [
            self.channel,
            _shown(self.defocus) + other,
            _bare(self.fitted.mtf50),
            "" if self.iso is None else _bare(self.iso.mtf50),
            _bare(self.fitted.mtf10),
            "" if self.iso is None else _bare(self.iso.mtf10),
            f"{self.chi2_per_pixel:.2f}",
        ]


@dataclass(frozen=True)
class MeasuredEdge:
    """An edge in all its colours.

    Attributes
    ----------
    box : R0,C0,R1,C1 in the raw
    line : (2, 2) its ends, (row, column) in the raw
    range_mm : nan if the focus of the lens is unknown
    other : range on the other side of best focus, if the data do not exclude it
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
        names = [c.channel for c in self.channels]
        return self.channels[names.index(leading_channel(names))]

    @property
    def chi2_per_pixel(self) -> float:
        """χ² per pixel over all colours."""
        pixels = [c.pixels for c in self.channels]
        return float(np.average([c.chi2_per_pixel for c in self.channels], weights=pixels))

    @property
    def disagreements(self) -> list[str]:
        """Sentences on channels in which both methods contradict each other."""
        return [
            f"box {_box_words(self.box)}, {channel.disagreement}"
            for channel in self.channels
            if channel.disagreement
        ]

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "edges": the keys of the contract, then others."""
        main = self.main
        return {
            "box": list(self.box),
            "angle_deg": round(main.angle_deg.value, DIGITS),
            "range_mm": self.range_mm,
            "other_sign_mm": self.other,
            "mtf50_per_mm": main.fitted.mtf50,
            "esfr_mtf50_per_mm": main.iso and main.iso.mtf50.value,
            "chi2_per_pixel": self.chi2_per_pixel,
            "angle_std_deg": main.angle_deg.std,
            "line_px": [[round(float(v), 2) for v in end] for end in self.line],
            "channels": [channel.as_json() for channel in self.channels],
        }

    @property
    def rows(self) -> list[list[str]]:
        """Rows of the table, one for each colour."""
        first = [
            _box_words(self.box),
            f"{self.main.angle_deg.value:.2f}°",
            _shown(self.range_mm),
            "" if self.other is None else _shown(self.other),
        ]
        heads = [first, *[[""] * len(first)] * (len(self.channels) - 1)]
        return [[*head, *of.cells] for head, of in zip(heads, self.channels, strict=True)]


@dataclass(frozen=True)
class RejectedEdge:
    """A box without a fit, the reason in one line, and responses by ISO 12233 of an edge that the model does not explain."""

    box: Box
    why: str
    responses: Mapping[str, Esfr] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "rejected"."""
        channels = [
            {
                "channel": name,
                "esfr_mtf50_per_mm": iso.mtf50,
                "esfr_mtf10_per_mm": iso.mtf10,
                "curve": {
                    "per_mm": iso.frequency_per_mm,
                    "esfr": iso.value,
                    "esfr_std": iso.std,
                },
            }
            for name, iso in self.responses.items()
        ]
        return {"box": list(self.box), "why": self.why, "channels": channels}

    @property
    def rows(self) -> list[list[str]]:
        """Rows of the table, one for each channel with a response."""
        return [
            [
                *(_box_words(self.box) if k == 0 else "", "", "", "", name, "not fitted"),
                *("", _bare(iso.mtf50), "", _bare(iso.mtf10), ""),
            ]
            for k, (name, iso) in enumerate(self.responses.items())
        ]


@dataclass(frozen=True)
class EdgesOutcome:
    """All edges of a scene. wavefront: modes but defocus, waves RMS at the reference, if estimated with the edges."""

    edges: tuple[MeasuredEdge, ...]
    rejected: tuple[RejectedEdge, ...]
    warnings: tuple[str, ...] = ()
    wavefront: dict[int, Uncertain] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the answer by the contract, schema 1."""
        answer: dict[str, Any] = _json(
            {
                "schema": 1,
                "edges": [edge.as_json() for edge in self.edges],
                "rejected": [of.as_json() for of in self.rejected],
                "wavefront": {str(j): value for j, value in self.wavefront.items()} or None,
                "warnings": list(self.warnings),
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

        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        photograph = read_photograph(image, plan.sensor)
        try:
            grey = grey_image(photograph.light, photograph.pattern)
        except TargetError:  # nearly even
            rows, columns = photograph.shape
            grey = photograph.light[:rows, :columns] / photograph.full_light
        with styled():
            picture = png(draw_depth_map(grey, self))
        text = json.dumps(self.as_json(), indent=1, allow_nan=False).encode() + b"\n"
        written = {"edges.json": text, "edges.png": picture}
        for name, content in written.items():
            write_atomically(folder / name, content)
        return [folder / name for name in written]


def _json(value: Any) -> Any:
    """Return a value for JSON: numbers that are not finite become null, arrays have six digits."""
    match value:
        case Uncertain():
            return value.as_json()
        case np.ndarray():
            return [round(x, DIGITS) if math.isfinite(x) else None for x in value.tolist()]
        case float():
            return value if math.isfinite(value) else None
        case list():
            return [_json(each) for each in value]
        case dict():
            return {name: _json(each) for name, each in value.items()}
    return value


def _shown(value: Uncertain) -> str:
    return str(value) if math.isfinite(value.value) else "-"


def _bare(value: Uncertain) -> str:
    """Return a number without its unit."""
    return _shown(Uncertain(value.value, value.std))


def _box_words(box: Sequence[int]) -> str:
    """Return a box as the command line takes it."""
    return ",".join(map(str, box))
