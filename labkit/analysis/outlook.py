"""What a session will determine of its lens, before it is photographed: its own estimator, on fits as they are expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.lens_fit import fit_lens
from labkit.analysis.lens_model import LensModel, Member, Stated
from labkit.analysis.session_results import budget
from labkit.inference.cone import Measured
from labkit.inference.fit import twin_signs
from labkit.optics.lens import TELLING_STD, ThinLens, blur_per_wave_um, defocus_waves
from labkit.uncertain import Uncertain

STEP_WAVES = 1.0  # RMS defocus between ranges that are proposed
CLOSEST = 3.0  # focal lengths: nearer ones are macro photography
CLEARLY, TRIED = (
    0.8,
    25,
)  # of the largest error that determines, which proposed ranges keep to; nearest ranges that are tried
DETERMINED = 0.5  # of the stated error: a session that leaves more of it has hardly determined anything
WORTH = 0.5  # of an error: what a further measurement must leave of it, to be named

NUMBERS = {
    "focal_length_mm": ("focal length", " mm"),
    "f_number": ("f-number", ""),
    "pupil_magnification": ("pupil magnification", ""),
    "range_zero_mm": ("zero of the tape", " mm"),
}
"""Keys of a lens's numbers, but for best focus, what they are called, and their units."""

Errors = dict[str, float]
"""Standard errors, by the keys of a budget."""


@dataclass(frozen=True)
class Remedy:
    """A further measurement, in words, the key of what it is of where that is one of the lens's numbers, and the standard
    errors that the session would have with it."""

    what: str
    of: str
    std: Errors


@dataclass(frozen=True)
class Outlook:
    """Standard errors that a session will have, and those that the plan states; what would make them smaller."""

    std: Errors
    stated: Errors
    remedies: tuple[Remedy, ...]

    @property
    def determined(self) -> bool:
        """Whether the session determines the pupil magnification."""
        return self.std["pupil_magnification"] <= TELLING_STD

    def open_numbers(self) -> list[str]:
        """Keys of what the session will hardly determine: less than the plan states already, or a magnification of any lens."""
        hardly = [name for name, stated in self.stated.items() if self.std[name] > DETERMINED * stated > 0]
        return [*hardly, *([] if self.determined else ["pupil_magnification"])]

    def worthwhile(self, name: str) -> list[Remedy]:
        """Of what else a measurement would determine one number better, by half or more."""
        return [one for one in self.remedies if one.of != name and one.std[name] <= WORTH * self.std[name]]


def _tape(stated: Stated) -> Stated:
    return replace(stated, range_zero_std_mm=min(stated.range_zero_std_mm, 1.0))


def _focal_length(stated: Stated) -> Stated:
    return replace(stated, focal_length=_known(stated.focal_length, 0.001))


def _f_number(stated: Stated) -> Stated:
    return replace(stated, f_number=_known(stated.f_number, 0.005))


def _size(stated: Stated) -> Stated:
    return replace(stated, size_std=min(stated.size_std, 1e-5))


def _known(number: Uncertain, relative: float) -> Uncertain:
    return Uncertain(number.value, min(number.std, relative * number.value), number.unit)


MEASUREMENTS: tuple[tuple[str, str, Callable[[Stated], Stated]], ...] = (
    ("a tape right to 1 mm", "range_zero_mm", _tape),
    ("a focal length right to 0.1 %", "focal_length_mm", _focal_length),
    ("an f-number right to 0.5 %", "f_number", _f_number),
    ("a target's size right to 1e-5", "", _size),
)
"""What could be measured beside the photographs, of which number, and what is stated then."""


def expected_member(range_mm: float, channel: str, measured: Measured) -> Member:
    """One fit of a session that is not photographed yet."""
    return Member(channel, range_mm, range_mm, measured)


def outlook(members: Sequence[Member], stated: Stated, focus_mm: float) -> Outlook:
    """What a session of these fits will determine, the lens focused at a range. Two ranges of some channel at least."""
    there = as_predicted(members, stated, focus_mm)
    remedies = [
        Remedy(what, of, _errors(there, better(stated)))
        for what, of, better in MEASUREMENTS
        if better(stated) != stated
    ]
    of_plan = {
        "focal_length_mm": stated.focal_length.std,
        "f_number": stated.f_number.std,
        "range_zero_mm": stated.range_zero_std_mm,
    }
    return Outlook(_errors(there, stated), of_plan, tuple(remedies))


def as_predicted(members: Sequence[Member], stated: Stated, focus_mm: float) -> list[Member]:
    """The members with values that a lens has which is as stated, its pupils alike, focused at a range."""
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
    shares = budget(fit_lens(members, stated))
    return {name: float(np.linalg.norm(list(sources.values()))) for name, sources in shares.items()}


def middle_mm(ranges_mm: Sequence[float], lens: ThinLens) -> float:
    """The range in the middle of those of the lens's image distances: where one would focus."""
    image = float(np.mean([lens.image_distance_mm(min(ranges_mm)), lens.image_distance_mm(max(ranges_mm))]))
    return image * lens.focal_length_mm / (image - lens.focal_length_mm)


def spread_ranges(near_mm: float, lens: ThinLens, reference_nm: float) -> tuple[float, ...]:
    """Three ranges from the nearest on, STEP_WAVES of defocus apart; none where the last would lie beyond infinity."""
    focal = lens.focal_length_mm
    blur_um = STEP_WAVES * blur_per_wave_um(lens.f_number, reference_nm * 1e-3)
    step_mm = lens.f_number * blur_um * 1e-3  # of the image, for so much defocus
    images = float(lens.image_distance_mm(near_mm)) - step_mm * np.arange(3)
    return tuple(float(f"{r:.4g}") for r in images * focal / (images - focal)) if images[-1] > focal else ()


def propose_ranges(
    nearest_mm: float, channels: Sequence[str], stated: Stated, sharp: Measured, blurred: Measured
) -> tuple[tuple[float, ...], Errors]:
    """The farthest three ranges, not beyond the nearest, that determine the pupil magnification, and the errors of a session
    there; none where none do.

    sharp, blurred: what a fit will say in focus, and STEP_WAVES of defocus beyond it.
    """
    lens = ThinLens(stated.focal_length.value, stated.f_number.value)
    closest = CLOSEST * lens.focal_length_mm
    for near in np.geomspace(nearest_mm, closest, TRIED) if nearest_mm > closest else ():
        ranges = spread_ranges(float(near), lens, stated.reference_nm)
        if len(set(ranges)) < 3:
            continue
        focus_mm = middle_mm(ranges, lens)
        fits = {r: _at_range(r, focus_mm, lens, stated, sharp, blurred) for r in ranges}
        members = [expected_member(r, channel, fit) for r, fit in fits.items() for channel in channels]
        errors = _errors(as_predicted(members, stated, focus_mm), stated)
        if errors["pupil_magnification"] <= CLEARLY * TELLING_STD:
            return ranges, errors
    return (), {}


def _at_range(
    range_mm: float, focus_mm: float, lens: ThinLens, stated: Stated, sharp: Measured, blurred: Measured
) -> Measured:
    """What a fit will say: in focus, or a step beyond it or before it, where its twin stands."""
    waves = float(defocus_waves(lens, range_mm, focus_mm, stated.reference_nm))
    if abs(waves) < STEP_WAVES / 2:
        return sharp
    return blurred if waves > 0 else blurred.twin(twin_signs(blurred.noll))
