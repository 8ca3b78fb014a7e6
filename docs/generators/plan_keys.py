"""Every key of a plan, from the models that check it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from docs.generators.markdown import code, directive, table
from labkit.panel.panels import PANELS
from labkit.plan import Plan
from labkit.plan.fields import what_it_takes
from labkit.plan.tables import NEEDED_BY_KIND
from labkit.spectra import COLOURS, LIGHT_KINDS, TYPICAL, channel_light

UNITS = {"mm": "mm", "um": "µm", "nm": "nm", "px": "pixels", "s": "s", "deg": "degrees"}
"""What the last part of a key stands for."""

BY_TYPE = {bool: "`true` or `false`", str: "text", int: "a whole number", float: "a number"}


def plan_keys() -> str:
    """A section for each table, an entry for each key: unit, what is allowed, default, meaning."""
    return "\n".join(_section(name, field) for name, field in Plan.model_fields.items())


def panels() -> str:
    """The panels that a plan can name."""
    rows = [
        [
            "`display.panel`",
            "pixels, height × width",
            "pitch / mm",
            "lit area, height × width / mm",
        ]
    ]
    for name, panel in PANELS.items():
        (height, width), (high_mm, wide_mm) = panel.pixels, panel.size_mm
        rows.append(
            [
                code(name),
                f"{height} × {width}",
                f"{panel.pitch_mm:.5f}",
                f"{high_mm:.1f} × {wide_mm:.1f}",
            ]
        )
    return table(rows)


def lights() -> str:
    """The kinds of light that a plan can name: mean and standard deviation of the wavelengths through typical filters."""
    rows = [["`channel.light`", "spectra", *(f"{colour} / nm" for colour in COLOURS)]]
    for kind, spectra in LIGHT_KINDS.items():
        through = [channel_light(kind, TYPICAL, colour) for colour in COLOURS]
        moments = [
            f"{light.mean.value:.0f} ± {light.mean.std:.0f}, {light.width.value:.0f} ± {light.width.std:.0f} broad"
            for light in through
        ]
        rows.append([code(kind), ", ".join(spectra), *moments])
    return table(rows)


def keys() -> Iterator[tuple[str, FieldInfo]]:
    """Every key with the tables that it stands in, such as sensor.low_pass_filter.turned, and its field."""
    for name, field in Plan.model_fields.items():
        yield from _keys_of(name, _model(field.annotation))


def _keys_of(where: str, model: type[BaseModel] | None) -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items() if model else ():
        inner, dotted = _model(field.annotation), f"{where}.{name}"
        if inner is None or field.description:
            yield dotted, field
        yield from _keys_of(dotted, inner)


def _section(name: str, field: FieldInfo) -> str:
    model = _model(field.annotation)
    assert model is not None
    brackets = f"[[{name}]]" if name == "channel" else f"[{name}]"
    parts = [f"## {code(brackets)}", "", _text(model.__doc__), ""]
    if not field.is_required():
        parts += [
            "This table may be left out."
            if field.default is not None
            else "Needed to capture, not to fit.",
            "",
        ]
    for dotted, inner in _keys_of(name, model):
        parts.append(
            directive(
                "confval", dotted, f"{_text(inner.description)}\n\n{_facts(dotted, inner)}"
            )
        )
    return "\n".join(parts)


def _facts(dotted: str, field: FieldInfo) -> str:
    unit = UNITS.get(dotted.rpartition("_")[2], "")
    takes = _takes(field) + (f", in {unit}" if unit and unit not in _takes(field) else "")
    return f"Allowed: {takes}. Default: {_default(dotted, field)}."


def _takes(field: FieldInfo) -> str:
    """What is allowed, in words."""
    return what_it_takes(field) or " or ".join(_by_type(field.annotation))


def _by_type(annotation: Any) -> Iterator[str]:
    if get_origin(annotation) is Literal:
        yield ", ".join(code(json.dumps(value)) for value in get_args(annotation))
    elif get_origin(annotation) in (Union, UnionType):
        for part in get_args(annotation):
            yield from _by_type(part)
    elif get_origin(annotation) is not None and get_args(annotation):
        yield from _by_type(get_args(annotation)[0])
    elif annotation is not type(None):
        yield "a table" if _model(annotation) else BY_TYPE.get(annotation, "text")


def _default(dotted: str, field: FieldInfo) -> str:
    """As TOML has it, or in the words that end the field's text."""
    if field.is_required():
        return "none, it is required"
    kinds = [
        kind
        for kind, needed in NEEDED_BY_KIND.items()
        if dotted in [f"target.{key}" for key in needed]
    ]
    if kinds:
        return f"none, {', '.join(kinds)} {'needs' if len(kinds) == 1 else 'need'} it"
    if field.default is None or field.default_factory is not None:
        return _stated_default(field.description or "")
    value = list(field.default) if isinstance(field.default, tuple) else field.default
    return code(json.dumps(value))


def _stated_default(text: str) -> str:
    return (
        " ".join(text.rpartition("Default: ")[2].split()).removesuffix(".")
        if "Default: " in text
        else "none"
    )


def _text(text: str | None) -> str:
    return " ".join((text or "").partition("Default: ")[0].split())


def _model(annotation: Any) -> type[BaseModel] | None:
    """The model in an annotation, if there is one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model, get_args(annotation))), None)
