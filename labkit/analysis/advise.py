"""Before the first photograph: which target, how much light, which errors (thesis §3.7 with its misprint corrected)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import ceil, floor, isfinite, log, sqrt
from typing import Any

from labkit.analysis.expected_bound import ExpectedFit, expected_fit
from labkit.analysis.lens_model import Stated
from labkit.analysis.outlook import (
    NUMBERS,
    STEP_WAVES,
    Errors,
    Outlook,
    expected_member,
    middle_mm,
    outlook,
    propose_ranges,
)
from labkit.analysis.panel import panel_pixels
from labkit.analysis.seen_pixels import LEAST_CONTRAST
from labkit.analysis.stripe_contrast import stripe_contrast
from labkit.devices.panels import plan_panel
from labkit.errors import DataError, PlanError
from labkit.optics.lens import ThinLens, defocus_waves, ground_sample_mm
from labkit.plan import Channel, Plan
from labkit.plan.sensor import BAYER
from labkit.target import Target, open_target

AIRY_ZERO = 1.2197  # first zero of J1 over pi; the thesis prints 3.8317 in (3.49) to (3.53)
ELECTRONS = 20_000  # at white, of a usual pixel exposed to half of its well
WIDEST_PX = 160  # of the target in the frame the bounds are computed for; errors of larger ones go as 1/size
MOST_PX = 10_000  # across the widest sensors
ASSUMED = {
    "mono": "a mono sensor",
    BAYER: "a Bayer filter array: a quarter of the pixels red, half green, a quarter blue",
}
"""Filter arrays that `Sensor.assumed_pattern` names, in words."""
NAMED = 4  # of what is not determined
MOST_ELECTRONS, LEAST_WANTED, FARTHEST_MM = 1e9, 1e-7, 1e7


@dataclass(frozen=True)
class RangeAdvice:
    """One range. size_px: of the target's side; cell_airy: of its smallest cell in Airy radii; order: the highest whose
    cells the lens resolves; size_mm: the least side at which it resolves the plan's order; defocus_waves: expected, RMS;
    std_*: standard errors, waves RMS at the reference wavelength."""

    range_mm: float
    size_px: float
    cell_airy: float | None
    order: int
    size_mm: float | None
    defocus_waves: float
    std_defocus_waves: float
    std_wavefront_waves: float
    undetermined: tuple[str, ...]


@dataclass(frozen=True)
class Advice:
    """What to expect of a plan.

    channel: the one that the errors of wavefronts are of; ranges: one for each of the plan; session: what all of them together
    will determine of the lens, None with fewer than two ranges; proposed_ranges_mm: ranges that would determine the pupil
    magnification where the plan's do not, with proposed_std; nearest_mm: the range where a pixel of the display is an Airy
    radius, if there is a display; frames: photographs for each range for the wanted error, as exposed; notes: in words.
    """

    channel: str
    electrons: float
    ranges: tuple[RangeAdvice, ...]
    session: Outlook | None
    proposed_ranges_mm: tuple[float, ...]
    proposed_std: Errors
    nearest_mm: float | None
    frames: int | None
    notes: tuple[str, ...]

    @property
    def best_focus_std_mm(self) -> float | None:
        """Of the channel that the errors are of; None with fewer than two ranges."""
        return None if self.session is None else self.session.std[f"best_focus_mm.{self.channel}"]

    @property
    def magnification_std(self) -> float | None:
        """Of the pupil magnification; None with fewer than two ranges."""
        return None if self.session is None else self.session.std["pupil_magnification"]

    @property
    def magnification_determined(self) -> bool:
        """Whether these ranges determine the pupil magnification."""
        return self.session is not None and self.session.determined

    def as_json(self) -> dict[str, Any]:
        """With null for errors that are not finite."""
        data = asdict(self)
        for name in ("best_focus_std_mm", "magnification_std", "magnification_determined"):
            data[name] = getattr(self, name)
        for at in data["ranges"]:
            at.update({key: None for key, value in at.items() if isinstance(value, float) and not isfinite(value)})
        return data


@dataclass(frozen=True, slots=True)
class _Photographs:
    """What is photographed, and how: the same at every range. frames: of each range."""

    plan: Plan
    lens: ThinLens
    target: Target
    focus_mm: float
    electrons: float
    frames: int

    def side_px(self, range_mm: float) -> float:
        """Of the target in the frame."""
        plan = self.plan
        return plan.target.size_mm / float(ground_sample_mm(self.lens, range_mm, plan.sensor.pixel_pitch_um))

    def defocus(self, range_mm: float) -> float:
        """Waves RMS."""
        return float(defocus_waves(self.lens, range_mm, self.focus_mm, self.plan.reference_wavelength_nm))

    def fit(self, channel: Channel, range_mm: float, defocus: float) -> ExpectedFit:
        """What the photographs of a range will say in one channel; errors of large targets go as 1/size."""
        side_px = self.side_px(range_mm)
        one = expected_fit(
            self.plan,
            self.target,
            channel,
            f_number=float(self.lens.working_f_number(self.focus_mm)),
            side_px=min(side_px, WIDEST_PX),
            defocus_waves=defocus,
            electrons=self.electrons,
        )
        return one.scaled(min(1.0, WIDEST_PX / side_px) / sqrt(self.frames))


def advise(
    plan: Plan,
    *,
    ranges_mm: Sequence[float] | None = None,
    electrons: float = ELECTRONS,
    want_waves: float | None = None,
) -> Advice:
    """What to expect of a plan, from its lens, sensor, target and ranges alone.

    ranges_mm: instead of the plan's. electrons: at white, in one photograph. want_waves: a wavefront's standard error.
    The middle of the ranges is taken for best focus; errors of wavefronts are those of the shortest wavelength, with the cone
    known, those of the lens are what the estimate of the whole session will have. Raises PlanError where there are no
    ranges, DataError where want_waves or electrons is not positive.

    >>> labkit.advise(plan, ranges_mm=[3000, 3200]).best_focus_std_mm
    """
    _check_numbers(electrons, want_waves)
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    ranges = _ranges(plan, ranges_mm)
    frames = plan.camera.frames_per_range if plan.camera else 1
    target = open_target(plan.target)
    panel_pixels(plan, target)  # what is impossible is refused
    shots = _Photographs(plan, lens, target, middle_mm(ranges, lens), electrons, frames)
    of_light = {range_mm: shots.fit(_shortest(plan), range_mm, shots.defocus(range_mm)) for range_mm in ranges}
    advised = [_at(shots, range_mm, fit) for range_mm, fit in of_light.items()]
    session = _session(shots, of_light)
    proposed, proposed_std = ((), Errors()) if session is None or session.determined else _proposed(shots, min(ranges))
    wanted, light_notes = _wanted_frames(advised, frames, want_waves)
    nearest_mm = _nearest_mm(plan)
    return Advice(
        channel=_shortest(plan).name,
        electrons=electrons,
        ranges=tuple(advised),
        session=session,
        proposed_ranges_mm=proposed,
        proposed_std=proposed_std,
        nearest_mm=nearest_mm,
        frames=wanted,
        notes=(*_lens_notes(session, proposed, proposed_std), *_bench_notes(plan, advised, nearest_mm), *light_notes),
    )


def _session(shots: _Photographs, of_light: dict[float, ExpectedFit]) -> Outlook | None:
    """What all ranges together will determine. of_light: the fits of the shortest wavelength."""
    plan, first = shots.plan, _shortest(shots.plan)
    ranges = [range_mm for range_mm, fit in of_light.items() if not fit.bound.undetermined]
    if len(ranges) < 2 or plan.fit.zernike_noll[0] != 4:
        return None
    members = []
    for channel in plan.channel:
        for range_mm in ranges:
            fit = of_light[range_mm] if channel == first else shots.fit(channel, range_mm, shots.defocus(range_mm))
            if not fit.bound.undetermined:
                members.append(expected_member(range_mm, channel.name, fit.measured))
    return outlook(members, Stated.of(plan), shots.focus_mm)


def _proposed(shots: _Photographs, nearest_mm: float) -> tuple[tuple[float, ...], Errors]:
    """Ranges that determine the pupil magnification, by what fits of the shortest wavelength at the nearest would say."""
    sharp, blurred = (shots.fit(_shortest(shots.plan), nearest_mm, waves) for waves in (0.0, STEP_WAVES))
    if sharp.bound.undetermined or blurred.bound.undetermined:
        return (), {}
    channels = [channel.name for channel in shots.plan.channel]
    return propose_ranges(nearest_mm, channels, Stated.of(shots.plan), sharp.measured, blurred.measured)


def _lens_notes(session: Outlook | None, proposed: tuple[float, ...], proposed_std: Errors) -> list[str]:
    """What the ranges will hardly determine, and which measurement would, a line each."""
    notes = []
    for key in session.open_numbers() if session else ():
        assert session is not None
        name, unit = NUMBERS[key]
        better = {remedy.what: remedy.std[key] for remedy in session.worthwhile(key)}
        if key == "pupil_magnification" and proposed:
            better[f"ranges {', '.join(format(r, 'g') for r in proposed)} mm"] = proposed_std[key]
        would = "; ".join(f"{what} would make it ± {std:.2g}{unit}" for what, std in better.items())
        would = would or "no measurement beside the photographs would halve that; more light or a larger target may"
        notes.append(f"these ranges hardly determine the {name}, ± {session.std[key]:.2g}{unit}: {would}")
    return notes


def _bench_notes(plan: Plan, advised: Sequence[RangeAdvice], nearest_mm: float | None) -> list[str]:
    """Of target, display and sensor."""
    return [
        *_target_notes(plan, advised),
        *_display_notes(plan, advised, nearest_mm),
        *_sampling_notes(plan),
    ]


def _check_numbers(electrons: float, want_waves: float | None) -> None:
    """Raise DataError for numbers that are not allowed."""
    if not 1 <= electrons <= MOST_ELECTRONS:
        raise DataError(f"electrons = {electrons:g}: allowed is 1 to {MOST_ELECTRONS:g}")
    if want_waves is not None and not LEAST_WANTED <= want_waves <= 1:
        raise DataError(f"wanted error = {want_waves:g} waves: allowed is {LEAST_WANTED:g} to 1")


def _ranges(plan: Plan, ranges_mm: Sequence[float] | None) -> list[float]:
    """The ranges to advise on, in order. Raises PlanError where there are none, or one that no lens images."""
    ranges = sorted(set(ranges_mm or (plan.rail.ranges_mm if plan.rail else ())))
    if not ranges:
        raise PlanError("no ranges to advise on: the plan has no [rail] ranges_mm; give --range MM, once for each")
    focal_mm = plan.lens.focal_length_mm
    for range_mm in ranges:
        if not focal_mm < range_mm <= FARTHEST_MM:
            allowed = f"more than the focal length, {focal_mm:g} mm, and at most {FARTHEST_MM:g} mm"
            raise PlanError(f"range {range_mm:g} mm: allowed is {allowed}")
    return ranges


def _wanted_frames(
    advised: Sequence[RangeAdvice], frames: int, want_waves: float | None
) -> tuple[int | None, list[str]]:
    """Photographs of each range for a wanted error, and a note where they are more than planned."""
    worst = max(a.std_wavefront_waves for a in advised)
    if want_waves is None or not isfinite(worst):
        return None, []
    wanted = max(1, ceil(frames * (worst / want_waves) ** 2))
    if wanted <= frames:
        return wanted, []
    return wanted, [
        f"{wanted} photographs a range, or {wanted / frames:.3g} times the light, would bring the wavefront's standard "
        f"error from {worst:.2g} to {want_waves:g} waves"
    ]


def best_order(plan: Plan, range_mm: float) -> int:
    """The highest carpet order whose cells span an Airy radius or more at a range, (3.50)-(3.52) corrected; 0 for none."""
    elements = plan.target.size_mm / _airy_on_target_mm(plan, range_mm)
    return max(0, min(8, floor(log(max(elements, 1.0)) / log(3))))


def _airy_on_target_mm(plan: Plan, range_mm: float) -> float:
    """Radius of the Airy disc seen on the target, z1 lambda / D per unit of range, for the shortest wavelength."""
    wavelength_mm = _shortest(plan).wavelength_nm * 1e-6
    diameter_mm = plan.lens.focal_length_mm / plan.lens.f_number
    return AIRY_ZERO * wavelength_mm / diameter_mm * range_mm


def _nearest_mm(plan: Plan) -> float | None:
    """Range at which a pixel of the plan's display is an Airy radius, (3.49) corrected; nearer it is seen as a pixel."""
    panel = plan_panel(plan)
    return None if panel is None else panel.pitch_mm / _airy_on_target_mm(plan, 1.0)


