"""Defocus of an edge to its range, through the lens's law (thesis (4.40) corrected, §5.2.5), the side of best focus chosen.

Defocus is nearly linear in 1 / range, so that ranges are solved for there; beyond infinity nothing lies, which may tell
the sides apart. Colours have best foci of their own: the range that all of them agree on is on one side only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import brentq

from labkit.optics.lens import Convention, ThinLens, defocus_waves
from labkit.types import Floats
from labkit.uncertain import Uncertain

AS_LIKELY = 20.0  # of twice a log-likelihood: a side that is less likely by more is none
SAME_RANGE = 1.0  # standard errors: ranges nearer to each other are one
FARTHEST_RANGE_MM = 1e9
NEWTON_STEPS = 6  # of Newton, in 1 / range
NOT_SHARED = 1e-3  # share of a variance that colours do not have in common, whatever a correlation says
NEAREST_RANGE = 1.02  # focal lengths
ZERO, FOCI = 3, 4
"""Of a law's numbers: logarithms of focal length, f-number and pupil magnification; the scale's zero; the best foci."""


@dataclass(frozen=True)
class FocusLaw:
    """A lens as it stands focused: ``channels``, and focus_mm of each, its best focus, on a scale of ranges.

    zero_mm: what is to be added to that scale for ranges from the front principal plane. covariance: (4 + channels, same)
    of the logarithms of focal length, f-number and pupil magnification, of the zero, and of the best foci, mm.
    """

    lens: ThinLens
    channels: tuple[str, ...]
    focus_mm: tuple[float, ...]
    covariance: Floats
    reference_nm: float
    convention: Convention = "corrected"
    zero_mm: float = 0.0

    def __post_init__(self) -> None:
        size = FOCI + len(self.channels)
        if len(self.focus_mm) != len(self.channels) or self.covariance.shape != (
            size,
            size,
        ):
            raise ValueError(
                f"{len(self.channels)} channels need as many best foci and a covariance {(size, size)}"
            )

    def defocus(self, channel: str, range_mm: float) -> float:
        """Return the defocus of a range, waves RMS at the reference: positive beyond best focus."""
        focus, zero = self.focus_mm[self.channels.index(channel)], self.zero_mm
        return float(
            defocus_waves(
                self.lens, range_mm + zero, focus + zero, self.reference_nm, self.convention
            )
        )

    def slope(self, channel: str, range_mm: float) -> float:
        """Return the derivative of defocus by range, waves per mm."""
        step = 1e-5 * range_mm
        return (
            self.defocus(channel, range_mm + step) - self.defocus(channel, range_mm - step)
        ) / (2 * step)

    def range_mm(self, channel: str, defocus: float) -> float:
        """Return the range of a defocus, waves RMS; infinite beyond the defocus of infinity."""
        near, far = (
            max(NEAREST_RANGE * self.lens.focal_length_mm - self.zero_mm, 1.0),
            FARTHEST_RANGE_MM,
        )
        if defocus >= self.defocus(channel, far):
            return np.inf
        if defocus <= self.defocus(channel, near):
            return near
        inverse = brentq(
            lambda v: self.defocus(channel, 1 / v) - defocus, 1 / far, 1 / near, xtol=1e-15
        )
        return float(1 / inverse)

    def varied(self, step: Floats) -> "FocusLaw":
        """Return the law after a step in the numbers of its covariance."""
        f, n, pupils = np.exp(step[:ZERO])
        old = self.lens
        lens = ThinLens(
            old.focal_length_mm * f, old.f_number * n, old.pupil_magnification * pupils
        )
        foci = tuple(float(mm) for mm in np.add(self.focus_mm, step[FOCI:]))
        return replace(
            self, lens=lens, focus_mm=foci, zero_mm=self.zero_mm + float(step[ZERO])
        )


@dataclass(frozen=True)
class Side:
    """One end of a fit: defocus and its standard error, waves RMS at the reference, and the log-likelihood there."""

    defocus: float
    std: float
    log_likelihood: float = 0.0


@dataclass(frozen=True)
class EdgeRange:
    """range_mm: the likeliest; other: the one on the other side of best focus, where the data do not exclude it."""

    range_mm: Uncertain
    other: Uncertain | None


def edge_range(
    law: FocusLaw,
    sides: Sequence[tuple[str, Sequence[Side]]],
    correlation: Floats | None = None,
) -> EdgeRange:
    """Return the range of an edge from its defocus in one colour or several.

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
    names = [name for name, _ in sides]
    correlation = np.eye(len(sides)) if correlation is None else correlation
    best = [max(end.log_likelihood for end in ends) for _, ends in sides]
    found = []
    for chosen in product(*(ends for _, ends in sides)):
        std = np.array([end.std for end in chosen])
        defocus = np.array([end.defocus for end in chosen])
        # on the other side errors are reversed with the defocus
        signed = std * np.sign(defocus)
        shared = correlation * np.outer(signed, signed) + NOT_SHARED * np.diag(std**2)
        weight = np.asarray(np.linalg.inv(shared), np.float64)
        value = _common_range(law, names, defocus, weight)
        if not np.isfinite(value):
            continue
        left = defocus - [law.defocus(name, value) for name in names]
        lost = sum(top - end.log_likelihood for top, end in zip(best, chosen, strict=True))
        error = _error(law, names, defocus, weight, value)
        cost = float(left @ weight @ left) + 2 * lost
        found.append((cost, Uncertain(value, error, "mm")))
    if not found:
        return EdgeRange(Uncertain(np.nan, np.inf, "mm"), None)
    found.sort(key=lambda of: round(of[0], 3))  # of equal ones the fit's own
    cost, likeliest = found[0]
    for more, other in found[1:]:
        apart = abs(1 / other.value - 1 / likeliest.value)
        together = np.hypot(other.std / other.value**2, likeliest.std / likeliest.value**2)
        if more - cost < AS_LIKELY and apart > SAME_RANGE * together:
            return EdgeRange(likeliest, other)
    return EdgeRange(likeliest, None)


