"""Predict a session's errors of its lens by the session's own estimator on expected fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.advice.expected_fit import middle_mm
from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Measured, Reading
from labkit.estimation.laws import (
    COMMON_MODE,
    F_NUMBER,
    FOCAL_LENGTH,
    FOCUS,
    MAGNIFICATION,
    RANGE_ZERO,
)
from labkit.estimation.lens_fit import Measurements, fit_lens
from labkit.estimation.lens_model import LensModel
from labkit.estimation.stated import Stated
from labkit.key import Key
from labkit.optics.lens import TELLING_STD, ThinLens, blur_per_wave_um, defocus_waves
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats
from labkit.uncertain import Uncertain

STEP_WAVES = 1.0
"""RMS defocus between ranges proposed."""

CLOSEST = 3.0
"""Least range proposed, in focal lengths: nearer ones are macro photography."""

CLEARLY = 0.8
"""Share of the largest error that determines the pupil magnification: proposed ranges stay below this share."""

TRIED = 25
"""How many nearest ranges are tried."""

DETERMINED = 0.5
"""Share of a stated error: a session with a larger remaining error has hardly determined the number."""

WORTH = 0.5
"""Share of an error: a further measurement with a larger remaining error is not named."""

LENS_NUMBERS = {
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
    """A further measurement.

    Parameters
    ----------
    what : the measurement in words
    of : key of the measured number, "" for any other
    std : the session's standard error with the measurement
    """

    what: str
    of: str
    std: Errors


@dataclass(frozen=True)
class Outlook:
    """Predicted standard errors of a session, the plan's stated errors, and measurements that would help."""

    std: Errors
    stated: Errors
    remedies: tuple[Remedy, ...]

    @property
    def determined(self) -> bool:
        """Return whether the session determines the pupil magnification."""
        return self.std["pupil_magnification"] <= TELLING_STD

    def open_numbers(self) -> list[str]:
        """Return the keys of weakly determined quantities.

        Such an error is no smaller than the stated one, or a magnification's covers every
        lens.
        """
        hardly = [
            name
            for name, stated in self.stated.items()
            if self.std[name] > DETERMINED * stated > 0
        ]
        return hardly if self.determined else [*hardly, "pupil_magnification"]

    def worthwhile(self, name: str) -> list[Remedy]:
        """Return measurements of another quantity that would at least halve the error of a number."""
        return [
            one
            for one in self.remedies
            if one.of != name and one.std[name] <= WORTH * self.std[name]
        ]


@dataclass(frozen=True)
class Proposal:
    """Ranges that determine the pupil magnification, and a session's errors there; empty if none do."""

    ranges_mm: tuple[float, ...] = ()
    std: Errors = field(default_factory=dict)

    @property
    def what(self) -> str:
        """The proposal in words."""
        return f"ranges {', '.join(f'{mm:g}' for mm in self.ranges_mm)} mm"


def _known(number: Uncertain, relative: float) -> Uncertain:
    return replace(number, std=min(number.std, relative * number.value))


