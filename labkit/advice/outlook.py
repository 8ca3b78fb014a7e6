"""What a session will determine of its lens: the session's own estimator, on fits as they are expected."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.advice.expected_fit import ExpectedFit, middle_mm
from labkit.analysis.lens_fit import fit_lens
from labkit.analysis.lens_model import LensModel, Member, Stated
from labkit.estimation.expansion import Measured
from labkit.optics.lens import TELLING_STD, ThinLens, blur_per_wave_um, defocus_waves
from labkit.optics.zernike import twin_signs
from labkit.uncertain import Uncertain

STEP_WAVES = 1.0
"""RMS defocus between ranges that are proposed."""

CLOSEST = 3.0
"""Least range that is proposed, in focal lengths: nearer ones are macro photography."""

CLEARLY = 0.8
"""Of the largest error that determines the pupil magnification: proposed ranges stay below it."""

TRIED = 25
"""How many nearest ranges are tried."""

DETERMINED = 0.5
"""Of a stated error: a session that leaves more of it has hardly determined the number."""

WORTH = 0.5
"""Of an error: a further measurement that leaves more of it is not named."""

NUMBERS = {
    "focal_length_mm": ("focal length", " mm"),
    "f_number": ("f-number", ""),
    "pupil_magnification": ("pupil magnification", ""),
    "range_zero_mm": ("zero of the tape", " mm"),
}
"""A lens's numbers except best focus: keys, names and units."""

Errors = dict[str, float]
"""Standard errors, by the keys of `Results.budget`."""


@dataclass(frozen=True)
class Remedy:
    """A further measurement. what: in words; of: key of the number measured, "" for another; std: the session's with it."""

    what: str
    of: str
    std: Errors


@dataclass(frozen=True)
class Outlook:
    """Standard errors that a session will have, those that the plan states, and what would make them smaller."""

    std: Errors
    stated: Errors
    remedies: tuple[Remedy, ...]

    @property
    def determined(self) -> bool:
        """Whether the session determines the pupil magnification."""
        return self.std["pupil_magnification"] <= TELLING_STD

    def open_numbers(self) -> list[str]:
        """Keys of what the session will hardly determine: no better than stated, or a magnification of any lens."""
        hardly = [name for name, stated in self.stated.items() if self.std[name] > DETERMINED * stated > 0]
        return hardly if self.determined else [*hardly, "pupil_magnification"]

    def worthwhile(self, name: str) -> list[Remedy]:
        """Measurements of something else that would leave half of a number's error or less."""
        return [one for one in self.remedies if one.of != name and one.std[name] <= WORTH * self.std[name]]


@dataclass(frozen=True)
class Proposal:
    """Ranges that determine the pupil magnification, and a session's standard errors there; empty where none do."""

    ranges_mm: tuple[float, ...] = ()
    std: Errors = field(default_factory=dict)

    @property
    def what(self) -> str:
        """In words."""
        return f"ranges {', '.join(f'{mm:g}' for mm in self.ranges_mm)} mm"


def _known(number: Uncertain, relative: float) -> Uncertain:
    return replace(number, std=min(number.std, relative * number.value))


MEASUREMENTS: tuple[tuple[str, str, Callable[[Stated], Stated]], ...] = (
    (
        "a tape right to 1 mm",
        "range_zero_mm",
        lambda stated: replace(stated, range_zero_std_mm=min(stated.range_zero_std_mm, 1.0)),
    ),
    (
        "a focal length right to 0.1 %",
        "focal_length_mm",
        lambda stated: replace(stated, focal_length=_known(stated.focal_length, 0.001)),
    ),
    (
        "an f-number right to 0.5 %",
        "f_number",
        lambda stated: replace(stated, f_number=_known(stated.f_number, 0.005)),
    ),
    (
        "a target's size right to 1e-5",
        "",
        lambda stated: replace(stated, size_std=min(stated.size_std, 1e-5)),
    ),
)
"""Measurements besides the photographs: in words, the number's key, and the plan's statement with them."""


