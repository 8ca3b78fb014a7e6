"""Numbers of the lens that two sessions of one lens have in common, with their joint covariance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labkit.estimation.estimate import Estimate
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    F_NUMBER,
    FOCAL_LENGTH,
    FOCUS,
    MAGNIFICATION,
    RANGE_ZERO,
    WAVELENGTH,
    WORKING_F_NUMBER,
)
from labkit.estimation.lens_fit import LensFit
from labkit.optics.known_bias import covariance_with_bias
from labkit.optics.wavefront import DEFOCUS
from labkit.results.model import (
    BEST_FOCUS_MM,
    COLOUR_UM,
    F_NUMBER_AT_INFINITY,
    FOCAL_LENGTH_MM,
    LN_MAGNIFICATION,
    MODE_WAVES,
    CommonNumbers,
    StatedNumber,
)
from labkit.types import Floats

KNOWN_BEFORE = (FOCAL_LENGTH, F_NUMBER, MAGNIFICATION, WORKING_F_NUMBER, WAVELENGTH)
"""Columns whose prior is of the lens or the camera, and thus the same in another session of both."""

COLOUR_STEP = 1e-5
"""Step of numerical derivatives, relative to best focus."""

Row = tuple[str, float, Floats]
"""Name, value and derivatives (columns,) of a number."""


def common_numbers(session: Estimate) -> CommonNumbers | None:
    """Return the lens's numbers with their joint covariance; None without a lens, and for tiles of a field.

    Raises
    ------
    ValueError
        the covariance is none
    """
    lens = session.lens
    if lens is None or lens.model.tiled:
        return None
    rows = [*_modes(lens), *_colours(lens), *_first_order(lens)]
    names, values, slopes = zip(*rows, strict=True)
    slopes = np.array(slopes)
    return CommonNumbers(
        names,
        np.array(values),
        _covariance(session, lens, names, np.array(values), slopes),
        dict(_stated(lens, slopes)),
    )


def _modes(lens: LensFit) -> Iterator[Row]:
    """Yield all modes but defocus, of each channel with members."""
    model, values = lens.model, lens.true_values
    slopes = model.true_slopes(model.seen(lens.solved.slopes))
    members = {
        model.readings[k].key.channel: k
        for k in np.flatnonzero(lens.measured.used)[::-1].tolist()
    }
    for channel in model.channels:
        if (k := members.get(channel)) is None:
            continue
        for place, j in enumerate(model.noll):
            if j != DEFOCUS:
                yield f"{MODE_WAVES}.{channel}.{j}", values[k, place], slopes[k, place]


def _colours(lens: LensFit) -> Iterator[Row]:
    """Yield how much longer each channel's focal length is than the leading one's, wherever the lens is focused."""
    model = lens.model
    for channel in model.channels:
        if channel != model.reference:
            at = [
                model.index(FOCAL_LENGTH),
                model.index(RANGE_ZERO),
                model.index(FOCUS),
                model.index(AXIAL_COLOUR, channel),
            ]
            slopes, steps = np.zeros(len(model.columns)), COLOUR_STEP * lens.theta[at[2]]
            for place, step in zip(at, steps * np.eye(len(at)), strict=True):
                here = lens.theta[at]
                apart = _longer_um(here + step) - _longer_um(here - step)
                slopes[place] = apart / (2 * steps)
            yield f"{COLOUR_UM}.{channel}", _longer_um(lens.theta[at]), slopes


def _longer_um(numbers: Floats) -> float:
    """Return how much longer a colour's focal length is, um, for focal length, range zero, best focus and its excess, mm."""
    focal_mm, zero_mm, focus_mm, further_mm = numbers
    near_mm = max(focus_mm + zero_mm, 1.01 * focal_mm)
    far_mm = max(near_mm + further_mm, 1.01 * focal_mm)
    return float(1e3 * (1 / (1 / focal_mm + 1 / far_mm - 1 / near_mm) - focal_mm))


def _first_order(lens: LensFit) -> Iterator[Row]:
    """Yield focal length, f-number, pupil magnification, and best focus of the leading channel."""
    model = lens.model
    for name, column in (
        (FOCAL_LENGTH_MM, FOCAL_LENGTH),
        (F_NUMBER_AT_INFINITY, F_NUMBER),
        (LN_MAGNIFICATION, MAGNIFICATION),
        (f"{BEST_FOCUS_MM}.{model.reference}", FOCUS),
    ):
        yield name, lens.value(column), model.column(column)


def _covariance(
    session: Estimate, lens: LensFit, names: tuple[str, ...], values: Floats, slopes: Floats
) -> Floats:
    """Return the joint covariance, with all errors that each wavefront has but the doubts about what the plan states.

    A mistake in the plan is no property of the lens; with one plan for both sessions both make the same.
    """
    covariance = replace(lens, others=()).errors_of(slopes)
    modes = np.array([name.startswith(MODE_WAVES) for name in names])
    if not lens.model.laws.paraxial:
        cone = lens.value(WORKING_F_NUMBER)
        covariance = covariance_with_bias(covariance, np.where(modes, -values * cone, 0.0))
    if session.incomplete:
        scatter = lens.model.laws.mode_scatter**2
        covariance = covariance + np.diag(np.where(modes, scatter, 0.0))
    return covariance


def _stated(lens: LensFit, slopes: Floats) -> Iterator[tuple[str, StatedNumber]]:
    """Yield the numbers known before, with the changes (n,) of the common numbers by one standard error of each.

    For a linear estimate with a prior of variance s² the estimate follows the prior's mean by C / s².
    """
    followed = slopes @ lens.solved.normal.covariance
    for k, column in enumerate(lens.model.columns):
        if column.kind in KNOWN_BEFORE and column.std > 0:
            moves = followed[:, k] / column.std
            name = ".".join([column.kind, *map(str, column.name)]).replace(" ", "_")
            yield name, StatedNumber(column.value, column.std, moves)
