"""The limits of a plan against a field: pass, fail, or cannot tell.

A limit holds numbers, such as the MTF50 of four corners in two directions. The limit passes
where every number passes at the stated confidence, and fails where any number fails at the
confidence that holds for all of them together (Bonferroni). Otherwise the errors are too
large to tell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

import numpy as np
from scipy.stats import norm

from labkit.field.places import azimuth_of, detail_deg, field_points
from labkit.field.surfaces import focus_rows, in_um
from labkit.field.terms import LensTerms, lens_terms
from labkit.optics.field import FieldModel
from labkit.optics.mtf import mtf, mtf50
from labkit.plan import Limits
from labkit.uncertain import Uncertain

Verdict = Literal["pass", "fail", "cannot tell"]

Numbers = Mapping[str, Uncertain]
"""Numbers of one limit by where on the frame they are; "" for the whole frame."""

POINTS = {
    "centre": ("centre",),
    "edge": ("top", "left", "right", "bottom"),
    "corner": ("top left", "top right", "bottom left", "bottom right"),
}


@dataclass(frozen=True, slots=True)
class Judged:
    """A limit with its verdict.

    Parameters
    ----------
    name, limit : as in the plan
    is_least : whether the limit is the least that passes
    where : place and direction of the number nearest to failing
    number : that number; nan if it was not measured
    verdict : pass, fail or cannot tell
    """

    name: str
    limit: float
    is_least: bool
    where: str
    number: Uncertain
    verdict: Verdict

    def as_json(self) -> dict[str, Any]:
        """Return the fields."""
        return {
            "name": self.name,
            "limit": self.limit,
            "is_least": self.is_least,
            "where": self.where,
            "number": self.number.as_json() | {"unit": self.number.unit},
            "verdict": self.verdict,
        }


def judge(
    name: str, limit: float, numbers: Numbers, confidence: float, *, is_least: bool
) -> Judged:
    """Return the verdict of a limit on some numbers; a limit from above holds their absolute values.

    Numbers that are not finite, or without a known error, cannot be told; so can no numbers
    at all.
    """
    if not numbers:
        missing = Uncertain(np.nan, np.inf)
        return Judged(name, limit, is_least, "not measured", missing, "cannot tell")
    margins = {
        where: n.value - limit if is_least else limit - abs(n.value)
        for where, n in numbers.items()
    }
    known = [w for w, n in numbers.items() if isfinite(n.value) and isfinite(n.std)]
    passing = float(norm.ppf(confidence))
    failing = float(norm.ppf(1 - (1 - confidence) / len(numbers)))
    fails = [w for w in known if margins[w] < -failing * numbers[w].std]
    doubtful = [
        w for w in numbers if w not in known or margins[w] < passing * numbers[w].std
    ]
    worst = min(
        fails or doubtful or known, key=lambda w: np.nan_to_num(margins[w], nan=-np.inf)
    )
    verdict: Verdict = "fail" if fails else "cannot tell" if doubtful else "pass"
    return Judged(name, limit, is_least, worst, numbers[worst], verdict)


def judge_limits(
    limits: Limits,
    model: FieldModel,
    channel: str,
    others: Mapping[str, Numbers] | None = None,
) -> tuple[Judged, ...]:
    """Return the verdicts of all limits that a plan states.

    Parameters
    ----------
    channel : the leading one
    others : numbers of limits that the wavefront does not have, such as distortion
    """
    stated = limits.stated
    if not stated:
        return ()
    terms = lens_terms(model, channel)
    return tuple(
        judge(
            name,
            limit,
            (others or {}).get(name) or measured(name, model, terms),
            limits.confidence,
            is_least=limits.is_least(name),
        )
        for name, limit in stated.items()
    )


def measured(name: str, model: FieldModel, terms: LensTerms) -> Numbers:
    """Return the numbers of a limit; none for a limit that the wavefront does not have."""
    place, _, quantity = name.partition("_")
    if place in POINTS:
        return _mtf_at(model, terms.channel, POINTS[place], quantity)
    if name == "astigmatism_um":
        return _apart_um(model, terms.channel)
    number = OF_TERMS.get(name)
    return {} if number is None else {"": number(terms)}


OF_TERMS: dict[str, Callable[[LensTerms], Uncertain]] = {
    "tilt_um_per_mm": lambda terms: terms.tilt.slope.magnitude,
    "tilt_um": lambda terms: terms.tilt.over_frame,
    "tilt_arcmin": lambda terms: terms.tilt.angle.magnitude,
    "curvature_per_mm": lambda terms: terms.curvature,
    "curvature_um": lambda terms: terms.at_corner_um(terms.curvature),
    "focal_surface_um": lambda terms: terms.best_planes["medial"].peak_to_valley,
    "coma_waves": lambda terms: terms.coma.magnitude,
    "linear_astigmatism_waves": lambda terms: (
        terms.linear_astigmatism.times(terms.radius_mm, "waves").magnitude
    ),
}
"""Limits on one number of the whole frame."""


def _mtf_at(
    model: FieldModel, channel: str, names: tuple[str, ...], quantity: str
) -> Numbers:
    """Return MTF50, or the MTF at a frequency as in mtf_at_20, sagittal and tangential, at points of the frame."""
    places = field_points(model.frame)
    found = {}
    for name in names:
        wavefront = model.wavefront(channel, places[name])
        for surface in ("sagittal", "tangential"):
            detail = detail_deg(azimuth_of(model.frame, places[name]), surface)
            if quantity == "mtf50":
                found[f"{name}, {surface}"] = mtf50(wavefront, detail)
            else:
                curve = mtf(wavefront, float(quantity.removeprefix("mtf_at_")), detail)
                number = Uncertain(float(curve.value), float(curve.std))
                found[f"{name}, {surface}"] = number
    return found


def _apart_um(model: FieldModel, channel: str) -> Numbers:
    """Return tangential less sagittal focus at all points of the frame."""
    found = {}
    for name, place in field_points(model.frame).items():
        tangential = focus_rows(model, channel, place, "tangential")
        sagittal = focus_rows(model, channel, place, "sagittal")
        value, std = in_um(model, tangential - sagittal)
        found[name] = Uncertain(float(value), float(std), "um")
    return found
