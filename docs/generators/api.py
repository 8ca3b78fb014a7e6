"""The public names, from their docstrings and signatures."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from typing import Any

from numpy.typing import ArrayLike

import labkit
from docs.generators.markdown import directive
from labkit.types import Floats

ALIASES = {"Floats": Floats, "ArrayLike": ArrayLike}

UNDERLINE = re.compile("-{3,}")

RELATED = {
    "labkit.results": (
        "BestFocus",
        "ColourShift",
        "Focus",
        "Lens",
        "OptimumTest",
        "Residuals",
        "Placement",
    ),
    "labkit.advice.advise": ("Advice", "RangeAdvice"),
    "labkit.advice.outlook": ("Outlook", "Remedy"),
    "labkit.findings.findings": ("Finding",),
    "labkit.session.draft_plan": ("Draft",),
    "labkit.target.rendering": ("Rendering",),
    "labkit.calibration.tone_wedge": ("Tone",),
    "labkit.charts.outcome": ("ChartOutcome", "ChartPlace", "ChartEdge"),
    "labkit.charts.focal_surface": ("FocalSurface", "PlaceFocus"),
    "labkit.edges.outcome": ("EdgesOutcome", "MeasuredEdge", "RejectedEdge"),
    "labkit.restoration.restored_photographs": ("Restoration",),
    "labkit.demo": ("Comparison",),
    "labkit.key": ("Key",),
    "labkit.session.frame": ("Frame",),
    "labkit.target.target": ("Target", "CellTarget", "TargetSpec", "read_spec"),
    "labkit.optics.mtf": ("Curve", "mtf"),
    "labkit.optics.wavefront": ("FittedWavefront", "at_focus"),
    "labkit.optics.strehl": ("strehl",),
    "labkit.errors": (),
}
"""What public functions take and return."""

DEVICES = {
    "labkit.devices.protocols": (),
    "labkit.devices.context": ("DeviceContext", "Devices"),
    "labkit.devices.operator": ("Operator",),
    "labkit.devices.inventory": ("Connected",),
    "labkit.devices.rail_calibration": ("RailZero",),
    "labkit.acquisition.camera_check": ("FrameReport",),
    "labkit.acquisition.focusing": ("FocusReading",),
}


def public_api() -> str:
    """Every name of `labkit.__all__`."""
    return "\n".join(
        _entry(f"labkit.{name}", getattr(labkit, name))
        for name in labkit.__all__
        if name != "__version__"
    )


def related_api() -> str:
    """What the public names take and return; the errors."""
    return _modules(RELATED)


def device_api() -> str:
    """What a driver keeps, and what it is given."""
    return _modules(DEVICES)


def _modules(wanted: dict[str, tuple[str, ...]]) -> str:
    parts = []
    for dotted, names in wanted.items():
        module = import_module(dotted)
        own = [
            name
            for name, value in vars(module).items()
            if getattr(value, "__module__", None) == dotted
        ]
        for name in names or [name for name in own if not name.startswith("_")]:
            if not hasattr(labkit, name):
                parts.append(_entry(f"{dotted}.{name}", getattr(module, name)))
    return "\n".join(parts)


def _entry(dotted: str, value: Any) -> str:
    if not inspect.isclass(value):
        return directive(
            "py:function", f"{dotted}{_signature(value)}", _text(value.__doc__), depth=6
        )
    members = [_member(name, member) for name, member in _members(value)]
    body = "\n".join([_text(value.__doc__), "", *members])
    return directive("py:class", f"{dotted}{_fields(value)}", body, depth=6)


def _members(value: type) -> Iterator[tuple[str, Any]]:
    """The public functions and properties that a class has of labkit, with a docstring."""
    bases = [
        base for base in reversed(value.__mro__) if base.__module__.startswith("labkit.")
    ]
    members = {name: member for base in bases for name, member in vars(base).items()}
    for name, member in members.items():
        if not name.startswith("_") or name == "__getitem__":
            plain = (
                member.__func__
                if isinstance(member, classmethod | staticmethod)
                else member
            )
            documented = isinstance(
                plain, property | cached_property
            ) or inspect.isfunction(plain)
            if documented and plain.__doc__:
                yield name, member


def _member(name: str, member: Any) -> str:
    if isinstance(member, property | cached_property):
        return directive("py:property", name, _text(member.__doc__), depth=5)
    plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
    options = {"classmethod": ""} if isinstance(member, classmethod) else None
    return directive(
        "py:method",
        f"{name}{_signature(plain, bound=True)}",
        _text(plain.__doc__),
        options,
        depth=5,
    )


def _signature(function: Any, *, bound: bool = False) -> str:
    signature = inspect.signature(function)
    given = [
        p.replace(default=_default(p), annotation=_shown(p.annotation))
        for p in signature.parameters.values()
    ]
    returned = _shown(signature.return_annotation)
    return str(
        signature.replace(
            parameters=given[1:] if bound else given, return_annotation=returned
        )
    )


class _Shown(str):
    """What a signature shows as it is, without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def _shown(annotation: Any) -> Any:
    """A type by the name that the source has for it, without the modules that it lies in."""
    if annotation is inspect.Signature.empty:
        return annotation
    text = (
        annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    )
    for name, alias in ALIASES.items():
        text = text.replace(inspect.formatannotation(alias), name)
    return _Shown(re.sub(r"\b(?:\w+\.)+(\w+)", r"\1", text))


def _default(parameter: inspect.Parameter) -> Any:
    default = parameter.default
    if default is parameter.empty or isinstance(
        default, int | float | str | type(None) | tuple
    ):
        return default
    return _Shown("...")


def _fields(value: type) -> str:
    """What a class that scripts make themselves takes: not plans or errors, which come otherwise."""
    if (
        issubclass(value, BaseException)
        or hasattr(value, "model_fields")
        or getattr(value, "_is_protocol", False)
    ):
        return ""
    return _signature(value).partition(" ->")[0]


def _listed(lines: list[str]) -> Iterator[str]:
    """The lines of a docstring in NumPy's form: headings in bold, what stands below them as lists."""
    below_heading = False
    for line, following in pairwise([*lines, ""]):
        if UNDERLINE.fullmatch(line):
            continue
        if UNDERLINE.fullmatch(following):
            below_heading = line != "Notes"
            yield f"**{line}**\n"
        else:
            item = below_heading and line and not line.startswith((" ", ">>> "))
            yield f"- {line}" if item else line


def _text(docstring: str | None) -> str:
    """A docstring as Markdown: what follows >>> is code."""
    lines, inside = [], False
    for line in _listed(inspect.cleandoc(docstring or "").splitlines()):
        shown = line.startswith((">>> ", "... ")) or (inside and bool(line.strip()))
        if shown != inside:
            lines.append("```python" if shown else "```\n")
            inside = shown
        lines.append(line)
    return "\n".join([*lines, *(["```"] if inside else [])])
