"""The camera before its edges are fitted: from a plan alone, or from a session's results."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.measured_camera import optics_behind
from labkit.analysis.observe import noise_prior
from labkit.calibration.stated_noise import UNMEASURED, with_stated
from labkit.edges.edge_fit import LensPrior
from labkit.edges.ranges import FOCI, FocusLaw
from labkit.estimation.climb import NoisePrior
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan, leading_channel
from labkit.results import Results
from labkit.uncertain import Uncertain

MODE_FLOOR = 1e-3  # waves RMS: as alike as a session's modes are at another range


@dataclass(frozen=True)
class Camera:
    """The camera in one channel. noise: as expected of a photograph; given: whether the modes come from a
    session.
    """

    channel: str
    optics: Optics
    lens: LensPrior
    noise: NoisePrior
    given: bool


def camera_of(
    plan: Plan, channel: str, results: Results | None, white: float, focus_mm: float | None
) -> Camera:
    """Return a channel's optics, lens and noise; the prior of usual modes for a lens without a session.

    Parameters
    ----------
    plan, channel : the camera
    results : of a session with the same lens
    white : counts above black at saturation
    focus_mm : range at which the lens is focused, for its working f-number
    """
    stated = next((of for of in plan.channel if of.name == channel), None)
    estimate = UNMEASURED if stated is None else with_stated(UNMEASURED, stated)
    noise = noise_prior(estimate, white)
    if results is None:
        optics = optics_of(plan, channel)
        f_number = optics.f_number
        if focus_mm is not None:
            f_number = float(_thin(plan).working_f_number(focus_mm))
        noll = (DEFOCUS, *(j for j in optics.noll if j != DEFOCUS))
        # a low-pass filter that the plan leaves to a fit: edges do not determine it
        filters = [p for p in optics.parts if p.name.startswith("low_pass_filter")]
        given = (*optics.given, *filters)
        optics = replace(
            optics, noll=noll, f_number=f_number, given=given, parts=(), panel=None
        )
        return Camera(channel, optics, LensPrior.unknown(len(noll) - 1), noise, given=False)
    wavefront = results.best_known(channel)
    modes = wavefront.at_focus()
    covariance = np.nan_to_num(modes.covariance) + MODE_FLOOR**2 * np.eye(len(modes.noll))
    if wavefront.gain > 0 and wavefront.read_noise > 0:
        noise = replace(noise, gain=wavefront.gain, read_variance=wavefront.read_noise**2)
    optics = replace(optics_behind(results, plan, wavefront), noll=(DEFOCUS, *modes.noll))
    return Camera(channel, optics, LensPrior(modes.waves, covariance), noise, given=True)


def _thin(plan: Plan) -> ThinLens:
    return ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)


def focus_law(
    plan: Plan, results: Results | None, channels: tuple[str, ...], focus: Uncertain | None
) -> FocusLaw | None:
    """Return the law of the lens focused as in the session, or at a stated range; None if neither is known.

    A stated range is green's, or the first channel's. The other best foci keep their distances in the session; without
    one they are unknown, and the law is of that channel alone.
    """
    best = {} if results is None or results.focus is None else results.focus.best_focus_mm
    known = {name: best[name] for name in channels if name in best}
    if focus is None and not known:
        return None
    names = tuple(known) or (leading_channel(channels),)
    lens, spread, zero = _lens(plan, results)
    each = [known.get(name, Uncertain(0.0, 0.0)) for name in names]
    foci = np.array([mm.value for mm in each])
    covariance = np.diag(np.square([*spread, zero.std, *(mm.std for mm in each)]))
    if focus is not None:
        foci += focus.value - foci[names.index(leading_channel(names))]
        covariance[FOCI:, FOCI:] += np.nan_to_num(focus.std) ** 2
    return FocusLaw(
        lens,
        names,
        foci,
        covariance,
        (plan if results is None else results).reference_wavelength_nm,
        plan.fit.convention,
        zero.value,
    )


def _lens(plan: Plan, results: Results | None) -> tuple[ThinLens, list[float], Uncertain]:
    """Return the lens, standard errors of the logarithms of its three numbers, and the zero of the scale of ranges."""
    if results is not None and results.lens is not None:
        of = results.lens
        numbers = (of.focal_length, of.f_number, of.pupil_magnification)
        thin = of.thin
        zero = of.range_zero
    else:
        numbers = (
            plan.lens.stated_focal_length,
            plan.lens.stated_f_number,
            Uncertain(1.0, USUAL_LOG_MAGNIFICATION),
        )
        thin = _thin(plan)
        zero = Uncertain(0.0, plan.fit.range_zero_std_mm if results else 0.0, "mm")
    return thin, [min(x.std / x.value, USUAL_LOG_MAGNIFICATION) for x in numbers], zero
