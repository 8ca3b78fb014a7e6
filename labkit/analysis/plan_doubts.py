"""Findings about a number of the plan that the photographs contradict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import exp

from labkit.estimation.laws import (
    F_NUMBER,
    FOCAL_LENGTH,
    PIXEL_PITCH,
    RANGE_ZERO,
    SIZE,
    WAVELENGTH,
    Name,
)
from labkit.estimation.lens_fit import LensFit
from labkit.findings import Finding, found
from labkit.plan import Plan
from labkit.uncertain import Uncertain

KEYS = {
    F_NUMBER: "lens.f_number",
    FOCAL_LENGTH: "lens.focal_length_mm",
    SIZE: "target.size_mm",
    PIXEL_PITCH: "sensor.pixel_pitch_um",
    RANGE_ZERO: "the ranges",
    WAVELENGTH: "channel.wavelength_nm",
}
"""Keys of the plan, by kind of column."""


@dataclass(frozen=True)
class _Number:
    """A number of the plan: its key, the stated value, and the value with which the photographs agree."""

    key: str
    stated: float
    agrees: Uncertain


def plan_findings(lens: LensFit | None, plan: Plan) -> Iterator[Finding]:
    """Report the number of the plan that is probably a mistake.

    Parameters
    ----------
    lens : the estimate of the most probable model, with the others
    plan : states the number
    """
    if lens is None or (mistaken := lens.model.laws.mistaken) is None:
        return
    number = _number(lens, *mistaken, plan)
    others = [other.model.laws.mistaken for _, other in lens.others]
    keys = [_key(*column) for column in others if column is not None]
    yield found(
        "plan-contradicted",
        None,
        {"agreed": str(number.agrees), "others": ", ".join(keys)},
        key=number.key,
        stated=number.stated,
        agrees=number.agrees.as_json(),
        probability=1 - sum(probability for probability, _ in lens.others),
        next=keys,
    )


def _key(kind: str, name: Name) -> str:
    """Return the plan's key of a column."""
    if kind == WAVELENGTH:
        return f"{KEYS[kind]} of {name[0] if name else 'all channels'}"
    return KEYS[kind]


def _number(lens: LensFit, kind: str, name: Name, plan: Plan) -> _Number:
    """Return a mistaken number with the value with which the photographs agree."""
    value, std = lens.value(kind, *name), lens.std(kind, *name)
    if kind in (F_NUMBER, FOCAL_LENGTH):
        unit = "mm" if kind == FOCAL_LENGTH else ""
        return _Number(
            _key(kind, name),
            lens.model.centre[lens.model.index(kind)],
            Uncertain(value, std, unit),
        )
    if kind == RANGE_ZERO:
        return _Number("the common error of all ranges", 0.0, Uncertain(value, std, "mm"))
    stated, unit = {
        SIZE: (plan.target.size_mm, "mm"),
        PIXEL_PITCH: (plan.sensor.pixel_pitch_um, "um"),
        WAVELENGTH: (_wavelength_nm(name, plan), "nm"),
    }[kind]
    if kind == WAVELENGTH and not name:
        stated, unit = 1.0, "times"
    # the pitch's column is ln of the stated over the true
    true = stated * exp(-value if kind == PIXEL_PITCH else value)
    return _Number(_key(kind, name), stated, Uncertain(true, true * std, unit))


def _wavelength_nm(name: Name, plan: Plan) -> float:
    return next(c.wavelength_nm for c in plan.channel if not name or c.name == name[0])