def _shortest(plan: Plan) -> Channel:
    return min(plan.channel, key=lambda channel: channel.wavelength_nm)


def _at(shots: _Photographs, range_mm: float, fit: ExpectedFit) -> RangeAdvice:
    plan = shots.plan
    modes = plan.fit.zernike_noll[1] - plan.fit.zernike_noll[0] + 1
    cell_airy = size_mm = None
    if plan.target.kind == "sierpinski" and plan.target.order:
        size_mm = 3**plan.target.order * _airy_on_target_mm(plan, range_mm)
        cell_airy = plan.target.size_mm / size_mm
    return RangeAdvice(
        range_mm,
        shots.side_px(range_mm),
        cell_airy,
        best_order(plan, range_mm),
        size_mm,
        shots.defocus(range_mm),
        float(fit.bound.std[0]),
        fit.bound.rms(0, modes),
        fit.bound.undetermined,
    )


def _target_notes(plan: Plan, advised: Sequence[RangeAdvice]) -> list[str]:
    notes = []
    if plan.target.kind == "sierpinski" and plan.target.order is not None:
        lowest = min(a.order for a in advised)
        if plan.target.order > lowest:
            notes.append(
                f"order {plan.target.order} has cells smaller than the Airy disc: order {lowest} is nearly as good, "
                "and prints and shows more easily"
            )
        elif plan.target.order < lowest:
            notes.append(
                f"order {lowest} would be resolved too, and holds more fine detail than order {plan.target.order}"
            )
    smallest, largest = min(a.size_px for a in advised), max(a.size_px for a in advised)
    if smallest < 40:
        wide = 60 / smallest * plan.target.size_mm
        notes.append(f"the target spans {smallest:.0f} pixels only: about {wide:.3g} mm would span 60")
    if largest > MOST_PX:
        notes.append(f"the target spans {largest:.0f} pixels: no sensor holds all of it; choose a smaller one")
    for at in advised:
        if at.undetermined:
            many = len(at.undetermined)
            what = f"{many} combinations of wavefront, pose and light" if many > NAMED else ", ".join(at.undetermined)
            notes.append(f"at {at.range_mm:g} mm the photographs do not determine: {what}")
    return notes


