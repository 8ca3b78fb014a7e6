"""Best focus over the field: of each place by the defocus of its photographs, and the surface through all places.

Focus errors of the sensor are in µm, positive where the sensor lies behind the image, farther from the lens. The surface
is offset + tilt · (y, x) + curvature · (y² + x²), of the medial focus and of the S and T foci.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.stats import chi2

from labkit.charts.patterns import Cell
from labkit.charts.place_fit import ASTIGMATIC, PlaceFit
from labkit.edges.ranges import symmetric_error
from labkit.optics.lens import blur_per_wave_um
from labkit.types import Floats
from labkit.uncertain import Uncertain

LAW_STD = 0.05
"""Relative, of the slope of a lens's law: twice what an engraved f-number and focal length leave."""

FOCUS_KINDS = ("medial", "S", "T")
UNKNOWN_WAVES = 0.1  # RMS, of astigmatism along the radius: half its prior, the edges do not determine it
MOST_CONDITION = 1e3  # of the places: one line determines no surface
NUMBERS = ("offset_um", "tilt_rows_um_per_mm", "tilt_columns_um_per_mm", "curvature_per_mm")
"""Numbers of a surface; the last in mm for each mm²."""


@dataclass(frozen=True)
class PlaceFocus:
    """Best focus at a place in one channel.

    Attributes
    ----------
    cell : the place in the grid
    height_mm : (y, x) from the frame's centre
    um : medial, S and T, focus errors of the sensor; S and T nan where edges do not determine them
    covariance : (3, 3)
    sign_open : whether the reverse of all three is as likely
    chi2, freedom : of the photographs' defoci against the lens's law
    """

    cell: Cell
    height_mm: Floats
    um: Floats
    covariance: Floats
    sign_open: bool
    chi2: float = 0.0
    freedom: int = 0

    def of(self, kind: str) -> Uncertain:
        """Return the focus error of "medial", "S" or "T"."""
        k = FOCUS_KINDS.index(kind)
        return Uncertain(
            self.um[k], np.sqrt(self.covariance[k, k]), "um", sign_open=self.sign_open
        )

    @property
    def t_minus_s(self) -> Uncertain:
        """Astigmatism along the radius, µm."""
        row = np.array([0, -1, 1])
        std = np.sqrt(row @ self.covariance @ row)
        return Uncertain(self.um[2] - self.um[1], std, "um", sign_open=self.sign_open)

    @property
    def row(self) -> list[str]:
        """Cells of the table."""
        numbers = [*(self.of(kind) for kind in FOCUS_KINDS), self.t_minus_s]
        return [
            ",".join(map(str, self.cell)),
            *(f"{mm:.2f}" for mm in self.height_mm),
            *(str(of) if np.isfinite(of.value) else "-" for of in numbers),
        ]

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "focus"."""
        return {
            "cell": list(self.cell),
            "y_mm": self.height_mm[0],
            "x_mm": self.height_mm[1],
            **{f"{kind}_um": self.of(kind) for kind in FOCUS_KINDS},
            "T_minus_S_um": self.t_minus_s,
            "sign_open": self.sign_open,
            "chi2": self.chi2,
            "freedom": self.freedom,
        }


@dataclass(frozen=True)
class FocalSurface:
    """A plane with a curvature.

    Attributes
    ----------
    numbers : (4,) see NUMBERS
    covariance : (4, 4)
    places : number of places
    chi2_per_freedom : of the places about the surface; errors are enlarged by its root above 1
    """

    numbers: Floats
    covariance: Floats
    places: int
    chi2_per_freedom: float

    HEADING: ClassVar = (
        "offset, µm",
        "tilt along rows' axis (down), µm/mm",
        "tilt along columns' axis (right), µm/mm",
        "curvature, mm/mm²",
        "places",
        "chi2/freedom",
    )

    def number(self, name: str) -> Uncertain:
        """Return a number with its error."""
        k = NUMBERS.index(name)
        return Uncertain(self.numbers[k], np.sqrt(self.covariance[k, k]))

    def at(self, places_mm: Floats) -> tuple[Floats, Floats]:
        """Return focus errors (n,), µm, and their errors, at places (n, 2) as (y, x)."""
        rows = _rows(places_mm)
        return rows @ self.numbers, np.sqrt(
            np.einsum("ki,ij,kj->k", rows, self.covariance, rows)
        )

    @property
    def cells(self) -> list[str]:
        """Cells of the table."""
        numbers = [str(self.number(name)) for name in NUMBERS]
        return [*numbers, str(self.places), f"{self.chi2_per_freedom:.2f}"]

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "focal_surfaces"."""
        return {
            **{name: self.number(name) for name in NUMBERS},
            "places": self.places,
            "chi2_per_freedom": self.chi2_per_freedom,
        }


def um_per_wave(fit: PlaceFit) -> float:
    """Return the shift of focus, µm, that changes Noll 4 by a wave RMS, see `FieldModel.um_per_wave`."""
    n = fit.optics.f_number
    return n * blur_per_wave_um(n, fit.optics.reference_um)


