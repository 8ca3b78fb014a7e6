"""A session's fits and its lens, as results keep them: wavefronts, best focus, the lens, and where the errors come from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labkit.analysis.lens_fit import LEAST_MAGNIFICATION, MOST_MAGNIFICATION, LensFit
from labkit.analysis.lens_model import GEOMETRY
from labkit.analysis.local_fits import LocalFit
from labkit.analysis.model_error import confirmed, shift
from labkit.analysis.session_fits import SessionFits
from labkit.finding import Finding
from labkit.findings import found
from labkit.imaging.model import SPECTRUM_WIDTH
from labkit.inference.bias import covariance_with_bias, error_with_bias
from labkit.inference.fit import residuals
from labkit.inference.residual_spectrum import residual_frequencies
from labkit.key import Key
from labkit.optics.spectrum import Spectrum
from labkit.optics.wavefront import DEFOCUS
from labkit.results import Focus, Lens, OptimumTest, OtherOptimum, Placement, Residuals, ResidualSpectrum, Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

TELLING_STD = 0.1  # pupil magnifications of real lenses lie between 0.5 and 2: with a larger error little was learnt
FOCAL_LENGTH, F_NUMBER, MAGNIFICATION, TAPE = GEOMETRY[:4]


def as_wavefronts(session: SessionFits) -> tuple[Wavefront, ...]:
    """Of every fit. Those that belong to a lens are as the whole session has them."""
    wavefronts = [_leaning(session, k) for k in range(len(session.fits))]
    for place, index in enumerate(session.members):
        assert session.lens is not None
        values, covariance = session.lens.posterior(place)
        wavefronts[index] = _with(wavefronts[index], session.fits[index].fit.measured.parts, values, covariance)
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


def _with(w: Wavefront, parts: tuple[str, ...], values: Floats, covariance: Floats) -> Wavefront:
    """A wavefront with a session's values for it, as of `Measured`."""
    modes = len(w.noll)
    if SPECTRUM_WIDTH in parts:
        w = replace(w, spectrum=Spectrum.of_width(float(values[modes + parts.index(SPECTRUM_WIDTH)])).fixed)
    f_number, waves = float(np.exp(values[-2])), values[:modes]
    blur = None
    if 4 in w.noll:
        um = 8 * f_number * np.sqrt(12) * w.reference_wavelength_nm * 1e-3
        pull = np.zeros(len(values))
        pull[[w.noll.index(4), -2]] = um, um * waves[w.noll.index(4)]
        blur = Uncertain(um * waves[w.noll.index(4)], float(np.sqrt(pull @ covariance @ pull)), "um")
    return replace(
        w,
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


def session_findings(session: SessionFits) -> list[Finding]:
    """What the search and the session's lens have to report."""
    lens = session.lens
    findings = _search_findings(session)
    if lens is None:
        return [*findings, found("no-best-focus", why=_why_no_lens(session))]
    findings += [found("defocus-sign-open", Key(None, channel)) for channel in session.open_channels]
    return [*findings, *_lens_findings(lens)]


def _search_findings(session: SessionFits) -> list[Finding]:
    """Fits that ended early, were mended, or contradict the others."""
    keys = [local.task.observation.key for local in session.fits]
    findings = [
        found("search-cut-short", key, patience_s=local.task.patience_s, starts=local.fit.starts)
        for k, (key, local) in enumerate(zip(keys, session.fits, strict=True))
        if local.fit.cut_short and k not in session.members
    ]
    findings += [found("fit-mended", keys[k]) for k in session.mended]
    findings += [found("fit-does-not-belong", keys[k]) for k in session.strangers]
    return findings


def _why_no_lens(session: SessionFits) -> str:
    if any(local.ranged for local in session.fits):
        return "every fit was rejected"
    if any(DEFOCUS in local.fit.noll for local in session.fits):
        return "the frames carry no ranges"
    return "defocus was not fitted"


def _lens_findings(lens: LensFit) -> Iterator[Finding]:
    pupils = _magnification(lens)
    for channel in lens.model.channels:
        if len({m.stop for m in lens.model.members if m.channel == channel}) < 2:
            yield found("channel-without-best-focus", Key(None, channel))
    if not LEAST_MAGNIFICATION * 1.001 < pupils.value < MOST_MAGNIFICATION / 1.001:
        yield found("pupil-magnification-at-bound", least=LEAST_MAGNIFICATION, most=MOST_MAGNIFICATION)
    elif pupils.std > TELLING_STD:
        yield found("pupil-magnification-undetermined", pupil_magnification_std=pupils.std)
    if not lens.model.paraxial:
        yield found("cones-contradict-one-lens", cone_relative_error=float(np.expm1(lens.value("cone"))))
    if not lens.model.shared:
        yield found("modes-differ-between-ranges")
    if lens.widening > 1:
        yield found("errors-widened", factor=lens.widening, chi2_per_freedom=lens.typical)


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
        spectrum=optics.spectrum.fixed,
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
