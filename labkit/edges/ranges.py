"""Defocus of an edge to its range, through the lens's law (thesis (4.40) corrected, §5.2.5), the side of best focus chosen.

Defocus is nearly linear in 1 / range, so that ranges are solved for there; beyond infinity nothing lies, which may tell
the sides apart. Colours have best foci of their own: they agree on a range on a single side only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labkit.optics.lens import Convention, ThinLens, defocus_waves
from labkit.types import Floats
from labkit.uncertain import Uncertain

AS_LIKELY = 20.0  # of twice a log-likelihood: a side that is less likely by more is none
SAME_RANGE = 1.0  # standard errors: ranges nearer to each other are one
FARTHEST_RANGE_MM = 1e9
NEAREST_RANGE = 1.02  # focal lengths
NEWTON_STEPS = 9  # of Newton, in 1 / range
RANGE_STEP = 1e-5  # relative to a range, of differences
NOT_SHARED = 1e-3  # share of a variance that colours do not have in common, whatever a correlation says
LARGEST_STEP = 1e-3  # relative, of a law's numbers in differences
UNKNOWN_RANGE = Uncertain(np.nan, np.nan, "mm")
ZERO, FOCI = 3, 4
"""Of a law's numbers: logarithms of focal length, f-number and pupil magnification; the scale's zero; the best foci."""


@dataclass(frozen=True)
class FocusLaw:
    """A focused lens: defocus as a function of range.

    Attributes
    ----------
    lens : focal length, f-number, pupils
    channels : names of the colours
    focus_mm : (channels,) best focus of each, on a scale of ranges
    covariance : (4 + channels, same) of the logarithms of focal length, f-number and pupil magnification, of the scale's zero,
        and of the best foci, mm
    reference_nm, convention : see `defocus_waves`
    zero_mm : what is to be added to that scale for ranges from the front principal plane

    Raises
    ------
    ValueError : contradictory sizes
    """

    lens: ThinLens
    channels: tuple[str, ...]
    focus_mm: Floats
    covariance: Floats
    reference_nm: float
    convention: Convention = "corrected"
    zero_mm: float = 0.0

    def __post_init__(self) -> None:
        size = FOCI + len(self.channels)
        shapes = (self.focus_mm.shape, self.covariance.shape)
        if shapes != ((len(self.channels),), (size, size)):
            raise ValueError(
                f"{len(self.channels)} channels need as many best foci and a covariance {(size, size)}"
            )

    def of(self, channels: Sequence[str]) -> FocusLaw:
        """Return the law of some colours."""
        at = np.array([self.channels.index(name) for name in channels])
        every = np.r_[:FOCI, FOCI + at]
        covariance = self.covariance[np.ix_(every, every)]
        focus_mm = self.focus_mm[at]
        return replace(
            self, channels=tuple(channels), focus_mm=focus_mm, covariance=covariance
        )

    def defocus(self, range_mm: float) -> Floats:
        """Return the defocus (channels,) of a range, waves RMS at the reference: positive beyond best focus."""
        target_mm = range_mm + self.zero_mm
        focus_mm = self.focus_mm + self.zero_mm
        return defocus_waves(
            self.lens, target_mm, focus_mm, self.reference_nm, self.convention
        )

    def slope(self, range_mm: float) -> Floats:
        """Return the derivative (channels,) of defocus by range, waves per mm."""
        step = RANGE_STEP * range_mm
        change = self.defocus(range_mm + step) - self.defocus(range_mm - step)
        return np.asarray(change / (2 * step))

    def range_mm(self, defocus: Floats, weight: Floats) -> float:
        """Return the range of defoci (channels,) by least squares; infinite beyond infinity.

        weight : (channels, channels)
        """
        farthest = 1 / FARTHEST_RANGE_MM
        nearest = 1 / (NEAREST_RANGE * self.lens.focal_length_mm)
        inverse = float(np.mean(1 / self.focus_mm))
        for _ in range(NEWTON_STEPS):
            left = defocus - self.defocus(1 / inverse)
            slope = -self.slope(1 / inverse) / inverse**2
            inverse += float(slope @ weight @ left / (slope @ weight @ slope))
            inverse = min(max(inverse, farthest), nearest)
        return 1 / inverse if inverse > 2 * farthest else np.inf

    def varied(self, step: Floats) -> FocusLaw:
        """Return the law after a step in the numbers of its covariance."""
        f, n, pupils = np.exp(step[:ZERO])
        old = self.lens
        lens = ThinLens(
            old.focal_length_mm * f, old.f_number * n, old.pupil_magnification * pupils
        )
        zero_mm = self.zero_mm + float(step[ZERO])
        focus_mm = self.focus_mm + step[FOCI:]
        return replace(self, lens=lens, focus_mm=focus_mm, zero_mm=zero_mm)

    def ranged(self, defocus: Floats, weight: Floats) -> Uncertain:
        """Return `range_mm` with the error by the errors of defocus and of the law, by differences.

        An edge measures the width of its blur, 8 N times the path: another f-number means
        another defocus.
        """
        value = self.range_mm(defocus, weight)
        if not np.isfinite(value):
            return Uncertain(value, np.inf, "mm")
        std = np.sqrt(np.diag(self.covariance))
        most = np.where(np.arange(std.size) < ZERO, LARGEST_STEP, LARGEST_STEP * value)
        slopes = np.zeros(std.size)
        for k in np.flatnonzero(std):
            step = np.zeros(std.size)
            step[k] = min(std[k], most[k])
            after, before = (
                law.range_mm(defocus * self.lens.f_number / law.lens.f_number, weight)
                for law in (self.varied(step), self.varied(-step))
            )
            if not np.isfinite(after - before):
                return Uncertain(value, np.inf, "mm")
            slopes[k] = (after - before) / (2 * step[k])
        slope = self.slope(value)
        variance = 1 / (slope @ weight @ slope) + slopes @ self.covariance @ slopes
        return Uncertain(value, float(np.sqrt(variance)), "mm")


@dataclass(frozen=True)
class Side:
    """One end of a fit: defocus and its standard error, waves RMS at the reference, and the log-likelihood there."""

    defocus: float
    std: float
    log_likelihood: float = 0.0


@dataclass(frozen=True)
class EdgeRange:
    """range_mm: the likeliest; other: the range on the other side of best focus, where not excluded by the data."""

    range_mm: Uncertain = UNKNOWN_RANGE
    other: Uncertain | None = None


def edge_range(
    law: FocusLaw,
    sides: Sequence[tuple[str, Sequence[Side]]],
    correlation: Floats | None = None,
) -> EdgeRange:
    """Return the range of an edge from its defocus in any number of colours.

    Parameters
    ----------
    law : of the lens
    sides : name of each colour and the sides of best focus that it may be on
    correlation : (colours, colours) of the errors of defocus, for a common wavefront; None for separate fits

    Returns
    -------
    the range, nan if no side has one (beyond infinity)

    Raises
    ------
    ValueError : no colour
    """
    if not sides or not all(ends for _, ends in sides):
        raise ValueError("one colour or more, each with one side or more, are needed")
    law = law.of([name for name, _ in sides])
    shared = np.eye(len(sides)) if correlation is None else correlation
    found = []
    for chosen in product(*(ends for _, ends in sides)):
        std = np.array([end.std for end in chosen])
        defocus = np.array([end.defocus for end in chosen])
        # on the other side errors are reversed with the defocus
        signed = std * np.sign(defocus)
        covariance = shared * np.outer(signed, signed) + NOT_SHARED * np.diag(std**2)
        weight = np.asarray(np.linalg.inv(covariance), np.float64)
        ranged = law.ranged(defocus, weight)
        if np.isfinite(ranged.value):
            left = defocus - law.defocus(ranged.value)
            likelihood = sum(end.log_likelihood for end in chosen)
            found.append((float(left @ weight @ left) - 2 * likelihood, ranged))
    if not found:
        return EdgeRange(Uncertain(np.nan, np.inf, "mm"))
    least = min(cost for cost, _ in found)
    # of equal ones the fit's own
    found.sort(key=lambda of: round(of[0] - least, 3))
    (_, likeliest), *others = found
    for cost, other in others:
        apart = abs(1 / other.value - 1 / likeliest.value)
        together = np.hypot(other.std / other.value**2, likeliest.std / likeliest.value**2)
        if cost - least < AS_LIKELY and apart > SAME_RANGE * together:
            return EdgeRange(likeliest, other)
    return EdgeRange(likeliest)


def symmetric_error(defocus: float, std: float) -> float:
    """Return the standard error of a defocus of which only the square is determined, as without other even modes.

    The likelihood is then exp(-(x^2 - d^2)^2 / (2 s^2)), s = 2 |d| std; its own width about zero is the root of s.
    """
    return float(min(std, np.sqrt(2 * abs(defocus) * std))) if np.isfinite(std) else std
