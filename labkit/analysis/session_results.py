"""Convert an estimate to results: wavefronts, best focus, lens and error budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.doubts import confirmed, shift
from labkit.estimation.estimate import Estimate, LocalFit
from labkit.estimation.held_out import pulls_of_tiles
from labkit.estimation.laws import (
    F_NUMBER,
    FOCAL_LENGTH,
    MAGNIFICATION,
    RANGE_ZERO,
)
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.local import residuals
from labkit.estimation.residuals import residual_frequencies
from labkit.estimation.settings import SETTINGS
from labkit.imaging.optics import Optics
from labkit.optics.known_bias import covariance_with_bias, error_with_bias
from labkit.optics.lens import TELLING_STD, blur_per_wave_um
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan
from labkit.results import (
    Focus,
    Lens,
    OptimumTest,
    OtherOptimum,
    Placement,
    Residuals,
    ResidualSpectrum,
    Wavefront,
)
from labkit.types import Floats
from labkit.uncertain import Uncertain


def as_wavefronts(session: Estimate) -> tuple[Wavefront, ...]:
    """Convert every fit to a result. Members get the values estimated from the whole session."""
    wavefronts = []
    pulls = {} if session.lens is None else pulls_of_tiles(session.lens)
    for k in range(len(session.fits)):
        wavefront = _with_bias(session, k)
        if k in session.members:
            wavefront = _of_session(wavefront, session, k)
        test = _judged(_test_of(session.fits[k]), session, k)
        missing = () if test.explains else session.missing
        sign_open = k not in session.signed
        wavefronts.append(
            replace(
                wavefront,
                test=test,
                missing=missing,
                sign_open=sign_open,
                pulls=pulls.get(wavefront.key),
            )
        )
    return tuple(wavefronts)


def _with_bias(session: Estimate, k: int) -> Wavefront:
    """Convert fit k, with errors that include the bias due to missing parts."""
    local, complete = session.fits[k], session.with_all_parts(k)
    w = as_wavefront(local, session.with_stated_camera(k))
    if local.optimum is complete:
        return w
    modes, cone = shift(local.optimum, complete)
    std = error_with_bias(np.array(w.f_number_std), np.array(w.f_number * cone))
    covariance = covariance_with_bias(w.covariance, modes)
    return replace(w, covariance=covariance, f_number_std=float(std))


def _judged(test: OptimumTest, session: Estimate, k: int) -> OptimumTest:
    """Classify a fit: the session decides whether the optimum is right, the residuals whether the model is complete.

    At one range only the many starts that returned to an optimum confirm the optimum. If the model lacks a part, the same fit
    with the part may confirm the optimum.
    """
    if not test.accepted and confirmed(session, k):
        return replace(test, name="parts", accepted=True)
    if k in session.outliers:
        return replace(test, name="session", accepted=False)
    if test.accepted:
        return test
    if len({session.fits[i].observation.range_mm for i in session.members}) > 1:
        by_session = k in session.members
        return replace(test, name="session", accepted=True) if by_session else test
    by_starts = session.fits[k].found.settled and not test.undetermined
    return replace(test, name="starts", accepted=True) if by_starts else test


def _of_session(w: Wavefront, session: Estimate, k: int) -> Wavefront:
    """Replace the values of member k by the session's.

    Modes that differ between ranges of an incomplete model err by as much: the lens has one set of modes.
    """
    lens = session.lens
    assert lens is not None
    values, covariance = lens.posterior(session.row(k))
    noll = lens.model.noll
    modes = len(noll)
    if session.incomplete:
        covariance = covariance + np.diag(lens.model.mode_scatter())
    labels = lens.model.parts
    optics = session.fits[k].optics
    numbers = dict(zip(labels, values[modes:-2], strict=True))
    parameters = [*(numbers[label] for label in optics.camera_labels), values[-2]]
    f_number, waves = float(np.exp(values[-2])), values[:modes]
    optics = optics.with_camera_parameters(np.array(parameters))
    at = noll.index(DEFOCUS)
    um = blur_per_wave_um(f_number, w.reference_wavelength_nm * 1e-3)
    pull = np.zeros(len(values))
    pull[[at, -2]] = um, um * waves[at]
    light_nm = w.wavelength_nm * float(np.exp(lens.longer(session.row(k))))
    lambda_n_um = 1e-3 * light_nm * f_number
    return replace(
        w,
        wavelength_nm=light_nm,
        spectrum=optics.light,
        rim=optics.rim,
        noll=noll,
        waves=waves,
        covariance=covariance[:modes, :modes],
        f_number=f_number,
        f_number_std=f_number * float(np.sqrt(covariance[-2, -2])),
        lambda_n=Uncertain(lambda_n_um, lambda_n_um * lens.scale_std(session.row(k)), "um"),
        blur=Uncertain(um * waves[at], float(np.sqrt(pull @ covariance @ pull)), "um"),
    )


def as_focus(lens: LensFit, turned: Sequence[LensFit] = ()) -> Focus | None:
    """Return best focus of all channels with two stations or more; None without such a channel.

    turned: estimates with the other sign where signs are open; errors include the largest difference from them.
    """
    model, stations = lens.model, stations_of(lens)
    channels = [channel for channel in model.channels if len(stations.get(channel, ())) > 1]
    if not channels:
        return None
    pupils = pupil_magnification(lens)
    combinations = np.array(
        [
            *(model.best_focus(channel) for channel in channels),
            model.column(MAGNIFICATION) * pupils.value,
        ]
    )
    covariance = lens.errors_of(combinations)
    if turned:
        moved = [combinations @ (other.theta - lens.theta) for other in turned]
        farthest = np.argmax(np.abs(moved), axis=0)
        covariance = covariance_with_bias(
            covariance, np.diagonal(np.array(moved)[farthest])
        )
    values, stds = (combinations @ lens.theta).tolist(), np.sqrt(np.diag(covariance))
    best = {
        channel: Uncertain(value, std, "mm")
        for channel, value, std in zip(channels, values, stds.tolist(), strict=False)
    }
    rest = lens.measured.values - lens.solved.predicted
    return Focus(
        best,
        pupils,
        pupils.std <= TELLING_STD and not at_bound(pupils),
        {c: _defocus_of(lens, c, rest) for c in channels},
        covariance,
        lens.chi2 / lens.degrees_of_freedom if lens.degrees_of_freedom >= 1 else None,
        {c: _defocus_of(lens, c, lens.residual_std) for c in channels},
    )


def _defocus_of(lens: LensFit, channel: str, values: Floats) -> tuple[float, ...]:
    """Select defocus of a channel's members from values (n, values) of all observations."""
    return tuple(
        float(values[k, lens.model.defocus])
        for k in np.flatnonzero(lens.measured.used)
        if lens.model.readings[k].key.channel == channel
    )


