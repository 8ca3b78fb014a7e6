"""A session's fits and its lens, as results keep them: wavefronts, best focus, the lens, and where the errors come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.analysis.lens_fit import LEAST_MAGNIFICATION, MOST_MAGNIFICATION, LensFit
from labkit.analysis.lens_model import GEOMETRY
from labkit.analysis.local_fits import LocalFit
from labkit.analysis.model_error import confirmed, shift
from labkit.analysis.session_fits import SessionFits
from labkit.estimation.errors import covariance_with_bias, error_with_bias
from labkit.imaging.optics import Optics
from labkit.inference.fit import residuals
from labkit.inference.residual_spectrum import residual_frequencies
from labkit.optics.lens import TELLING_STD, blur_per_wave_um
from labkit.results import Focus, Lens, OptimumTest, OtherOptimum, Placement, Residuals, ResidualSpectrum, Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

FOCAL_LENGTH, F_NUMBER, MAGNIFICATION, TAPE = GEOMETRY[:4]


def as_wavefronts(session: SessionFits) -> tuple[Wavefront, ...]:
    """Of every fit. Those that belong to a lens are as the whole session has them."""
    wavefronts = [_leaning(session, k) for k in range(len(session.fits))]
    for place, index in enumerate(session.members):
        assert session.lens is not None
        values, covariance = session.lens.posterior(place)
        wavefronts[index] = _with(wavefronts[index], session.fits[index].fit.optics, values, covariance)
    judged = [_judged(w, k, session) for k, w in enumerate(wavefronts)]
    return tuple(w if w.test is None or w.test.explains else replace(w, missing=session.missing) for w in judged)


def _leaning(session: SessionFits, k: int) -> Wavefront:
    """Fit k as results keep it, with errors that hold what a missing part may move it by."""
    local, fullest = session.fits[k], session.fullest(k)
    w = as_wavefront(local, session.unaided(k))
    if local is fullest:
        return w
    modes, cone = shift(local.fit, fullest.fit)
    std = float(error_with_bias(np.array(w.f_number_std), np.array(w.f_number * cone)))
    return replace(w, covariance=covariance_with_bias(w.covariance, modes), f_number_std=std)


def _judged(w: Wavefront, index: int, session: SessionFits) -> Wavefront:
    """With the session's word on the optimum, where it has one: other frames show a wrong optimum, residuals a poor model.

    Of frames without others, the search's: many starts that come back. Where the model lacks a part, of the same fit with it.
    """
    if w.test is None:
        return w
    if not w.test.accepted and confirmed(session, index):
        return replace(w, test=replace(w.test, name="parts", accepted=True))
    if session.lens is None:
        if w.test.undetermined or not session.fits[index].fit.settled:
            return w
        return replace(w, test=replace(w.test, name=w.test.name if w.test.accepted else "starts", accepted=True))
    if index in session.members and not w.test.accepted:
        return replace(w, test=replace(w.test, name="session", accepted=True))
    if index in session.strangers:
        return replace(w, test=replace(w.test, name="session", accepted=False))
    return w


def _with(w: Wavefront, optics: Optics, values: Floats, covariance: Floats) -> Wavefront:
    """A wavefront with a session's values for it, as of `Measured`. optics: of its fit."""
    modes = len(w.noll)
    f_number, waves = float(np.exp(values[-2])), values[:modes]
    blur = None
    if 4 in w.noll:
        um = blur_per_wave_um(f_number, w.reference_wavelength_nm * 1e-3)
        pull = np.zeros(len(values))
        pull[[w.noll.index(4), -2]] = um, um * waves[w.noll.index(4)]
        blur = Uncertain(um * waves[w.noll.index(4)], float(np.sqrt(pull @ covariance @ pull)), "um")
    return replace(
        w,
        spectrum=optics.shaped(values[modes:-1]).light.physical,
        waves=waves,
        covariance=covariance[:modes, :modes],
        f_number=f_number,
        f_number_std=f_number * float(np.sqrt(covariance[-2, -2])),
        blur=blur,
    )


