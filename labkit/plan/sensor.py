"""The plan's [sensor]: sampling, and what files do not state of themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from labkit.errors import PlanError
from labkit.plan.fields import Allowed, Count, Number, matches, not_allowed, problem
from labkit.plan.table import Table

SPREAD = '0 to 3 pixels, [rows, columns] of such, or "fit"'
CFA = '"mono", "RGB" or four letters such as "RGGB"'
USUAL_SPREAD_PX = 0.5
"""Of a low-pass filter that is to be fitted, where a fit begins: a camera's is 0.4 to 1."""


def _spread(given: Any) -> Any:
    """Of a low-pass filter, as a plan may state it."""
    spreads = given if isinstance(given, (list, tuple)) else (given, given)
    numbers = len(spreads) == 2 and all(type(s) in (int, float) and 0 <= s <= 3 for s in spreads)
    if not (numbers or given == "fit"):
        raise not_allowed(SPREAD)
    return tuple(given) if isinstance(given, list) else given


class LowPassFilter(Table):
    """An optical low-pass filter before the sensor: how far apart its spots lie, in pixel pitches of the file.

    spread_px: along rows and columns alike, or [rows, columns], or "fit". turned: by 45 degrees.
    """

    spread_px: Annotated[float | tuple[float, float] | Literal["fit"], BeforeValidator(_spread)]
    turned: bool = False

    @property
    def squares(self) -> tuple[float, float]:
        """Of the spreads along rows and columns, pixels squared; where a fit is to begin."""
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
    """A tone curve as `labkit camera tone` measures it. light: of each step; numbers: that the camera wrote for it, shares of
    full scale, a list for each colour or one for all; std: their standard errors."""

    light: Annotated[tuple[Number, ...], Field(min_length=2)]
    numbers: Annotated[tuple[tuple[Number, ...], ...], Field(min_length=1)]
    std: tuple[tuple[Number, ...], ...] = ()

    @model_validator(mode="after")
    def _rising(self) -> MeasuredTone:
        for values in (self.light, *self.numbers):
            rising = all(low < high for low, high in pairwise(values)) and values[0] >= 0 and values[-1] <= 1
            if len(values) != len(self.light) or not rising:
                raise not_allowed(TONE)
        return self


def _tone(given: Any) -> Any:
    """Of `Sensor.tone_curve`, as a plan may state it."""
    if isinstance(given, MeasuredTone) or (isinstance(given, str) and given in ("file", "linear", "sRGB")):
        return given
    try:
        return MeasuredTone.from_tables(given if isinstance(given, Mapping) else {})
    except PlanError:
        raise not_allowed(TONE) from None


class Sensor(Table):
    """Sampling of the file, and what the file does not state of itself.

    pixel_pitch_um is between neighbouring samples of the file; fill_factor is active area over pitch squared;
    cfa_pattern reads the 2x2 cell row by row ("RGGB"), or is "mono", or "RGB" of pictures in colours, demosaiced already.
    tone_curve: what pictures that are no raw files went through, to be undone; "file": what each one states, sRGB where
    it is in colours and states nothing; or as measured. headerless_px: [rows, columns] of files that are 16-bit numbers and
    nothing else, the lower byte first.
    """

    pixel_pitch_um: Annotated[Number, AfterValidator(Allowed(0.1, 1000))]
    fill_factor: Annotated[Number, AfterValidator(Allowed(0.001, 1))] = 1.0
    cfa_pattern: Annotated[str, matches("mono|RGB|[A-Z]{4}", CFA)] | None = None
    black_level: Annotated[Number, AfterValidator(Allowed(0, 65535))] | None = None
    white_level: Annotated[Number, AfterValidator(Allowed(1, 65535))] | None = None
    headerless_px: Annotated[tuple[Pixels, Pixels] | None, Field(description=HEADERLESS)] = None
    low_pass_filter: LowPassFilter | None = None
    tone_curve: Annotated[Literal["file", "linear", "sRGB"] | MeasuredTone, BeforeValidator(_tone)] = "file"

    @property
    def active_um(self) -> float:
        """Side of a square pixel's active area."""
        return self.pixel_pitch_um * math.sqrt(self.fill_factor)

    @model_validator(mode="after")
    def _white_above_black(self) -> Sensor:
        if self.black_level is not None and self.white_level is not None and self.white_level <= self.black_level:
            raise problem(f"white_level = {self.white_level:g}: allowed is above black_level = {self.black_level:g}")
        return self
