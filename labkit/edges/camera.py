"""The camera before its edges are fitted: from a plan alone, or from a session's results."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.measured_camera import optics_behind
from labkit.calibration.photon_transfer import (
    UNKNOWN_NOISE_STD,
    usual_gain,
    usual_read_variance,
)
from labkit.edges.edge_fit import LensPrior
from labkit.edges.ranges import FOCI, ZERO, FocusLaw
from labkit.estimation.climb import NoisePrior
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import Part
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan, leading_channel
from labkit.results import Results
from labkit.types import Floats
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
    """A channel's light and lens; of a lens that no session measured, the usual modes' prior.

    white: counts above black at saturation. focus_mm: what the lens is focused at, for its cone.
    """
    noise = NoisePrior(
        usual_gain(white), UNKNOWN_NOISE_STD, usual_read_variance(white), UNKNOWN_NOISE_STD
    )
    if results is None:
        optics = optics_of(plan, channel)
        cone = (
            optics.f_number
            if focus_mm is None
            else float(_thin(plan).working_f_number(focus_mm))
        )
        noll = (DEFOCUS, *(j for j in optics.noll if j != DEFOCUS))
        given = (*optics.given, *_cameras(optics))
        optics = replace(
            optics, noll=noll, f_number=cone, given=given, parts=(), panel=None
        )
        return Camera(channel, optics, LensPrior.unknown(len(noll) - 1), noise, given=False)
    wavefront = results.best_known(channel)
    modes = wavefront.at_focus()
    covariance = np.nan_to_num(modes.covariance) + MODE_FLOOR**2 * np.eye(len(modes.noll))
    if wavefront.gain > 0 and wavefront.read_noise > 0:
        noise = replace(noise, gain=wavefront.gain, read_variance=wavefront.read_noise**2)
    optics = replace(optics_behind(results, plan, wavefront), noll=(DEFOCUS, *modes.noll))
    return Camera(channel, optics, LensPrior(modes.waves, covariance), noise, given=True)


def _cameras(optics: Optics) -> tuple[Part, ...]:
    """Parts that a plan leaves to a fit, where there is no carpet to fit them to: as they begin."""
    return tuple(part for part in optics.parts if part.name.startswith("low_pass_filter"))


def _thin(plan: Plan) -> ThinLens:
    return ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)


def focus_law(
    plan: Plan, results: Results | None, channels: tuple[str, ...], focus: Uncertain | None
) -> FocusLaw | None:
    """The lens focused as the session left it, or at a stated range; None where neither says.

    A stated range is that of green, or of the first channel; the others' best foci keep their distances in the session, and
    without one are unknown: then the law is of that channel alone.
    """
    known = {} if results is None or results.focus is None else results.focus.best_focus_mm
    known = {name: known[name] for name in channels if name in known}
    if focus is None and not known:
        return None
    names = tuple(known) or (leading_channel(channels),)
    lens, spread, zero = _lens(plan, results)
    size = FOCI + len(names)
    covariance = np.zeros((size, size))
    covariance[:ZERO, :ZERO] = np.diag(spread**2)
    covariance[ZERO, ZERO] = zero.std**2
    foci = (
        np.array([known[name].value for name in names]) if known else np.zeros(len(names))
    )
    if known:
        covariance[FOCI:, FOCI:] = np.diag([known[name].std ** 2 for name in names])
    if focus is not None:
        reference = names.index(leading_channel(names))
        foci = foci - foci[reference] + focus.value
        covariance[FOCI:, FOCI:] += (0.0 if np.isnan(focus.std) else focus.std) ** 2
    reference_nm = (
        plan.reference_wavelength_nm if results is None else results.reference_wavelength_nm
    )
    foci_mm = tuple(float(mm) for mm in foci)
    return FocusLaw(
        lens, names, foci_mm, covariance, reference_nm, plan.fit.convention, zero.value
    )


def _lens(plan: Plan, results: Results | None) -> tuple[ThinLens, Floats, Uncertain]:
    """The lens, standard errors of the logarithms of its three numbers, and what the scale of ranges lacks."""
    if results is None or results.lens is None:
        f, n = plan.lens.stated_focal_length, plan.lens.stated_f_number
        spread = np.array([f.std / f.value, n.std / n.value, USUAL_LOG_MAGNIFICATION])
        return (
            _thin(plan),
            spread,
            Uncertain(0.0, plan.fit.range_zero_std_mm if results else 0.0, "mm"),
        )
    of = results.lens
    numbers = (of.focal_length, of.f_number, of.pupil_magnification)
    spread = np.array([min(x.std / x.value, USUAL_LOG_MAGNIFICATION) for x in numbers])
    return of.thin, spread, of.range_zero
