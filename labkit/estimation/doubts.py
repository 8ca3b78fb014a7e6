"""Doubts about an estimate, for which its errors allow: camera parts absent from the model, and open signs.

A sandwich covariance describes how residuals that are not noise scatter an estimate, but not a bias common to all fits. The
bias follows from the same fits with the missing part, and open signs from the lens with twins in place of the fits. Estimates
are not corrected; their standard errors include the differences.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Measured, value_signs
from labkit.estimation.estimate import Estimate
from labkit.estimation.left_out import by_modes_left_out
from labkit.estimation.lens_fit import LensFit, fit_lens
from labkit.estimation.local import Optimum
from labkit.estimation.select import lens_of
from labkit.estimation.settings import SETTINGS
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats


def shift(optimum: Optimum, with_missing: Optimum) -> tuple[Floats, float]:
    """Return the change of a wavefront due to missing parts: (modes,) waves RMS, and ln of the ratio of working f-numbers.

    Of two twins the nearer counts.
    """
    near = with_missing.nearest_to(optimum)
    return near.waves - optimum.waves, float(
        np.log(near.optics.f_number / optimum.optics.f_number)
    )


def confirmed(session: Estimate, index: int) -> bool:
    """Return whether a fit is at the optimum that explains its frames once the missing parts are in the model."""
    optimum = session.fits[index].optimum
    complete = session.with_all_parts(index)
    if optimum is complete or not complete.verdict.accepted:
        return False
    modes, _ = shift(optimum, complete)
    others = np.array(optimum.noll) != DEFOCUS
    return float(np.linalg.norm(modes[others])) < SETTINGS.sure_waves


def with_model_error(session: Estimate) -> Estimate:
    """Include the bias due to missing parts, or else what modes left out may move, in the errors of the lens.

    The bias is the change of the lens to that of the same fits with the parts, under the same laws. A disagreement of the
    fits that the parts explain does not raise the Birge ratio.
    """
    lens = session.lens
    if lens is None:
        return session
    if not any(session.with_missing):
        moved = by_modes_left_out(session)
        return replace(session, lens=replace(lens, unknown=moved)) if moved else session
    measured = dict[int, Measured]()
    for k in session.members:
        complete = session.with_all_parts(k).nearest_to(session.fits[k].optimum)
        measured[session.row(k)] = complete.candidate.measured
    there = lens_of(measured, lens)
    values = {
        (c.kind, c.name): v for c, v in zip(there.model.columns, there.theta, strict=True)
    }
    theta = np.array(
        [values.get((c.kind, c.name), 0.0) for c in lens.model.columns]
    )  # a part that gave way is 0
    bias = Point(theta - lens.theta, there.solved.point.own - lens.solved.point.own)
    bias_chi2 = there.solved.chi2 - lens.solved.chi2
    return replace(session, lens=replace(lens, bias=bias, bias_chi2=bias_chi2))


def turned_lenses(session: Estimate) -> list[LensFit]:
    """Return the estimates of the lens that are hardly less likely, with twins in place of wavefronts of open sign."""
    lens = session.lens
    is_open = [k for k in session.members if k not in session.signed]
    if lens is None or not is_open:
        return []
    signs = value_signs(lens.model.noll, lens.model.parts)
    return list(with_turned(lens, [*map(session.row, is_open)], signs))


def with_turned(lens: LensFit, rows: Sequence[int], signs: Floats) -> Iterator[LensFit]:
    """Yield estimates with twins in place of observations, if they are hardly less likely.

    Parameters
    ----------
    lens : the estimate
    rows : observations of open sign; all turn together, or all of a station, or all of a channel
    signs : (values,) factors of the values in a twin
    """
    for turned in _together(lens, rows):
        values = lens.measured.values.copy()
        covariance = lens.measured.covariance.copy()
        values[turned] *= signs
        covariance[turned] *= np.outer(signs, signs)
        measured = replace(lens.measured, values=values, covariance=covariance)
        other = fit_lens(lens.model, measured)
        if other.chi2 < lens.chi2 + 2 * SETTINGS.clear_gain:
            yield other


def _together(lens: LensFit, rows: Sequence[int]) -> list[list[int]]:
    """Return groups of observations whose signs change together."""
    readings = lens.model.readings
    stations = {k: readings[k].station for k in rows}
    channels = {k: readings[k].key.channel for k in rows}
    groups = [list(rows)]
    for of in (stations, channels):
        groups += [[k for k in rows if of[k] == one] for one in dict.fromkeys(of.values())]
    return [group for k, group in enumerate(groups) if group not in groups[:k]]