def outlook(fits: Mapping[tuple[str, float], ExpectedFit], stated: Stated, focus_mm: float) -> Outlook:
    """What a session will determine.

    Parameters
    ----------
    fits : by channel and range, mm; one channel at two ranges or more
    stated : of lens, target and rail
    focus_mm : the range that the lens is focused at
    """
    members = _as_predicted({key: fit.measured for key, fit in fits.items()}, stated, focus_mm)
    remedies = [
        Remedy(what, of, _errors(members, better(stated)))
        for what, of, better in MEASUREMENTS
        if better(stated) != stated
    ]
    of_plan = {
        "focal_length_mm": stated.focal_length.std,
        "f_number": stated.f_number.std,
        "range_zero_mm": stated.range_zero_std_mm,
    }
    return Outlook(_errors(members, stated), of_plan, tuple(remedies))


def _as_predicted(fits: Mapping[tuple[str, float], Measured], stated: Stated, focus_mm: float) -> list[Member]:
    """Members of a session whose lens is as stated, its pupils of one size, focused at a range."""
    members = [Member(channel, range_mm, range_mm, fit) for (channel, range_mm), fit in fits.items()]
    model = LensModel(tuple(members), stated)
    theta = np.array([column.value for column in model.columns])
    first = members[0].measured
    for k, column in enumerate(model.columns):
        if column.kind == "best focus":
            theta[k] = focus_mm
        elif column.kind == "mode":
            theta[k] = first.values[first.noll.index(int(column.of[-1]))]
    return [
        replace(member, measured=replace(member.measured, values=values))
        for member, values in zip(members, model.predicted(theta), strict=True)
    ]


def _errors(members: Sequence[Member], stated: Stated) -> Errors:
    lens = fit_lens(members, stated)
    pupils = float(np.exp(lens.value("pupil magnification")))
    return {f"best_focus_mm.{name}": lens.std("best focus", name) for name in lens.model.channels} | {
        "focal_length_mm": lens.std("focal length"),
        "f_number": lens.std("f-number"),
        "pupil_magnification": pupils * lens.std("pupil magnification"),
        "range_zero_mm": lens.std("tape"),
    }


def propose_ranges(
    nearest_mm: float, channels: Sequence[str], stated: Stated, sharp: Measured, blurred: Measured
) -> Proposal:
    """The farthest three ranges, the first at most `nearest_mm`, that determine the pupil magnification.

    sharp, blurred: what a fit measures in focus, and STEP_WAVES of defocus beyond it.
    """
    lens = ThinLens(stated.focal_length.value, stated.f_number.value)
    closest = CLOSEST * lens.focal_length_mm
    for near in np.geomspace(nearest_mm, closest, TRIED) if nearest_mm > closest else ():
        ranges = _spread_ranges(float(near), lens, stated.reference_nm)
        if len(set(ranges)) < 3:
            continue
        focus_mm = middle_mm(ranges, lens)
        fits = {
            (channel, range_mm): _at_range(
                float(defocus_waves(lens, range_mm, focus_mm, stated.reference_nm)), sharp, blurred
            )
            for range_mm in ranges
            for channel in channels
        }
        errors = _errors(_as_predicted(fits, stated, focus_mm), stated)
        if errors["pupil_magnification"] <= CLEARLY * TELLING_STD:
            return Proposal(ranges, errors)
    return Proposal()


def _spread_ranges(near_mm: float, lens: ThinLens, reference_nm: float) -> tuple[float, ...]:
    """Three ranges from the nearest on, STEP_WAVES of defocus apart; none where the last would be beyond infinity."""
    focal = lens.focal_length_mm
    blur_mm = STEP_WAVES * blur_per_wave_um(lens.f_number, reference_nm * 1e-3) * 1e-3
    images = float(lens.image_distance_mm(near_mm)) - lens.f_number * blur_mm * np.arange(3)
    return tuple(float(f"{r:.4g}") for r in images * focal / (images - focal)) if images[-1] > focal else ()


def _at_range(waves: float, sharp: Measured, blurred: Measured) -> Measured:
    """What a fit of so much defocus measures: in focus, a step beyond it, or as its twin before it."""
    if abs(waves) < STEP_WAVES / 2:
        return sharp
    return blurred if waves > 0 else blurred.twin(twin_signs(blurred.noll))