def _common_range(
    law: FocusLaw, names: Sequence[str], defocus: Floats, weight: Floats
) -> float:
    """Return the range by least squares in 1 / range, where the law is nearly straight; infinite if no colour
    has a range.
    """
    own = [
        min(law.range_mm(name, value), FARTHEST_RANGE_MM)
        for name, value in zip(names, defocus, strict=True)
    ]
    inverse = float(np.mean([1 / value for value in own]))
    for _ in range(NEWTON_STEPS):
        at = 1 / max(inverse, 1 / FARTHEST_RANGE_MM)
        left = defocus - [law.defocus(name, at) for name in names]
        slope = np.array([-law.slope(name, at) * at**2 for name in names])
        inverse += float(slope @ weight @ left / (slope @ weight @ slope))
        inverse = min(
            max(inverse, 1 / FARTHEST_RANGE_MM),
            1 / (NEAREST_RANGE * law.lens.focal_length_mm),
        )
    return 1 / inverse if inverse > 2 / FARTHEST_RANGE_MM else np.inf


def _error(
    law: FocusLaw, names: Sequence[str], defocus: Floats, weight: Floats, value: float
) -> float:
    """Return the error of a range from the errors of defocus and law, by differences.

    An edge measures the width of its blur, 8 N times the path: another f-number means
    another defocus.
    """
    by_range = np.array([law.slope(name, value) for name in names])
    size = len(law.covariance)
    slopes = np.zeros(size)
    for k in np.flatnonzero(np.diag(law.covariance) > 0):
        step = np.zeros(size)
        step[k] = min(
            float(np.sqrt(law.covariance[k, k])), 1e-3 if k < ZERO else 1e-3 * value
        )
        ends = []
        for sign in (1, -1):
            varied = law.varied(sign * step)
            ends.append(
                _common_range(
                    varied,
                    names,
                    defocus * law.lens.f_number / varied.lens.f_number,
                    weight,
                )
            )
        slopes[k] = (
            (ends[0] - ends[1]) / (2 * step[k]) if np.all(np.isfinite(ends)) else np.inf
        )
    lens = slopes @ law.covariance @ slopes if np.all(np.isfinite(slopes)) else np.inf
    return float(np.sqrt(1 / (by_range @ weight @ by_range) + lens))


def symmetric_error(defocus: float, std: float) -> float:
    """Return the standard error of a defocus of which only the square is determined, as without other even modes.

    The likelihood is then exp(-(x^2 - d^2)^2 / (2 s^2)), s = 2 |d| std; its own width about zero is the root of s.
    """
    return float(min(std, np.sqrt(2 * abs(defocus) * std))) if np.isfinite(std) else std
