"""The tables of a plan about the whole field: its tiles, the limits to judge by, the mount's screws."""

from __future__ import annotations

from statistics import fmean
from typing import Annotated, Literal

from pydantic import AfterValidator, field_validator, model_validator

from labkit.plan.fields import (
    Allowed,
    Corner,
    Count,
    Length,
    Number,
    Takes,
    not_allowed,
    problem,
)
from labkit.plan.table import Table

MOST_FIELD_ORDER = 8
"""The largest radial order of the field's polynomials: 45 of them."""

CATS_EYE_WORDS = "[shift, radius]: a shift from -1.4 to 1.4 and a radius from 1 to 5"
TILES_WORDS = "[rows, columns], each from 1 to 1000"
PART_WORDS = "[[top, left], [bottom, right]] in pixels of the photograph, 32 or more apart"
SCREWS_WORDS = "three or four places [x, y] in mm, not all on one line"

LEAST_SPREAD = 0.02
"""Extent of the screws across the line nearest to all of them, over their extent along it."""

LEAST_STATED_PX = 32

Rectangle = tuple[Corner, Corner]
Tiles = Annotated[Count, AfterValidator(Allowed(1, 1000, whole=True))]
Shift = Annotated[Number, AfterValidator(Allowed(-1.4, 1.4))]
Radius = Annotated[Number, AfterValidator(Allowed(1, 5))]


class FieldSettings(Table):
    """The tiles that a target fills the frame with, and the wavefront's expansion over the frame."""

    tiles: Annotated[tuple[Tiles, Tiles] | None, Takes(TILES_WORDS)] = None
    """Rows and columns of tiles into which a single target is cut; [1, 1] fits it whole. Default: the targets of
    `target.grid`; of a single target up to 360 pixels one tile, of a larger one up to 5 × 5 tiles of 240 pixels, where it
    has detail."""
    pitch_px: Annotated[Number, AfterValidator(Allowed(16, 100_000))] | None = None
    """Side of the tiles into which a single large target is cut, instead of `tiles`. Default: none."""
    part_px: Annotated[Rectangle | None, Takes(PART_WORDS)] = None
    """Part of a single large target fitted alone, as one tile: [[top, left], [bottom, right]], row and column in the
    photographs of the nearest range. Default: none."""
    order: (
        Annotated[Count, AfterValidator(Allowed(1, MOST_FIELD_ORDER, whole=True))] | None
    ) = None
    """Highest radial order of the polynomials in the place on the frame: 1 for tilt and decentre alone, 2 with curvature.
    Default: as high as the photographs show."""

    cats_eye: Annotated[tuple[Shift, Radius] | None, Takes(CATS_EYE_WORDS)] = None
    """Circle that cuts the pupil to a cat's eye away from the middle of the frame, where it is known: its shift in the
    corners, along the image height, and its radius, over the full pupil's. Default: `labkit fit` looks for it."""

    @property
    def cuts(self) -> bool:
        """Return whether a single target is cut into tiles."""
        return self.tiles is not None or self.pitch_px is not None

    @model_validator(mode="after")
    def _one_way(self) -> FieldSettings:
        if self.tiles is not None and self.pitch_px is not None:
            raise problem("tiles and pitch_px exclude each other: give one of both")
        if self.part_px is not None and self.cuts:
            raise problem(
                "part_px is fitted alone: leave out tiles and pitch_px, or part_px"
            )
        return self

    @field_validator("part_px")
    @classmethod
    def _rectangle(cls, part: Rectangle | None) -> Rectangle | None:
        if part is not None:
            (top, left), (bottom, right) = part
            if min(bottom - top, right - left) < LEAST_STATED_PX:
                raise not_allowed(PART_WORDS)
        return part


AtLeast = Annotated[
    Number, AfterValidator(Allowed(0, 1e6)), Takes("a number, the least that passes")
]
Modulation = Annotated[
    Number, AfterValidator(Allowed(0, 1)), Takes("0 to 1, the least that passes")
]
AtMost = Annotated[
    Number, AfterValidator(Allowed(0, 1e6)), Takes("a number, the most that passes")
]


