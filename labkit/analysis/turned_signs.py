"""Estimates of a session's lens with the other sign of wavefronts whose sign is open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.estimate import Estimate
from labkit.estimation.lens_fit import LensFit, fit_lens
from labkit.estimation.settings import SETTINGS
from labkit.types import Floats


def turned_lenses(session: Estimate) -> list[LensFit]:
    """Return the estimates of the lens that are hardly less likely, with twins in place of wavefronts of open sign."""
    lens = session.lens
    is_open = [k for k in session.members if k not in session.signed]
    if lens is None or not is_open:
        return []
    measured = session.fits[is_open[0]].optimum.measured.labelled(lens.model.parts)
    rows = [row for k in is_open if (row := session.rows[k]) is not None]
    return list(with_turned(lens, rows, measured.signs))


def with_turned(lens: LensFit, rows: Sequence[int], signs: Floats) -> Iterator[LensFit]:
    """Yield estimates with twins in place of observations, if they are hardly less likely.

    Parameters
    ----------
    lens : the estimate
    rows : observations of open sign; all turn together, or those of one station, or of one channel
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