def as_lens(lens: LensFit) -> Lens:
    """Return focal length, f-number at infinity, pupil magnification, and true less stated range."""
    return Lens(
        lens.uncertain(FOCAL_LENGTH, unit="mm"),
        lens.uncertain(F_NUMBER),
        pupil_magnification(lens),
        lens.uncertain(RANGE_ZERO, unit="mm"),
    )


def wavelengths_nm(lens: LensFit, plan: Plan) -> dict[str, Uncertain]:
    """Return the wavelength of each channel, nm."""
    channels = [reading.key.channel for reading in lens.model.readings]
    found = dict[str, Uncertain]()
    for one in plan.channel:
        if one.name in channels:
            k = channels.index(one.name)
            nm = one.wavelength_nm * float(np.exp(lens.longer(k)))
            row = lens.model.longer[lens.model.exposures[k]]
            std = nm * float(np.sqrt(lens.errors_of(row[None])[0, 0]))
            found[one.name] = Uncertain(nm, std, "nm")
    return found


def budget(lens: LensFit) -> dict[str, dict[str, float]]:
    """Return the error budget of every headline number: standard errors by photons, calibration, geometry, model."""
    model, stations = lens.model, stations_of(lens)
    wanted = {
        f"best_focus_mm.{name}": model.best_focus(name)
        for name in model.channels
        if len(stations.get(name, ())) > 1
    }
    wanted |= {
        "focal_length_mm": model.column(FOCAL_LENGTH),
        "f_number": model.column(F_NUMBER),
        "pupil_magnification": model.column(MAGNIFICATION)
        * pupil_magnification(lens).value,
        "range_zero_mm": model.column(RANGE_ZERO),
    }
    return {name: lens.contributions(combination) for name, combination in wanted.items()}