def as_focus(lens: LensFit) -> Focus | None:
    """Best focus of the channels that were seen at two ranges or more; None where there is none."""
    model = lens.model
    channels = [c for c in model.channels if len({m.stop for m in model.members if m.channel == c}) > 1]
    if not channels:
        return None
    columns = [*(model.index("best focus", c) for c in channels), model.index(MAGNIFICATION)]
    pupils = _magnification(lens)
    scale = np.append(np.ones(len(channels)), pupils.value)
    covariance = lens.errors[np.ix_(columns, columns)] * np.outer(scale, scale)
    rest = _defocus_residuals(lens)
    inside = 1.001 * LEAST_MAGNIFICATION < pupils.value < MOST_MAGNIFICATION / 1.001
    return Focus(
        {c: Uncertain(lens.value("best focus", c), lens.std("best focus", c), "mm") for c in channels},
        pupils,
        pupils.std <= TELLING_STD and inside,
        {c: tuple(rest[k] for k, m in enumerate(model.members) if m.channel == c) for c in channels},
        covariance,
        lens.chi2 / lens.freedom if lens.freedom else None,
    )


def as_lens(lens: LensFit) -> Lens:
    """Focal length, f-number at infinity, pupil magnification, and what is to be added to the stated ranges."""
    return Lens(
        Uncertain(lens.value(FOCAL_LENGTH), lens.std(FOCAL_LENGTH), "mm"),
        Uncertain(lens.value(F_NUMBER), lens.std(F_NUMBER)),
        _magnification(lens),
        Uncertain(lens.value(TAPE), lens.std(TAPE), "mm"),
    )


def budget(lens: LensFit) -> dict[str, dict[str, float]]:
    """Of every headline number its standard error by source: photons, calibration, geometry, model."""
    model, wanted = lens.model, dict[str, tuple[int, float]]()
    for name in model.channels:
        wanted[f"best_focus_mm.{name}"] = model.index("best focus", name), 1.0
    wanted["focal_length_mm"] = model.index(FOCAL_LENGTH), 1.0
    wanted["f_number"] = model.index(F_NUMBER), 1.0
    wanted["pupil_magnification"] = model.index(MAGNIFICATION), _magnification(lens).value
    wanted["range_zero_mm"] = model.index(TAPE), 1.0
    unit = np.eye(len(model.columns))
    return {name: lens.contributions(scale * unit[column]) for name, (column, scale) in wanted.items()}


def warnings_of(session: SessionFits) -> list[str]:
    """What the session found, a line each."""
    lens, labels = session.lens, [local.task.label for local in session.fits]
    warnings = [
        f"{labels[k]}: the search ended after {local.task.patience_s:g} s of processor time and {local.fit.starts} starts "
        "without an accepted optimum; the likeliest is kept, a longer --patience searches further"
        for k, local in enumerate(session.fits)
        if local.fit.cut_short and k not in session.members
    ]
    warnings += [f"{labels[k]}: fitted again from what the other fits predict, and mended" for k in session.mended]
    warnings += [
        f"{labels[k]}: does not belong to the session, as the other fits have it; was the lens touched, or is it another "
        "optimum? It is left out of best focus"
        for k in session.strangers
    ]
    if lens is None:
        ranged = any(local.ranged for local in session.fits)
        fitted = any(4 in local.fit.noll for local in session.fits)
        why = (
            "every fit was rejected" if ranged else "the frames carry no ranges" if fitted else "defocus was not fitted"
        )
        return [*warnings, f"no best focus: {why}"]
    warnings += [
        f"{channel}: these ranges leave the sign of its defocus open; ranges on both sides of focus would determine it"
        for channel in session.open_channels
    ]
    warnings += _lens_warnings(lens)
    return warnings


