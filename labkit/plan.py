"""What to do and with what: the plan, a TOML file checked before anything happens.

Attribute names are the TOML names; every physical field carries its unit in its name.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from labkit.errors import PlanError

Value = TypeVar("Value", str, float)

LAST_NOLL = 66
"""The last Zernike mode that can be asked for: all of the tenth radial order."""

NEEDED = {"sierpinski": "order", "tribar": "order", "checkerboard": "cells", "noise": "cells", "image": "file"}
"""Kind of target -> the field that it cannot do without."""

NOLL = f"[first, last] with 4 <= first <= last <= {LAST_NOLL}"
CORNERS = "four finite corners [row, col] of a convex quadrilateral, in order around it"


@dataclass(frozen=True, slots=True)
class Allowed:
    """A closed range of numbers, as a pydantic validator and as words for messages."""

    low: float
    high: float
    whole: bool = False

    def __call__(self, value: float) -> float:
        if not self.low <= value <= self.high:
            raise PydanticCustomError("allowed", "{words}", {"words": f"allowed is {self}"})
        return value

    def __str__(self) -> str:
        return f"{'a whole' if self.whole else 'a'} number, {self.low:.10g} to {self.high:.10g}"


def _matches(pattern: str, words: str) -> AfterValidator:
    def check(value: str) -> str:
        if not re.fullmatch(pattern, value):
            raise PydanticCustomError("allowed", "{words}", {"words": f"allowed is {words}"})
        return value

    return AfterValidator(check)


Number = Annotated[float, Strict()]
Count = Annotated[int, Strict()]
Corner = tuple[Number, Number]
Length = Annotated[Number, AfterValidator(Allowed(1e-3, 1e6))]
Name = Annotated[str, _matches(r"[A-Za-z][A-Za-z0-9]*", "a letter, then letters and digits")]
Address = Annotated[str, _matches(r"[a-z][a-z0-9]*:\S*", "driver:where, such as simulated: or grbl:/dev/ttyUSB0")]


REFERENCE_NM = 450.0


class Table(BaseModel):
    """A table of the plan: frozen, and unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Lens(Table):
    """The lens as engraved: nominal values are enough."""

    focal_length_mm: Annotated[Number, AfterValidator(Allowed(0.1, 10_000))]
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))]


class Sensor(Table):
    """Sampling of the file, and what the file does not say of itself.

    pixel_pitch_um is between neighbouring samples of the file; fill_factor is active area over pitch squared;
    cfa_pattern reads the 2x2 cell row by row ("RGGB"), or is "mono".
    """

    pixel_pitch_um: Annotated[Number, AfterValidator(Allowed(0.1, 1000))]
    fill_factor: Annotated[Number, AfterValidator(Allowed(0.001, 1))] = 1.0
    cfa_pattern: Annotated[str, _matches("mono|[A-Z]{4}", '"mono" or four letters such as "RGGB"')] | None = None
    black_level: Annotated[Number, AfterValidator(Allowed(0, 65535))] | None = None
    white_level: Annotated[Number, AfterValidator(Allowed(1, 65535))] | None = None

    @property
    def active_um(self) -> float:
        """Side of a square pixel's active area."""
        return self.pixel_pitch_um * math.sqrt(self.fill_factor)

    @model_validator(mode="after")
    def _white_above_black(self) -> Sensor:
        if self.black_level is not None and self.white_level is not None and self.white_level <= self.black_level:
            raise _problem(f"white_level = {self.white_level:g}: allowed is above black_level = {self.black_level:g}")
        return self


class Channel(Table):
    """A colour of the filter array and the one wavelength that stands for it."""

    name: Name
    wavelength_nm: Annotated[Number, AfterValidator(Allowed(100, 20_000))]