def stations_of(lens: LensFit) -> dict[str, set[float]]:
    """Return the rail stations of each channel's members."""
    seen = dict[str, set[float]]()
    for reading, used in zip(lens.model.readings, lens.measured.used, strict=True):
        if used:
            seen.setdefault(reading.key.channel, set()).add(reading.station)
    return seen


def pupil_magnification(lens: LensFit) -> Uncertain:
    """Return the pupil magnification of a lens."""
    value = float(np.exp(lens.value(MAGNIFICATION)))
    return Uncertain(value, value * lens.std(MAGNIFICATION))


def at_bound(pupils: Uncertain) -> bool:
    """Return whether a pupil magnification is at one of its bounds, which stopped the estimate."""
    least, most = SETTINGS.magnification_bounds
    return not 1.001 * least < pupils.value < most / 1.001


def as_wavefront(local: LocalFit, with_stated_camera: LocalFit | None = None) -> Wavefront:
    """Convert a local fit to a result. with_stated_camera: the fit without the added camera parts, if any were added."""
    optics: Optics = local.optics
    observation, optimum = local.observation, local.optimum
    poses = [
        pose.shifted(*(-float(at) for at in observation.origin_px))
        for pose in optimum.state.poses
    ]
    return Wavefront(
        range_mm=observation.range_mm,
        measured_range_mm=observation.measured_range_mm,
        channel=observation.channel,
        wavelength_nm=round(optics.wavelength_um * 1e3, 6),
        reference_wavelength_nm=round(optics.reference_um * 1e3, 6),
        spectrum=optics.light,
        rim=optics.rim,
        f_number=optics.f_number,
        f_number_std=float(np.sqrt(optimum.measured.covariance[-2, -2])) * optics.f_number,
        noll=optimum.noll,
        waves=optimum.waves,
        covariance=optimum.covariance,
        poses=np.array([pose.v for pose in optimum.state.poses]),
        gain=optimum.state.gain,
        read_noise=optimum.state.read_noise,
        chi2_per_pixel=float(optimum.chi2_per_pixel),
        test=_test_of(local),
        residual_spectrum=ResidualSpectrum(
            residual_frequencies(observation.frames),
            optimum.residual_power,
            None
            if with_stated_camera is None
            else with_stated_camera.optimum.residual_power,
        ),
        seconds=local.found.seconds,
        frames=observation.names,
        placement=Placement(
            observation.origin_px,
            observation.shape,
            np.array([pose.corners_px() for pose in poses]),
        ),
        residuals=_residuals(local),
        tile=observation.tile,
        sign_open=True,
    )


def _test_of(local: LocalFit) -> OptimumTest:
    """Return the test of an optimum by its own residuals."""
    verdict = local.optimum.verdict
    return OptimumTest(
        verdict.name,
        verdict.accepted,
        verdict.p_value,
        local.found.starts,
        verdict.undetermined,
        tuple(OtherOptimum(waves, below) for waves, below in local.found.others),
        verdict.accepted,
    )


def _residuals(local: LocalFit) -> Residuals:
    """Return counts, model and noise of each Bayer plane of each frame; nan for unused pixels."""
    observation = local.observation
    planes = []
    for frame, (mean, std) in zip(
        observation.frames, residuals(local.optimum, observation.frames), strict=True
    ):
        images = np.full((3, *frame.counts.shape), np.nan)
        images[:, frame.used] = frame.counts[frame.used], mean, std
        every = observation.period
        planes.append(
            [images[:, row::every, column::every] for row, column in observation.places]
        )
    data, model, sigma = np.moveaxis(np.array(planes), 2, 0)
    return Residuals(data, model, sigma)