def _lens_warnings(lens: LensFit) -> list[str]:
    warnings, pupils = [], _magnification(lens)
    for channel in lens.model.channels:
        if len({m.stop for m in lens.model.members if m.channel == channel}) < 2:
            warnings.append(
                f"no best focus of {channel}: it needs at least 2 ranges: photograph the target at more ranges"
            )
    if not LEAST_MAGNIFICATION * 1.001 < pupils.value < MOST_MAGNIFICATION / 1.001:
        warnings.append(
            f"no pupil magnification from {LEAST_MAGNIFICATION:g} to {MOST_MAGNIFICATION:g} fits: defocus does not follow a "
            "lens's curve; check ranges, focal length and target size"
        )
    elif pupils.std > TELLING_STD:
        warnings.append(
            f"these ranges do not determine the pupil magnification: its standard error is {pupils.std:.3f}; "
            "ranges near the closest focus would, or a focal length and a tape known better"
        )
    if not lens.model.paraxial:
        off = 100 * np.expm1(lens.value("cone"))
        warnings.append(
            f"cone and sizes do not follow from one lens that is focused as a whole (the cone is {off:+.1f} % off): they were "
            "not used for focal length, f-number and pupil magnification; are wavelengths, pixel pitch and target size right?"
        )
    if not lens.model.shared:
        warnings.append("the modes differ from range to range beyond their errors: they were estimated for each range")
    if lens.widening > 1:
        warnings.append(
            f"the fits depart from one lens by {lens.widening:.1f} times their standard errors (χ² per degree of freedom "
            f"{lens.chi2 / lens.freedom:.1f}); all errors were widened by as much"
        )
    return warnings


def _magnification(lens: LensFit) -> Uncertain:
    value = float(np.exp(lens.value(MAGNIFICATION)))
    return Uncertain(value, value * lens.std(MAGNIFICATION))


def _defocus_residuals(lens: LensFit) -> list[float]:
    """Measured less modelled defocus of each member, waves RMS."""
    rest = []
    for member, predicted in zip(lens.model.members, lens.model.predicted(lens.theta), strict=True):
        at = member.measured.noll.index(4)
        rest.append(float(member.measured.values[at] - predicted[at]))
    return rest


def as_wavefront(local: LocalFit, unaided: LocalFit | None = None) -> Wavefront:
    """A local fit as results keep it. unaided: the same without the parts that were found, if any were."""
    optics, observation, fit = local.fit.optics, local.task.observation, local.fit
    poses = [pose.shifted(*(-float(at) for at in observation.origin_px)) for pose in fit.state.poses]
    verdict = fit.verdict
    return Wavefront(
        range_mm=observation.range_mm,
        measured_range_mm=observation.measured_range_mm,
        channel=observation.channel,
        wavelength_nm=round(optics.wavelength_um * 1e3, 6),
        reference_wavelength_nm=round(optics.reference_um * 1e3, 6),
        spectrum=optics.light.physical,
        f_number=fit.f_number,
        f_number_std=float(np.sqrt(fit.measured.covariance[-2, -2])) * fit.f_number,
        noll=fit.noll,
        waves=fit.waves,
        covariance=fit.covariance,
        poses=np.array([pose.v for pose in fit.state.poses]),
        gain=float(fit.state.gain),
        read_noise=float(fit.state.read_noise),
        chi2_per_pixel=float(fit.chi2_per_pixel),
        test=OptimumTest(
            verdict.name,
            bool(verdict.accepted),
            float(verdict.p_value),
            fit.starts,
            tuple(verdict.undetermined),
            tuple(OtherOptimum(other.waves, other.below) for other in fit.others),
            bool(verdict.accepted),
        ),
        residual_spectrum=ResidualSpectrum(
            residual_frequencies(observation.frames), fit.left, None if unaided is None else unaided.fit.left
        ),
        seconds=fit.seconds,
        frames=observation.names,
        placement=Placement(observation.origin_px, observation.shape, np.array([pose.corners_px() for pose in poses])),
        residuals=_residuals(local),
    )


def _residuals(local: LocalFit) -> Residuals:
    """Counts, model and noise of each Bayer plane of each frame; nan where a pixel was not used."""
    observation = local.task.observation
    planes = []
    for frame, (mean, std) in zip(observation.frames, residuals(local.fit, observation.frames), strict=True):
        images = np.full((3, *frame.counts.shape), np.nan)
        images[:, frame.used] = frame.counts[frame.used], mean, std
        every = observation.period
        planes.append([images[:, row::every, column::every] for row, column in observation.places])
    data, model, sigma = np.moveaxis(np.array(planes), 2, 0)
    return Residuals(data, model, sigma)
