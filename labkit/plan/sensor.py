"""The plan's [sensor]: sampling, and properties that files do not state themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from labkit.errors import PlanError, RawError
from labkit.plan.fields import (
    Allowed,
    Count,
    Number,
    Takes,
    matches,
    not_allowed,
    or_fit,
    problem,
)
from labkit.plan.table import Table
from labkit.spectra import TYPICAL, body_of, tables

if TYPE_CHECKING:
    from labkit.types import Bools

MONO = ("M",)
"""Pattern of a sensor without filters."""

IN_COLOURS = ("RGB",)
"""Pattern of a picture with every colour at every pixel, one colour beside the other as in its file."""

Pattern = tuple[str, ...]
Place = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ChannelPixels:
    """The pixels of one channel: (row, column) of each plane in a cell that repeats every `period` pixels."""

    places: tuple[Place, ...]
    period: int

    @property
    def spacing_px(self) -> float:
        """Side of the square that each pixel of the channel has for itself."""
        return self.period / sqrt(len(self.places))

    def mask(self, shape: tuple[int, ...]) -> Bools:
        """Return an array of `shape` (..., rows, columns), True for the channel's pixels."""
        import numpy as np  # a plan is checked without it

        mask = np.zeros(shape, dtype=np.bool_)
        for row, column in self.places:
            mask[..., row :: self.period, column :: self.period] = True
        return mask


def pattern_of(cfa: str) -> Pattern:
    """Return the pattern of a filter array as a plan writes it: "RGGB", "mono" or "RGB"."""
    return {"mono": MONO, "RGB": IN_COLOURS}.get(cfa, (cfa[:2], cfa[2:]))


def places_of(pattern: Pattern, name: str) -> tuple[Place, ...]:
    """Return (row, column) of each pixel of a colour in the cell.

    A mono sensor has a single pixel in the cell, whatever the name. Raises RawError for a
    colour that the filter array lacks.
    """
    if pattern == MONO:
        return ((0, 0),)
    places = tuple(
        (row, column)
        for row, colours in enumerate(pattern)
        for column, colour in enumerate(colours)
        if colour == name
    )
    if not places:
        raise RawError(f"no channel {name} in this filter array: {''.join(pattern)}")
    return places


def channel_pixels(pattern: Pattern, name: str) -> ChannelPixels:
    """Return the pixels of a colour: all of them on a mono sensor or in a picture in colours.

    Raises RawError for a colour that the filter array lacks.
    """
    if pattern in (MONO, IN_COLOURS):
        return ChannelPixels(((0, 0),), 1)
    return ChannelPixels(places_of(pattern, name), len(pattern))


SPREAD = '0 to 3 pixels, [rows, columns] of such, or "fit"'
BAYER = "RGGB"
"""Usual filter array; the other orders of its cell have as many pixels of each colour."""

CFA = '"mono", "RGB" or four letters such as "RGGB"'
USUAL_SPREAD_PX = 0.5
"""Of a low-pass filter that is to be fitted, where a fit begins: a camera's is 0.4 to 1."""


def _spread(given: Any) -> Any:
    """Return a low-pass filter's or a smear's spread from a plan's value."""
    spreads = given if isinstance(given, (list, tuple)) else (given, given)
    numbers = len(spreads) == 2 and all(
        type(s) in (int, float) and 0 <= s <= 3 for s in spreads
    )
    if not (numbers or given == "fit"):
        raise not_allowed(SPREAD)
    return tuple(given) if isinstance(given, list) else given


class LowPassFilter(Table):
    """An optical low-pass filter in front of the sensor. Without this table `labkit fit` assumes no filter, and
    tests for one.
    """

    spread_px: Annotated[
        float | tuple[float, float] | Literal["fit"],
        BeforeValidator(_spread),
        Takes(SPREAD),
    ]
    """Distance between the filter's spots, in pixel pitches of the file: equal along rows and columns, or
    `[rows, columns]`; `"fit"` estimates the distance.
    """
    turned: bool = False
    """Whether the spots lie on the diagonals, turned by 45°."""

    @property
    def squares(self) -> tuple[float, float]:
        """Squared spreads along rows and columns, in pixels squared, at the start of a fit."""
        spread = USUAL_SPREAD_PX if self.spread_px == "fit" else self.spread_px
        rows, columns = spread if isinstance(spread, tuple) else (spread, spread)
        return float(rows) ** 2, float(columns) ** 2


TONE = (
    '"file", "linear", "sRGB", or a table of light and numbers, each rising from 0 or more to 1 or less and equally many, '
    "as labkit camera tone prints it"
)


Pixels = Annotated[Count, AfterValidator(Allowed(2, 65536, whole=True))]
HEADERLESS = "[rows, columns], each from 2 to 65536"


class MeasuredTone(Table):
    """A tone curve measured by `labkit camera tone`."""

    light: Annotated[
        tuple[Number, ...],
        Field(min_length=2),
        Takes("rising numbers, 0 to 1, two or more"),
    ]
    """Light of each step, as a share of white's."""
    numbers: Annotated[
        tuple[tuple[Number, ...], ...],
        Field(min_length=1),
        Takes("rising numbers, 0 to 1, as many"),
    ]
    """The camera's number for each step, as a share of full scale: one list for each colour, or one for all."""
    std: Annotated[
        tuple[tuple[Number, ...], ...], Takes("as many numbers as in `numbers`")
    ] = ()
    """Standard errors of `numbers`."""

    @model_validator(mode="after")
    def _rising(self) -> MeasuredTone:
        for values in (self.light, *self.numbers):
            rising = (
                all(low < high for low, high in pairwise(values))
                and values[0] >= 0
                and values[-1] <= 1
            )
            if len(values) != len(self.light) or not rising:
                raise not_allowed(TONE)
        return self