class TargetSpec(Table):
    """What was photographed. `file` is absolute once a plan is loaded.

    order: of a carpet, or octaves of a tri-bar target; cells: along a side of a checkerboard or of noise, which `seed` draws;
    angle_deg: by which a slanted edge leans.
    """

    kind: Annotated[str, _matches("[a-z][a-z0-9_]*", "the name of a target, such as sierpinski or image")]
    size_mm: Length
    order: Annotated[Count, AfterValidator(Allowed(1, 8, whole=True))] | None = None
    cells: Annotated[Count, AfterValidator(Allowed(1, 4096, whole=True))] | None = None
    seed: Annotated[Count, AfterValidator(Allowed(0, 2**32 - 1, whole=True))] = 0
    angle_deg: Annotated[Number, AfterValidator(Allowed(-45, 45))] = 5.0
    surround: Literal["black", "white", "unknown"] = "black"
    file: Path | None = None
    corners_px: Annotated[tuple[Corner, Corner, Corner, Corner] | None, Field(description=CORNERS)] = None

    @field_validator("file")
    @classmethod
    def _absolute(cls, file: Path | None, info: ValidationInfo) -> Path | None:
        folder: Path = (info.context or {}).get("folder", Path())
        return None if file is None else (folder / file).absolute()

    @field_validator("corners_px")
    @classmethod
    def _convex(cls, corners: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if corners is not None and not _is_convex(corners):
            raise PydanticCustomError("allowed", "{words}", {"words": f"allowed is {CORNERS}"})
        return corners

    @model_validator(mode="after")
    def _complete(self) -> TargetSpec:
        key = NEEDED.get(self.kind)
        if key is not None and getattr(self, key) is None:
            raise _problem(f'{key} is missing: kind = "{self.kind}" needs it')
        if self.file is not None and not self.file.is_file():
            raise _problem(f'file = "{self.file}": there is no such file')
        return self


class FitSettings(Table):
    """What to estimate: Zernike modes by Noll index, the wavelength that waves are counted in, the focus model.

    range_std_mm: standard error of each range beside the others, for the errors of best focus and pupil magnification.
    """

    zernike_noll: Annotated[tuple[Count, Count], Field(description=NOLL)] = (4, 15)
    reference_wavelength_nm: Annotated[Number, AfterValidator(Allowed(100, 20_000))] | None = None
    convention: Literal["corrected", "thesis"] = "corrected"
    range_std_mm: Annotated[Number, AfterValidator(Allowed(0, 1000))] = 0.0

    @field_validator("zernike_noll")
    @classmethod
    def _ordered(cls, noll: tuple[int, int]) -> tuple[int, int]:
        if not 4 <= noll[0] <= noll[1] <= LAST_NOLL:
            raise PydanticCustomError("allowed", "{words}", {"words": f"allowed is {NOLL}"})
        return noll


class CameraSettings(Table):
    """How to expose. f_number: what to set on the body, lens.f_number if it is left out."""

    address: Address
    exposure_s: Annotated[Number, AfterValidator(Allowed(1e-5, 3600))]
    iso: Annotated[Count, AfterValidator(Allowed(1, 10_000_000, whole=True))] = 100
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))] | None = None
    capture_target: Literal["ram", "card"] = "ram"
    frames_per_range: Annotated[Count, AfterValidator(Allowed(1, 10_000, whole=True))] = 4
    flats_per_range: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8
    darks: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8


class RailSettings(Table):
    """Where to stop: range = range_at_zero_mm + direction * rail position.

    run_up_mm: every stop is approached from below over this way; microstep_um: what a Zaber counts in.
    """

    address: Address
    ranges_mm: Annotated[tuple[Length, ...], Field(min_length=1, description="one or more ranges in mm")]
    range_at_zero_mm: Annotated[Number, AfterValidator(Allowed(-1e6, 1e6))]
    direction: Literal[1, -1] = 1
    settle_s: Annotated[Number, AfterValidator(Allowed(0, 3600))] = 1.0
    run_up_mm: Annotated[Number, AfterValidator(Allowed(0, 100))] = 1.0
    microstep_um: Annotated[Number, AfterValidator(Allowed(1e-4, 1e4))] | None = None

    @field_validator("ranges_mm")
    @classmethod
    def _once_each(cls, ranges_mm: tuple[float, ...]) -> tuple[float, ...]:
        if twice := _repeated(ranges_mm):
            raise PydanticCustomError(
                "allowed", "{words}", {"words": f"allowed is each range once, not {twice[0]:g} twice"}
            )
        return ranges_mm

    def position_mm(self, range_mm: float) -> float:
        """Where the rail stands at a range."""
        return self.direction * (range_mm - self.range_at_zero_mm)

    def range_mm(self, position_mm: float) -> float:
        """The range when the rail stands at a position."""
        return self.range_at_zero_mm + self.direction * position_mm


class DisplaySettings(Table):
    """The glass the target is shown on: a panel by name, or its pitch and (height, width) in pixels."""

    address: Address
    panel: str | None = None
    pixel_pitch_mm: Length | None = None
    pixels: Annotated[tuple[Count, Count] | None, Field(description="[height, width] in pixels")] = None

    @model_validator(mode="after")
    def _one_way(self) -> DisplaySettings:
        if (self.pixel_pitch_mm is None) != (self.pixels is None):
            raise _problem("pixel_pitch_mm and pixels belong together: give both or neither")
        if (self.panel is None) == (self.pixels is None):
            raise _problem("give either panel, or pixel_pitch_mm and pixels")
        if self.pixels is not None and min(self.pixels) < 1:
            raise _problem(f"pixels = {list(self.pixels)}: allowed is [height, width], each at least 1")
        return self