class Limits(Table):
    """Limits to judge the lens and its mount by: pass, fail, or cannot tell. Each key is a limit, of the leading channel
    (G, or the first)."""

    confidence: Annotated[Number, AfterValidator(Allowed(0.5, 0.9999))] = 0.95
    """Least probability of a verdict: a number passes or fails only where its standard error leaves no more doubt."""
    centre_mtf50: AtLeast | None = None
    """Frequency, cycles/mm, at which the MTF of the optics is a half at the frame's centre, in the worse direction.
    Default: not judged."""
    centre_mtf_at_10: Modulation | None = None
    """MTF of the optics at 10 cycles/mm at the frame's centre, in the worse direction. Default: not judged."""
    centre_mtf_at_20: Modulation | None = None
    """MTF of the optics at 20 cycles/mm at the frame's centre, in the worse direction. Default: not judged."""
    centre_mtf_at_40: Modulation | None = None
    """MTF of the optics at 40 cycles/mm at the frame's centre, in the worse direction. Default: not judged."""
    edge_mtf50: AtLeast | None = None
    """Frequency, cycles/mm, at which the MTF of the optics is a half in the middle of the worst side, in the worse
    direction. Default: not judged."""
    edge_mtf_at_10: Modulation | None = None
    """MTF of the optics at 10 cycles/mm in the middle of the worst side, in the worse direction. Default: not judged."""
    edge_mtf_at_20: Modulation | None = None
    """MTF of the optics at 20 cycles/mm in the middle of the worst side, in the worse direction. Default: not judged."""
    edge_mtf_at_40: Modulation | None = None
    """MTF of the optics at 40 cycles/mm in the middle of the worst side, in the worse direction. Default: not judged."""
    corner_mtf50: AtLeast | None = None
    """Frequency, cycles/mm, at which the MTF of the optics is a half in the worst corner, in the worse direction.
    Default: not judged."""
    corner_mtf_at_10: Modulation | None = None
    """MTF of the optics at 10 cycles/mm in the worst corner, in the worse direction. Default: not judged."""
    corner_mtf_at_20: Modulation | None = None
    """MTF of the optics at 20 cycles/mm in the worst corner, in the worse direction. Default: not judged."""
    corner_mtf_at_40: Modulation | None = None
    """MTF of the optics at 40 cycles/mm in the worst corner, in the worse direction. Default: not judged."""
    tilt_um_per_mm: AtMost | None = None
    """Tilt of the sensor: the slope of the focal surface, µm of focus for each mm on the sensor. Default: not judged."""
    tilt_um: AtMost | None = None
    """The same as focus error from one corner of the frame to the opposite, µm. Default: not judged."""
    tilt_arcmin: AtMost | None = None
    """The same in minutes of arc. Default: not judged."""
    curvature_per_mm: AtMost | None = None
    """Curvature of the focal surface, mm of focus for each mm² of image height squared, of either sign. Default: not judged."""
    curvature_um: AtMost | None = None
    """The same as focus error in the corners against the centre, µm, of either sign. Default: not judged."""
    astigmatism_um: AtMost | None = None
    """Distance of sagittal and tangential focus, µm, the largest of centre, sides and corners. Default: not judged."""
    focal_surface_um: AtMost | None = None
    """Focus error over the frame that the best plane leaves, peak to valley, µm. Default: not judged."""
    coma_waves: AtMost | None = None
    """Constant coma, the mark of a decentred lens: waves RMS at the reference wavelength. Default: not judged."""
    linear_astigmatism_waves: AtMost | None = None
    """Astigmatism of a decentred lens, which grows with height: in the corners, waves RMS. Default: not judged."""
    distortion_percent: AtMost | None = None
    """Distortion in the worst corner, per cent of its image height, of either sign. Default: not judged."""
    lateral_colour_um: AtMost | None = None
    """Lateral colour in the worst corner: distance of two channels' images, µm. Default: not judged."""

    @property
    def stated(self) -> dict[str, float]:
        """The limits that the plan states, by name."""
        return self.model_dump(exclude_none=True, exclude={"confidence"})

    @staticmethod
    def is_least(name: str) -> bool:
        """Return whether a limit is the least that passes; any other is the most."""
        return "_mtf" in name


class Mount(Table):
    """The screws that tilt the sensor, or the mount, against the lens."""

    screws_mm: Annotated[tuple[Corner, ...] | None, Takes(SCREWS_WORDS)] = None
    """Places of three or four screws, mm from the middle of the frame: x to the right and y down as in the photographs.
    Default: none."""
    screw_pitch_mm: Length | None = None
    """Pitch of the screws' thread, mm a turn. Default: none; turns are then given as shims alone."""
    clockwise: Literal["away", "towards"] | None = None
    """Way in which a clockwise turn moves the sensor at the screw: away from the lens, or towards the lens. `labkit field
    check-move` proves it. Default: not proven; turns are then given without a sense."""

    @field_validator("screws_mm")
    @classmethod
    def _plane(
        cls, screws: tuple[tuple[float, float], ...] | None
    ) -> tuple[tuple[float, float], ...] | None:
        if screws is not None and not _hold_a_plane(screws):
            raise not_allowed(SCREWS_WORDS)
        return screws

    @model_validator(mode="after")
    def _complete(self) -> Mount:
        for key in ("screw_pitch_mm", "clockwise"):
            if getattr(self, key) is not None and self.screws_mm is None:
                raise problem(f"screws_mm is missing: {key} alone turns no screw")
        return self


def _hold_a_plane(screws: tuple[tuple[float, float], ...]) -> bool:
    """Return whether three or four screws determine a plane."""
    if len(screws) not in (3, 4) or not all(abs(mm) < 1e4 for at in screws for mm in at):
        return False
    xs, ys = zip(*screws, strict=True)
    right = [x - fmean(xs) for x in xs]
    down = [y - fmean(ys) for y in ys]
    xx = _dot(right, right)
    yy = _dot(down, down)
    xy = _dot(right, down)
    # the moments' determinant over their squared trace: the square of the ratio of both extents
    return xx * yy - xy**2 > (LEAST_SPREAD * (xx + yy)) ** 2


def _dot(a: list[float], b: list[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))