def _tone(given: Any) -> Any:
    """Return `Sensor.tone_curve` from a plan's value."""
    if isinstance(given, MeasuredTone) or (
        isinstance(given, str) and given in ("file", "linear", "sRGB")
    ):
        return given
    try:
        return MeasuredTone.from_tables(given if isinstance(given, Mapping) else {})
    except PlanError:
        raise not_allowed(TONE) from None


FILTERS = f"{TYPICAL}, or one of {', '.join(tables().filters)}"


def _filters(given: str) -> str:
    """Return the name in the table of a camera, in the form that files write or in the table's."""
    body = TYPICAL if given == TYPICAL else body_of(given)
    if body is None:
        raise not_allowed(FILTERS)
    return body


class Sensor(Table):
    """The sensor's sampling, and properties that image files do not state. Raw files state their colour filter
    pattern and their levels: omit these keys.
    """

    pixel_pitch_um: Annotated[Number, AfterValidator(Allowed(0.1, 1000))]
    """Distance between neighbouring samples of the file."""
    fill_factor: Annotated[Number, AfterValidator(Allowed(0.001, 1))] = 1.0
    """Active area of a pixel over the square of the pitch."""
    cfa_pattern: Annotated[str, matches("mono|RGB|[A-Z]{4}", CFA)] | None = None
    """The 2 × 2 cell of the colour filter array, row by row, such as `"RGGB"`; `"mono"` for a sensor without filters; `"RGB"`
    for pictures in which every pixel has all three colours. Default: as the files state."""
    filters_removed: bool = False
    """Whether the colour filters were taken off the sensor, whose files state them still: with `cfa_pattern = "mono"`
    all pixels are then one channel.
    """
    black_level: Annotated[Number, AfterValidator(Allowed(0, 65535))] | None = None
    """Count without light. Default: as the files state."""
    white_level: Annotated[Number, AfterValidator(Allowed(1, 65535))] | None = None
    """Count at saturation; above the black level. Default: as the files state."""
    headerless_px: Annotated[tuple[Pixels, Pixels] | None, Takes(HEADERLESS)] = None
    """Size of files of bare 16-bit numbers, lower byte first. Default: the files have headers."""
    filters: Annotated[str, AfterValidator(_filters), Takes(FILTERS)] | None = None
    """Body in labkit's table of colour filters, for channels that name their light; `"typical"` for the mean of
    all bodies. Default: the body that the photographs name, or else `"typical"`.
    """
    low_pass_filter: LowPassFilter | None = None
    diffusion_px: Annotated[
        float | Literal["fit"] | None, or_fit(0, 2), Takes('0 to 2, or "fit"')
    ] = None
    """Standard deviation of the charge's diffusion, in pixel pitches of the file; `"fit"` estimates it.
    Default: none, and `labkit fit` tests for diffusion.
    """
    smear_px: Annotated[
        float | tuple[float, float] | Literal["fit"] | None,
        BeforeValidator(_spread),
        Takes(SPREAD),
    ] = None
    """Standard deviation of the camera's or rail's shake during the exposure, in pixel pitches of the file:
    equal along rows and columns, or `[rows, columns]`; `"fit"` estimates it. Default: none, and `labkit fit`
    tests for shake.
    """
    tone_curve: Annotated[
        Literal["file", "linear", "sRGB"] | MeasuredTone,
        BeforeValidator(_tone),
        Takes(TONE),
    ] = "file"
    """Tone curve of processed pictures (JPEG, PNG, TIFF in colours), which labkit inverts. `"file"`: the curve
    stated by each file, sRGB if a picture in colours states none. `"linear"`: none. A table: as measured by
    `labkit camera tone`.
    """

    @property
    def active_um(self) -> float:
        """Side of a square pixel's active area."""
        return self.pixel_pitch_um * sqrt(self.fill_factor)

    def assumed_pattern(self, channel: str) -> str:
        """Return `cfa_pattern`; without this key a Bayer array for its colours, "mono" for other channels."""
        if self.cfa_pattern is not None:
            return self.cfa_pattern
        return BAYER if channel in BAYER else "mono"

    def pixels(self, channel: str) -> ChannelPixels:
        """Return a channel's pixels by `assumed_pattern`. Raises RawError for a colour that the array lacks."""
        return channel_pixels(pattern_of(self.assumed_pattern(channel)), channel)

    @model_validator(mode="after")
    def _white_above_black(self) -> Sensor:
        if (
            self.black_level is not None
            and self.white_level is not None
            and self.white_level <= self.black_level
        ):
            raise problem(
                f"white_level = {self.white_level:g}: allowed is above black_level = {self.black_level:g}"
            )
        return self

    @model_validator(mode="after")
    def _mono_without_filters(self) -> Sensor:
        if self.filters_removed and self.cfa_pattern != "mono":
            raise problem('filters_removed = true: needs cfa_pattern = "mono" beside it')
        return self
