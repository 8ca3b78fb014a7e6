"""Findings about a number of the plan that the photographs contradict."""

from __future__ import annotations

from collections.abc import Iterator
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


def plan_findings(lens: LensFit | None, plan: Plan) -> Iterator[Finding]:
    """Report the number of the plan that is probably a mistake.

    Parameters
    ----------
    lens : the estimate of the most probable model, with the others
    plan : states the number
    """
    if lens is None or (mistaken := lens.model.laws.mistaken) is None:
        return
    key, stated, agrees = _number(lens, *mistaken, plan)
    others = [other.model.laws.mistaken for _, other in lens.others]
    keys = [_key(*column) for column in others if column is not None]
    yield found(
        "plan-contradicted",
        None,
        {"agreed": str(agrees), "others": ", ".join(keys)},
        key=key,
        stated=stated,
        agrees=agrees.as_json(),
        probability=1 - sum(probability for probability, _ in lens.others),
        next=keys,
    )


def _key(kind: str, name: Name) -> str:
    """Return the plan's key of a column."""
    if kind == WAVELENGTH:
        return f"{KEYS[kind]} of {name[0] if name else 'all channels'}"
    return KEYS[kind]


def _number(
    lens: LensFit, kind: str, name: Name, plan: Plan
) -> tuple[str, float, Uncertain]:
    """Return a mistaken number's key and stated value, and the value with which the photographs agree."""
    estimate = lens.uncertain(kind, *name, unit="" if kind == F_NUMBER else "mm")
    if kind == RANGE_ZERO:
        return "the common error of all ranges", 0.0, estimate
    if kind in (F_NUMBER, FOCAL_LENGTH):
        return _key(kind, name), float(lens.model.centre[lens.model.index(kind)]), estimate
    light = {c.name: c.wavelength_nm for c in plan.channel}
    stated, unit, sign = {
        SIZE: (plan.target.size_mm, "mm", 1.0),
        PIXEL_PITCH: (
            plan.sensor.pixel_pitch_um,
            "um",
            -1.0,
        ),  # ln of the stated over the true
        WAVELENGTH: (light[str(name[0])], "nm", 1.0) if name else (1.0, "times", 1.0),
    }[kind]
    true = stated * exp(sign * estimate.value)
    return _key(kind, name), stated, Uncertain(true, true * estimate.std, unit)
