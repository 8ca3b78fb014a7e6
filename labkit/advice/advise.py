"""Before the first photograph: which target, how much light, which errors (thesis §3.7 with its misprint corrected)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import ceil, floor, isfinite, log
from typing import Any

from labkit.advice.expected_fit import ExpectedFit, Setup
from labkit.advice.notes import notes_of
from labkit.advice.outlook import (
    STEP_WAVES,
    Errors,
    Outlook,
    Proposal,
    outlook,
    propose_ranges,
)
from labkit.errors import DataError, PlanError
from labkit.estimation.stated import Stated
from labkit.jobs.threads import one_thread
from labkit.key import Key
from labkit.optics.wavefront import DEFOCUS
from labkit.panel.panels import plan_panel
from labkit.panel.target_pixels import panel_pixels
from labkit.plan import Channel, Plan

AIRY_ZERO = 1.2197  # first zero of J1 over pi; the thesis prints 3.8317 in (3.49) to (3.53)
ELECTRONS = 20_000  # at white, of a usual pixel exposed to half of its well
MOST_ORDER = 8  # of a carpet: finer ones have more cells than any display has pixels
MOST_ELECTRONS = 1e9
LEAST_WANTED = 1e-7
FARTHEST_ADVISED_MM = 1e7


@dataclass(frozen=True)
class RangeAdvice:
    """Advice for one range.

    Parameters
    ----------
    size_px : side of the target, pixels
    cell_airy : side of the smallest cell, Airy radii
    order : highest carpet order whose cells the lens resolves
    size_mm : least side at which the lens resolves the plan's order
    defocus_waves : expected, RMS
    tiles : into which a large target is cut, at most; its errors are those of one of them
    std_* : standard errors, waves RMS at the reference wavelength
    """

    range_mm: float
    size_px: float
    cell_airy: float | None
    order: int
    size_mm: float | None
    defocus_waves: float
    std_defocus_waves: float
    std_wavefront_waves: float
    undetermined: tuple[str, ...]
    tiles: int = 1

    def as_json(self) -> dict[str, Any]:
        """Return the advice as JSON, with null for errors that are not finite."""
        finite = {
            name: not isinstance(value, float) or isfinite(value)
            for name, value in asdict(self).items()
        }
        return {name: getattr(self, name) if finite[name] else None for name in finite}


@dataclass(frozen=True)
class Advice:
    """The prediction for a plan.

    Parameters
    ----------
    channel : of the wavefronts whose errors are predicted
    ranges : advice for each range of the plan
    session : standard errors of the lens from all ranges; None with fewer than two
    proposed_ranges_mm : ranges that would determine the pupil magnification, if the plan's
        do not, with proposed_std
    determined_noll : last Zernike mode up to which the nearest range's photographs determine each
        mode to 0.01 waves; or 0
    nearest_mm : range where a pixel of the display spans an Airy radius; None without a
        display
    frames : photographs of each range for the requested error, at the exposure given
    notes : remarks in words
    """

    channel: str
    electrons: float
    ranges: tuple[RangeAdvice, ...]
    session: Outlook | None
    proposed_ranges_mm: tuple[float, ...]
    proposed_std: Errors
    determined_noll: int
    nearest_mm: float | None
    frames: int | None
    notes: tuple[str, ...]

    @property
    def best_focus_std_mm(self) -> float | None:
        """Standard error of best focus in `channel`, mm; None with fewer than two ranges."""
        return (
            None
            if self.session is None
            else self.session.std[f"best_focus_mm.{self.channel}"]
        )

    @property
    def magnification_std(self) -> float | None:
        """Standard error of the pupil magnification; None with fewer than two ranges."""
        return None if self.session is None else self.session.std["pupil_magnification"]

    @property
    def magnification_determined(self) -> bool:
        """Return whether these ranges determine the pupil magnification."""
        return self.session is not None and self.session.determined

    def as_json(self) -> dict[str, Any]:
        """Return the advice as JSON, with null for errors that are not finite."""
        return asdict(self) | {
            "ranges": [at.as_json() for at in self.ranges],
            "best_focus_std_mm": self.best_focus_std_mm,
            "magnification_std": self.magnification_std,
            "magnification_determined": self.magnification_determined,
        }


@one_thread
def advise(
    plan: Plan,
    *,
    ranges_mm: Sequence[float] | None = None,
    electrons: float = ELECTRONS,
    want_waves: float | None = None,
) -> Advice:
    """Predict the standard errors of a plan from its lens, sensor, target and ranges alone.

    Best focus is assumed in the middle of the ranges. Errors of wavefronts are for the
    shortest wavelength and a known working f-number. Errors of the lens are for the
    estimate of the whole session.

    Parameters
    ----------
    ranges_mm : in place of the plan's
    electrons : at white, in one photograph
    want_waves : requested standard error of a wavefront

    Raises
    ------
    PlanError
        there are no ranges
    DataError
        want_waves or electrons is not positive

    >>> labkit.advise(plan, ranges_mm=[3000, 3200]).best_focus_std_mm
    """
    _check_numbers(electrons, want_waves)
    ranges = _ranges(plan, ranges_mm)
    setup = Setup.of(plan, ranges, electrons)
    panel_pixels(plan, setup.target)  # what is impossible is refused
    return _advice(setup, ranges, want_waves)


def _advice(setup: Setup, ranges: Sequence[float], want_waves: float | None) -> Advice:
    channel = shortest(setup.plan)
    fits = {
        range_mm: setup.fit(channel, range_mm, setup.defocus(range_mm))
        for range_mm in ranges
    }
    advised = tuple(_at(setup, range_mm, fit) for range_mm, fit in fits.items())
    session = _session(setup, fits)
    proposal = _proposal(setup, session, min(ranges))
    frames = _wanted_frames(advised, setup.frames, want_waves)
    return Advice(
        channel=channel.name,
        electrons=setup.electrons,
        ranges=advised,
        session=session,
        proposed_ranges_mm=proposal.ranges_mm,
        proposed_std=proposal.std,
        determined_noll=setup.determined_noll(channel, min(ranges)),
        nearest_mm=_nearest_mm(setup.plan),
        frames=frames,
        notes=tuple(
            notes_of(setup, channel, advised, session, proposal, want_waves, frames)
        ),
    )


def shortest(plan: Plan) -> Channel:
    """Return the channel of the shortest wavelength."""
    return min(plan.channel, key=lambda channel: channel.wavelength_nm)


def _session(setup: Setup, fits: Mapping[float, ExpectedFit]) -> Outlook | None:
    """Predict the errors of all ranges together.

    fits: of the shortest wavelength, by range
    """
    plan = setup.plan
    ranges = [range_mm for range_mm, fit in fits.items() if not fit.bound.undetermined]
    if len(ranges) < 2 or DEFOCUS not in plan.fit.noll:
        return None
    first = shortest(plan)
    every = {
        Key(range_mm, channel.name): fits[range_mm]
        if channel == first
        else setup.fit(channel, range_mm, setup.defocus(range_mm))
        for channel in plan.channel
        for range_mm in ranges
    }
    determined = {
        key: setup.of_all_tiles(fit, key.range_mm or 0.0).measured
        for key, fit in every.items()
        if not fit.bound.undetermined
    }
    return outlook(determined, Stated.of(plan), setup.focus_mm)


def _proposal(setup: Setup, session: Outlook | None, nearest_mm: float) -> Proposal:
    """Propose ranges for the pupil magnification if the session does not determine this number.

    The proposal rests on fits of the shortest wavelength at the nearest range.
    """
    if session is None or session.determined:
        return Proposal()
    plan = setup.plan
    sharp, blurred = (
        setup.fit(shortest(plan), nearest_mm, waves) for waves in (0.0, STEP_WAVES)
    )
    if sharp.bound.undetermined or blurred.bound.undetermined:
        return Proposal()
    channels = [channel.name for channel in plan.channel]
    return propose_ranges(
        nearest_mm, channels, Stated.of(plan), sharp.measured, blurred.measured
    )


def _check_numbers(electrons: float, want_waves: float | None) -> None:
    """Raise DataError for numbers that are not allowed."""
    if not 1 <= electrons <= MOST_ELECTRONS:
        raise DataError(f"electrons = {electrons:g}: allowed is 1 to {MOST_ELECTRONS:g}")
    if want_waves is not None and not LEAST_WANTED <= want_waves <= 1:
        raise DataError(
            f"wanted error = {want_waves:g} waves: allowed is {LEAST_WANTED:g} to 1"
        )


def _ranges(plan: Plan, ranges_mm: Sequence[float] | None) -> list[float]:
    """Return the ranges to advise on, in order.

    Raises PlanError without ranges, or for a range that no lens images.
    """
    ranges = sorted(set(ranges_mm or (plan.rail.ranges_mm if plan.rail else ())))
    if not ranges:
        raise PlanError(
            "no ranges to advise on: the plan has no [rail] ranges_mm; give --range MM, once for each"
        )
    focal_mm = plan.lens.focal_length_mm
    for range_mm in ranges:
        if not focal_mm < range_mm <= FARTHEST_ADVISED_MM:
            allowed = f"more than the focal length, {focal_mm:g} mm, and at most {FARTHEST_ADVISED_MM:g} mm"
            raise PlanError(f"range {range_mm:g} mm: allowed is {allowed}")
    return ranges


def _wanted_frames(
    advised: Sequence[RangeAdvice], frames: int, want_waves: float | None
) -> int | None:
    """Return the number of photographs of each range for the requested error."""
    worst = max(at.std_wavefront_waves for at in advised)
    if want_waves is None or not isfinite(worst):
        return None
    return max(1, ceil(frames * (worst / want_waves) ** 2))


def best_order(plan: Plan, range_mm: float) -> int:
    """Return the highest carpet order whose cells span an Airy radius at a range, or 0.

    Equations (3.50) to (3.52) of the thesis, corrected.
    """
    elements = plan.target.size_mm / _airy_on_target_mm(plan, range_mm)
    return min(MOST_ORDER, floor(log(max(elements, 1.0)) / log(3)))


def _airy_on_target_mm(plan: Plan, range_mm: float) -> float:
    """Return the radius of the Airy disc on the target at a range, shortest wavelength; (3.49) corrected."""
    wavelength_mm = shortest(plan).wavelength_nm * 1e-6
    diameter_mm = plan.lens.focal_length_mm / plan.lens.f_number
    return AIRY_ZERO * wavelength_mm / diameter_mm * range_mm


def _nearest_mm(plan: Plan) -> float | None:
    """Return the range at which a pixel of the plan's display spans an Airy radius; (3.49) corrected.

    At a shorter range the photograph resolves the pixels.
    """
    panel = plan_panel(plan)
    return None if panel is None else panel.pitch_mm / _airy_on_target_mm(plan, 1.0)


def _at(setup: Setup, range_mm: float, fit: ExpectedFit) -> RangeAdvice:
    plan = setup.plan
    cell_airy = size_mm = None
    if plan.target.kind == "sierpinski" and plan.target.order:
        size_mm = 3**plan.target.order * _airy_on_target_mm(plan, range_mm)
        cell_airy = plan.target.size_mm / size_mm
    return RangeAdvice(
        range_mm=range_mm,
        size_px=setup.side_px(range_mm),
        cell_airy=cell_airy,
        order=best_order(plan, range_mm),
        size_mm=size_mm,
        defocus_waves=setup.defocus(range_mm),
        std_defocus_waves=float(fit.bound.std[0]),
        std_wavefront_waves=fit.bound.rms(0, len(plan.fit.noll)),
        undetermined=fit.bound.undetermined,
        tiles=setup.tiles(range_mm),
    )