MEASUREMENTS: tuple[tuple[str, str, Callable[[Stated], Stated]], ...] = (
    (
        "a tape right to 1 mm",
        "range_zero_mm",
        lambda stated: replace(
            stated, range_zero_std_mm=min(stated.range_zero_std_mm, 1.0)
        ),
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


def outlook(fits: Mapping[Key, Measured], stated: Stated, focus_mm: float) -> Outlook:
    """Predict what a session will determine.

    Parameters
    ----------
    fits : expected measurements; one channel at two ranges or more
    stated : numbers of lens, target and rail
    focus_mm : range of best focus
    """
    remedies = [
        Remedy(what, of, _errors(fits, better(stated), focus_mm))
        for what, of, better in MEASUREMENTS
        if better(stated) != stated
    ]
    of_plan = {
        "focal_length_mm": stated.focal_length.std,
        "f_number": stated.f_number.std,
        "range_zero_mm": stated.range_zero_std_mm,
    }
    return Outlook(_errors(fits, stated, focus_mm), of_plan, tuple(remedies))


def _errors(fits: Mapping[Key, Measured], stated: Stated, focus_mm: float) -> Errors:
    """Return a session's standard errors for the stated lens, with pupils of one size, focused at a range."""
    model = _model(fits, stated)
    first = next(iter(fits.values()))
    start = Point(_truth(model, first, focus_mm), np.zeros((model.groups.max() + 1, 0)))
    lens = fit_lens(model, _measurements(model, list(fits.values()), start), start)
    pupils = float(np.exp(lens.value(MAGNIFICATION)))
    focus = lens.errors_of(
        np.array([model.best_focus(channel) for channel in model.channels])
    )
    best_focus_std = np.sqrt(np.diag(focus))
    return {
        **{
            f"best_focus_mm.{c}": float(std)
            for c, std in zip(model.channels, best_focus_std, strict=True)
        },
        "focal_length_mm": lens.std(FOCAL_LENGTH),
        "f_number": lens.std(F_NUMBER),
        "pupil_magnification": pupils * lens.std(MAGNIFICATION),
        "range_zero_mm": lens.std(RANGE_ZERO),
    }


def _model(fits: Mapping[Key, Measured], stated: Stated) -> LensModel:
    """Return the lens model of such a session, with one target tilt for all photographs."""
    readings = [
        Reading(key, key.range_mm, key.range_mm) for key in fits if key.range_mm is not None
    ]
    first = next(iter(fits.values()))
    tilt_std = min(fit.foreshortening[1] for fit in fits.values())
    return LensModel(tuple(readings), first.noll, first.parts, stated, tilt_std=tilt_std)


def _truth(model: LensModel, first: Measured, focus_mm: float) -> Floats:
    """Return (columns,) parameters of the stated lens, focused at a range, with the modes of a fit."""
    theta = np.array([column.value for column in model.columns])
    theta[model.index(FOCUS)] = focus_mm
    for j, waves in zip(first.noll, first.waves, strict=True):
        if j != DEFOCUS:
            theta[model.index(COMMON_MODE, j)] = waves
    return theta


def _measurements(model: LensModel, fits: Sequence[Measured], truth: Point) -> Measurements:
    """Return the expected measurements at the true parameters."""
    covariance = np.array([fit.covariance for fit in fits])
    none = np.zeros_like(covariance)
    used = np.ones(len(fits), bool)
    return Measurements(
        model.predicted(truth.theta, truth.own), covariance, none, none, used
    )


def propose_ranges(
    nearest_mm: float,
    channels: Sequence[str],
    stated: Stated,
    sharp: Measured,
    blurred: Measured,
) -> Proposal:
    """Propose the farthest three ranges, the first at most `nearest_mm`, that determine the pupil magnification.

    Parameters
    ----------
    nearest_mm : of the plan's ranges
    channels : of the plan
    stated : numbers of lens, target and rail
    sharp, blurred : a fit's expected measurement in focus, and with `STEP_WAVES` of defocus
    """
    lens = ThinLens(stated.focal_length.value, stated.f_number.value)
    closest = CLOSEST * lens.focal_length_mm
    for near in np.geomspace(nearest_mm, closest, TRIED) if nearest_mm > closest else ():
        ranges = _spread_ranges(float(near), lens, stated.reference_nm)
        if len(set(ranges)) < 3:
            continue
        focus_mm = middle_mm(ranges, lens)
        measured = {
            mm: _at_range(
                float(defocus_waves(lens, mm, focus_mm, stated.reference_nm)),
                sharp,
                blurred,
            )
            for mm in ranges
        }
        fits = {Key(mm, channel): measured[mm] for mm in ranges for channel in channels}
        errors = _errors(fits, stated, focus_mm)
        if errors["pupil_magnification"] <= CLEARLY * TELLING_STD:
            return Proposal(ranges, errors)
    return Proposal()


def _spread_ranges(
    near_mm: float, lens: ThinLens, reference_nm: float
) -> tuple[float, ...]:
    """Return three ranges, STEP_WAVES of defocus apart; none if the last would be beyond infinity."""
    focal = lens.focal_length_mm
    blur_mm = STEP_WAVES * blur_per_wave_um(lens.f_number, reference_nm * 1e-3) * 1e-3
    images = float(lens.image_distance_mm(near_mm)) - lens.f_number * blur_mm * np.arange(3)
    return (
        tuple(float(f"{r:.4g}") for r in images * focal / (images - focal))
        if images[-1] > focal
        else ()
    )


def _at_range(waves: float, sharp: Measured, blurred: Measured) -> Measured:
    """Return the expected measurement at a defocus: in focus, a step beyond, or its twin a step before."""
    if abs(waves) < STEP_WAVES / 2:
        return sharp
    return blurred if waves > 0 else blurred.twin()