def place_focus(fit: PlaceFit, height_mm: Floats) -> PlaceFocus:
    """Return best focus at a place, by least squares of its photographs' defoci about the lens's law.

    height_mm : (y, x) of the place, whose direction is that of the radius
    """
    depths = len(fit.photographs)
    known = bool(np.ptp(fit.law_waves)) if depths else False
    modes = fit.waves.size - depths
    design = np.zeros((fit.waves.size + 1, 2 + modes))
    design[:depths, 0] = 1
    design[:depths, 1] = fit.law_waves
    design[depths:-1, 2:] = np.eye(modes)
    design[-1, 1] = 1  # the slope of the law, beforehand
    weight = np.zeros((fit.waves.size + 1,) * 2)
    weight[:-1, :-1] = np.linalg.inv(fit.covariance)
    weight[-1, -1] = LAW_STD**-2
    data = np.append(fit.waves, 1.0)
    covariance = np.linalg.inv(design.T @ weight @ design)
    numbers = covariance @ design.T @ weight @ data
    left = data - design @ numbers
    rows = _foci(fit, height_mm, modes)
    um = um_per_wave(fit)
    rows_um = um * rows
    error = rows_um @ covariance @ rows_um.T
    if not known:
        error[0, 0] = (um * symmetric_error(numbers[0], np.sqrt(covariance[0, 0]))) ** 2
    apart = rows[2] - rows[0]
    unknown = np.sqrt(apart @ covariance @ apart) > UNKNOWN_WAVES
    value = rows_um @ numbers
    value[1:] = np.nan if unknown else value[1:]
    freedom = max(depths - 1, 0) if known else 0
    misfit = float(left @ weight @ left)
    return PlaceFocus(fit.cell, height_mm, value, error, not known, misfit, freedom)


def law_misfit(foci: Sequence[PlaceFocus]) -> tuple[float, float]:
    """Return the root of chi-squared per degree of freedom of all defoci about the lens's law, and its probability."""
    freedom = sum(of.freedom for of in foci)
    if not freedom:
        return 1.0, 1.0
    total = sum(of.chi2 for of in foci)
    return float(np.sqrt(total / freedom)), float(chi2.sf(total, freedom))


def enlarged(foci: Sequence[PlaceFocus]) -> tuple[PlaceFocus, ...]:
    """Return foci with errors enlarged by the scatter of defoci about the lens's law."""
    factor, _ = law_misfit(foci)
    share = max(factor, 1.0) ** 2
    return tuple(replace(of, covariance=share * of.covariance) for of in foci)


def _foci(fit: PlaceFit, height_mm: Floats, modes: int) -> Floats:
    """Return medial, S and T focus (3, numbers) as combinations of the offset, the slope, and the modes, waves."""
    rows = np.zeros((len(FOCUS_KINDS), 2 + modes))
    rows[:, 0] = 1
    azimuth = 2 * np.arctan2(*height_mm)
    for mode, share in zip(ASTIGMATIC, (np.sin(azimuth), np.cos(azimuth)), strict=True):
        if mode in fit.optics.noll:
            at = 1 + fit.optics.noll.index(mode)
            rows[1:, at] = np.array([-1, 1]) * share * np.sqrt(0.5)
    return rows


def focal_surface(
    foci: Sequence[PlaceFocus], kind: str, f_number: Uncertain
) -> FocalSurface | None:
    """Return the surface through the foci of a kind; None for too few places, or places on one line.

    f_number : its relative error is also the relative error of all lengths in µm
    """
    k = FOCUS_KINDS.index(kind)
    used = [of for of in foci if np.isfinite(of.um[k])]
    if len(used) <= len(NUMBERS):
        return None
    place = np.array([of.height_mm for of in used])
    rows = _rows(place)
    value = np.array([of.um[k] for of in used])
    std = np.array([of.of(kind).std for of in used])
    most = np.hypot(*place.T).max()
    if np.linalg.cond(rows / [1, most, most, 1e3 * most**2]) > MOST_CONDITION:
        return None
    weighed = rows / std[:, None]
    covariance = np.linalg.inv(weighed.T @ weighed)
    numbers = covariance @ weighed.T @ (value / std)
    scatter = float(np.mean(((value - rows @ numbers) / std) ** 2))
    scatter *= len(used) / (len(used) - len(NUMBERS))
    scale = (f_number.std / f_number.value) ** 2
    covariance = covariance * max(scatter, 1.0) + scale * np.outer(numbers, numbers)
    return FocalSurface(numbers, covariance, len(used), scatter)


def _rows(places_mm: Floats) -> Floats:
    """Return the surface at places (n, 2) as combinations (n, 4) of its numbers."""
    square = 1e3 * (places_mm**2).sum(axis=1)
    return np.column_stack([np.ones(len(places_mm)), places_mm, square])
