"""Convert an estimate of tiles to the wavefront over the field."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from labkit.analysis.session_results import as_lens, wavelengths_nm
from labkit.estimation.estimate import Estimate
from labkit.estimation.field_terms import in_the_middle
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    COMMON_MODE,
    FIELD_COLOUR,
    FIELD_MODE,
    MODE,
    RANGE_ZERO,
)
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.lens_model import LensModel
from labkit.imaging.parts import UnevenField, Vignetted, rim_of
from labkit.optics.field import FieldFrame, FieldModel, field_terms
from labkit.optics.lens import defocus_waves
from labkit.optics.rim import FieldRim
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan
from labkit.types import Floats

LONGITUDINAL_STEP = 1e-4
"""Step of best focus, relative, for the derivative of defocus by longitudinal colour."""


def as_field(session: Estimate, plan: Plan) -> FieldModel | None:
    """Return the wavefront over the field; None for sessions without tiles, or without a lens."""
    lens = session.lens
    if lens is None or not lens.model.field_order:
        return None
    model, observation = lens.model, session.fits[0].observation
    field = field_terms(model.field_order)
    shape = len(model.channels), len(field), len(model.noll)
    common = np.array([row for c in model.channels for row in _common(lens, c)])
    own = np.array([_own(model, k, j) for k in field for j in model.noll])
    blocks = range(len(model.channels))
    waves = np.ravel([own @ lens.solved.point.own[block] for block in blocks])
    cone, cone_std = _cone(lens)
    light = wavelengths_nm(lens, plan)
    return FieldModel(
        FieldFrame(observation.photograph_px, plan.sensor.pixel_pitch_um),
        model.channels,
        field,
        model.noll,
        (common @ lens.theta + waves).reshape(shape),
        _covariance(lens, common, own),
        tuple(light[channel].value for channel in model.channels),
        plan.reference_wavelength_nm,
        cone,
        cone_std,
        tuple(lens.scale_std(_innermost(lens, channel)) for channel in model.channels),
        _rim(session, lens),
    )


def _common(lens: LensFit, channel: str) -> Iterator[Floats]:
    """Yield the coefficients of a channel's terms as linear combinations (columns,) of the session's parameters."""
    model = lens.model
    _, *rest = field_terms(model.field_order)
    for j in model.noll:
        if j != DEFOCUS:
            yield model.column(COMMON_MODE, j) + model.column(MODE, channel, j)
        else:
            middle = [in_the_middle(k) * model.column(FIELD_MODE, k, j) for k in rest]
            focus = -np.sum(middle, axis=0)
            if channel != model.reference:
                focus += _colour_slope(lens, channel) * model.column(AXIAL_COLOUR, channel)
            yield focus
    for k in rest:
        for j in model.noll:
            yield model.column(FIELD_MODE, k, j)


def _own(model: LensModel, k: int, j: int) -> Floats:
    """Return a channel's own part (local columns,) of the coefficient of a term."""
    names = [(column.kind, column.name) for column in model.local_columns]
    row = np.array([name == (FIELD_COLOUR, (k, j)) for name in names], float)
    if (k, j) == (1, DEFOCUS):
        for at, (_, (field, pupil)) in enumerate(names):
            row[at] = -in_the_middle(int(field)) * (pupil == DEFOCUS)
    return row


def _covariance(lens: LensFit, common: Floats, own: Floats) -> Floats:
    """Return the covariance of all coefficients, in the order of the channels.

    Parameters
    ----------
    common : (coefficients, columns)
    own : (coefficients of a channel, local columns)
    """
    normal = lens.solved.normal
    channels = len(lens.model.channels)
    followed = common - np.concatenate(
        [own @ normal.eliminated[block] for block in range(channels)]
    )
    covariance = followed @ normal.covariance @ followed.T
    for block in range(channels):
        at = slice(block * len(own), (block + 1) * len(own))
        covariance[at, at] += own @ normal.own_covariance[block] @ own.T
    return np.asarray(lens.birge_ratio**2 * covariance)


def _colour_slope(lens: LensFit, channel: str) -> float:
    """Return defocus of a channel at the reference's best focus over the difference of their best foci, waves RMS per mm."""
    model, thin = lens.model, as_lens(lens).thin
    zero_mm = lens.value(RANGE_ZERO)
    reference_mm = float(model.best_focus(model.reference) @ lens.theta) + zero_mm
    step_mm = LONGITUDINAL_STEP * reference_mm

    def defocus(focus_mm: float) -> float:
        colour = thin.in_colour(focus_mm, reference_mm)
        waves = defocus_waves(
            colour,
            reference_mm,
            focus_mm,
            model.stated.reference_nm,
            model.stated.convention,
        )
        return float(waves)

    focus_mm = float(model.best_focus(channel) @ lens.theta) + zero_mm
    if abs(focus_mm - reference_mm) > step_mm:
        return defocus(focus_mm) / (focus_mm - reference_mm)
    return defocus(reference_mm + step_mm) / step_mm


def _cone(lens: LensFit) -> tuple[float, float]:
    """Return the working f-number next to the middle of the frame, and its standard error."""
    values, covariance = lens.posterior(_innermost(lens))
    cone = float(np.exp(values[-2]))
    return cone, cone * float(np.sqrt(covariance[-2, -2]))


def _rim(session: Estimate, lens: LensFit) -> FieldRim:
    """Return the pupil's rim over the frame, by the numbers of the whole session."""
    k = session.members[0]
    values, _ = lens.posterior(session.row(k))
    optics = session.fits[k].optics
    parts = optics.with_named(lens.model.parts, values[len(lens.model.noll) : -1]).parts
    over_frame = (*parts, *optics.given)
    cut = [part.vignetting for part in over_frame if isinstance(part, Vignetted)]
    uneven = [part.values for part in over_frame if isinstance(part, UnevenField)]
    same = [p for p in over_frame if not isinstance(p, Vignetted | UnevenField)]
    second, third = uneven[0] if uneven else (0.0, 0.0)
    return FieldRim(rim_of(same), cut[0] if cut else None, (second, third))


def _innermost(lens: LensFit, channel: str | None = None) -> int:
    """Return the observation next to the middle of the frame, of a channel if one is given."""
    readings = lens.model.readings
    among = [k for k, r in enumerate(readings) if channel in (None, r.key.channel)]
    return min(among, key=lambda k: np.hypot(*readings[k].place))