class Plan(Table):
    """Everything about a session that the photographs do not say."""

    lens: Lens
    sensor: Sensor
    channel: Annotated[tuple[Channel, ...], Field(min_length=1, description="one or more [[channel]] tables")]
    target: TargetSpec
    fit: FitSettings = FitSettings()
    camera: CameraSettings | None = None
    rail: RailSettings | None = None
    display: DisplaySettings | None = None

    @property
    def reference_wavelength_nm(self) -> float:
        """What waves are counted in: as [fit] says; else 450 nm, or of a single channel its own wavelength."""
        if self.fit.reference_wavelength_nm is not None:
            return self.fit.reference_wavelength_nm
        return self.channel[0].wavelength_nm if len(self.channel) == 1 else REFERENCE_NM

    @model_validator(mode="after")
    def _consistent(self) -> Plan:
        if problems := [*self._channel_problems(), *self._range_problems()]:
            raise _problem("; ".join(problems))
        return self

    def _channel_problems(self) -> Iterator[str]:
        names = [channel.name for channel in self.channel]
        pattern = self.sensor.cfa_pattern
        for name in _repeated(names):
            yield f'channel.name = "{name}" stands twice: allowed is each name once'
        if pattern == "mono" and len(names) > 1:
            yield f'{len(names)} [[channel]] tables: allowed is exactly one for cfa_pattern = "mono"'
        for name in names:
            if pattern not in (None, "mono") and name not in str(pattern):
                yield f'channel.name = "{name}": allowed is a colour of cfa_pattern = "{pattern}"'

    def _range_problems(self) -> Iterator[str]:
        focal_mm = self.lens.focal_length_mm
        for range_mm in self.rail.ranges_mm if self.rail else ():
            if range_mm <= focal_mm:
                yield f"rail.ranges_mm has {range_mm:g} mm: allowed is more than the focal length, {focal_mm:g} mm"


def load_plan(path: Path) -> Plan:
    """The plan in a TOML file. Raises PlanError, one line that names every field that is wrong."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise PlanError(f"plan {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise PlanError(f"plan {path}: not UTF-8 at byte {error.start}") from error
    try:
        return parse_plan(text, path.parent)
    except PlanError as error:
        raise PlanError(f"plan {path}: {error}") from error


def parse_plan(text: str, folder: Path) -> Plan:
    """The plan in `text`; a target's file is relative to `folder`. Raises PlanError."""
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlanError(f"not TOML: {error}") from error
    try:
        return Plan.model_validate(tables, context={"folder": folder})
    except ValidationError as error:
        raise PlanError("; ".join(_message(detail) for detail in error.errors())) from None


def _problem(words: str) -> PydanticCustomError:
    """A problem of a whole table; `words` name the field."""
    return PydanticCustomError("problem", "{words}", {"words": words})


def _repeated(values: Iterable[Value]) -> list[Value]:
    return [value for value, times in Counter(values).items() if times > 1]


def _is_convex(corners: tuple[tuple[float, float], ...]) -> bool:
    """Whether going round the corners turns the same way at each."""
    turns = []
    for i in range(4):
        (r0, c0), (r1, c1), (r2, c2) = corners[i - 2], corners[i - 1], corners[i]
        turns.append((r1 - r0) * (c2 - c1) - (c1 - c0) * (r2 - r1))
    return all(math.isfinite(t) for t in turns) and (min(turns) > 0 or max(turns) < 0)


def _message(detail: ErrorDetails) -> str:
    """One problem as words: field, value, what is allowed."""
    where = ".".join(str(step) for step in detail["loc"])
    match detail["type"]:
        case "problem":
            return f"{where}.{detail['msg']}" if where else detail["msg"]
        case "extra_forbidden":
            return _unknown_key(detail["loc"], where)
        case "missing":
            needs = _needs(detail["loc"])
            return f"{where} is missing" + (f": needs {needs}" if needs else "")
        case "allowed":
            reason = detail["msg"]
        case _:
            expected = detail["msg"].removeprefix("Input should be ")
            reason = f"allowed is {_needs(detail['loc']) or expected}"
    return f"{where} = {_short(detail['input'])}: {reason}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _table(loc: tuple[int | str, ...]) -> type[Table]:
    """The table that a location lies in."""
    tables: dict[str, type[Table]] = {
        "lens": Lens,
        "sensor": Sensor,
        "channel": Channel,
        "target": TargetSpec,
        "fit": FitSettings,
        "camera": CameraSettings,
        "rail": RailSettings,
        "display": DisplaySettings,
    }
    return tables.get(str(loc[0]), Plan) if len(loc) > 1 else Plan


def _unknown_key(loc: tuple[int | str, ...], where: str) -> str:
    known = list(_table(loc).model_fields)
    near = difflib.get_close_matches(str(loc[-1]), known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
    return f"{where} is no known key; {hint}"


def _needs(loc: tuple[int | str, ...]) -> str:
    """What a field takes, in words; empty where its type says it all."""
    names = [step for step in loc if isinstance(step, str)]
    field = _table(loc).model_fields.get(names[min(1, len(names) - 1)])
    if field is None:
        return ""
    if field.description:
        return field.description
    optional = [item for part in get_args(field.annotation) for item in getattr(part, "__metadata__", ())]
    for item in (*field.metadata, *optional):
        if isinstance(item, AfterValidator) and isinstance(item.func, Allowed):
            return str(item.func)
    return ""
