"""How values are kept in JSON: tables with fields named as attributes, numbers, arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from math import degrees, isfinite, nan, radians
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from labkit.types import Floats
from labkit.uncertain import Uncertain

MOST_KEPT_WAVES = 1e3
"""RMS, of any mode."""

Made = TypeVar("Made")


@dataclass(frozen=True)
class Kept:
    """How a value is kept in JSON.

    Attributes
    ----------
    kind : type of the value in the file
    read, write : functions from the file's value, and back
    """

    kind: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_after_validator_function(
            self.read,
            handler.generate_schema(self.kind),
            serialization=core_schema.plain_serializer_function_ser_schema(self.write),
        )


class Entry(BaseModel):
    """A table of results.json. Unknown keys, of a later labkit, are left out."""

    model_config = ConfigDict(strict=True, frozen=True, protected_namespaces=())

    @classmethod
    def of(cls, source: object, **others: Any) -> Self:
        """Return the entry of an object with attributes of the same names. others: fields that are no attributes."""
        names = cls.model_fields.keys() - others
        held = {name: getattr(source, name) for name in names if hasattr(source, name)}
        return cls.model_construct(**held, **others)

    def made(self, kind: Callable[..., Made], **others: Any) -> Made:
        """Return the object of a data class whose fields are named as the entry's. others: its other fields."""
        names = {field.name for field in fields(kind)} & type(self).model_fields.keys()  # type: ignore[arg-type]
        held = {name: getattr(self, name) for name in names - others.keys()}
        return kind(**held, **others)

    def written(self) -> dict[str, Any]:
        """Return the entry as JSON."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


def table(entry: type[Entry], kind: Callable[..., Any]) -> Kept:
    """Return how objects of a data class are kept as a table."""
    return Kept(
        entry, lambda read: read.made(kind), lambda value: entry.of(value).written()
    )


def number(value: float | None) -> float:
    """Return a number; nan for None."""
    return nan if value is None else value


def null(value: float) -> float | None:
    """Return a number; None if not finite."""
    return float(value) if isfinite(value) else None


def numbers(values: Any) -> Floats:
    """Return an array; nan for None. Raises ValueError for rows of different lengths."""
    return np.array(values, dtype=float)


def listed(values: Floats) -> Any:
    """Return nested lists of numbers, None for numbers not finite."""
    values = np.asarray(values, float)
    if values.ndim > 1:
        return [listed(row) for row in values]
    return [null(value) for value in values]


def rounded(places: int) -> Kept:
    """Return how a number is kept to so many decimal places."""
    return Kept(Maybe, number, lambda x: round(x, places) if isfinite(x) else None)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Maybe = Finite | None
"""null stands for a number not finite, or not known."""

Number = Annotated[float, Kept(Maybe, number, null)]
Probability = Annotated[
    float, Kept(Annotated[Finite, Field(ge=0, le=1)] | None, number, null)
]
PositiveNumber = Annotated[float, Kept(Annotated[Finite, Field(gt=0)] | None, number, null)]
KnownStd = Annotated[Finite, Field(ge=0)]
Std = KnownStd | None
StdNumber = Annotated[float, Kept(Std, number, null)]
Waves = Annotated[Finite, Field(ge=-MOST_KEPT_WAVES, le=MOST_KEPT_WAVES)]
Nanometres = Annotated[Finite, Field(ge=10, le=100_000)]
Noll = Annotated[int, Field(ge=1, le=10_000)]
Range = Annotated[Finite, Field(gt=0, le=1e7)]
FNumber = Annotated[Finite, Field(ge=0.1, le=1e4)]
Place = Annotated[int, Field(ge=-(2**20), le=2**20)]
Size = Annotated[int, Field(ge=1, le=2**16)]
Text = Annotated[str, Field(max_length=10_000)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Degrees = Annotated[float, Kept(Finite, radians, degrees)]
"""An angle in radians, kept in degrees."""

Tenths = Annotated[float, rounded(1)]
Thousandths = Annotated[float, rounded(3)]
Pose = Annotated[tuple[Maybe, ...], Field(min_length=8, max_length=8)]
Corners = Annotated[tuple[tuple[Maybe, Maybe], ...], Field(min_length=4, max_length=4)]


def array(kind: Any, places: int | None = None) -> Kept:
    """Return how an array is kept. kind: its type in the file; places: decimal places, all of them for None."""
    return Kept(
        kind, numbers, lambda x: listed(x if places is None else np.round(x, places))
    )


Matrix = Annotated[Floats, array(tuple[tuple[Maybe, ...], ...])]
Powers = Annotated[Floats, array(tuple[Maybe, ...], 4)]


class NumberEntry(Entry):
    """A number with its standard error."""

    value: Maybe
    std: Std


class KnownEntry(NumberEntry):
    """A number that every use needs."""

    value: Finite


class PositiveEntry(NumberEntry):
    """A number above 0."""

    value: Annotated[Finite, Field(gt=0)]


def uncertain(unit: str = "", entry: type[NumberEntry] = NumberEntry) -> Kept:
    """Return how a number with its standard error is kept. unit: unit of the number, which the file does not hold."""

    def read(kept: NumberEntry) -> Uncertain:
        return Uncertain(number(kept.value), number(kept.std), unit)

    return Kept(entry, read, Uncertain.as_json)


Millimetres = Annotated[Uncertain, uncertain("mm")]