def _display_notes(plan: Plan, advised: Sequence[RangeAdvice], nearest_mm: float | None) -> list[str]:
    panel = plan_panel(plan)
    if panel is None or nearest_mm is None:
        return []
    notes, pitch_mm = [], panel.pitch_mm
    if plan.target.kind == "sierpinski" and plan.target.order:
        cell_mm = plan.target.size_mm / 3**plan.target.order
        if cell_mm < pitch_mm:
            least = 3**plan.target.order * pitch_mm
            notes.append(
                f"cells of {cell_mm:.3g} mm are finer than the display's pixels, {pitch_mm:.3g} mm: show order "
                f"{plan.target.order} at {least:.3g} mm or more, or a lower order"
            )
    if plan.target.pixels is None:
        contrast, range_mm = max(
            (stripe_contrast(plan, pitch_mm, at.range_mm, at.defocus_waves), at.range_mm) for at in advised
        )
        if contrast > LEAST_CONTRAST:
            pixels = f'pixels = {{ pitch_mm = {pitch_mm:.4g}, layout = "rgb-stripes" }}'
            notes.append(
                f"at {range_mm:g} mm the display's own pixels will be seen with {contrast:.0%} of contrast, if they are "
                f"striped, and the plan has no [target.pixels]: add {pixels} to [target], the layout as the frame shows it"
            )
    return notes


def _sampling_notes(plan: Plan) -> list[str]:
    nyquist_um = _shortest(plan).wavelength_nm * 1e-3 * plan.lens.f_number / 2
    channel = _shortest(plan).name
    times = plan.sensor.pixels(channel).spacing_px * plan.sensor.pixel_pitch_um / nyquist_um
    notes = [
        f"a channel's pixels are {times:.1f} times as far apart as Nyquist requires: aliasing, which the fit models"
    ]
    if plan.sensor.cfa_pattern is None:
        assumed = ASSUMED[plan.sensor.assumed_pattern(channel)]
        notes.append(f"sensor.cfa_pattern is left to the files; assumed is {assumed}")
    return notes
