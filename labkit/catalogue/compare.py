"""Whether two sessions are of one lens: the numbers determined by both, with the joint covariance of their differences.

Numbers that differ between sessions of one lens are not tested: the target's pose, range zero, and the focus setting.
Wavefronts are on the sensor's axes, whichever way the camera was turned. If both sessions are of one lens, the error of a
number that both plans state alike, such as the engraved f-number, is the same error in both, and hardly moves a difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc

from labkit.errors import DataError
from labkit.optics.metrics import rms
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import is_even
from labkit.results import Results
from labkit.results.model import (
    BEST_FOCUS_MM,
    F_NUMBER_AT_INFINITY,
    FOCAL_LENGTH_MM,
    MODE_WAVES,
    CommonNumbers,
)
from labkit.results.verdicts import confirmed
from labkit.types import Floats
from labkit.uncertain import Uncertain

FALSE_ALARM = 0.01
"""Probability of one lens below which sessions are said to differ."""

LEAST_SHOWN = 1e-99
"""Least p-value shown as a number."""

LEAST_TESTED_VARIANCE = 1e-3
"""Least variance of a tested combination of differences, over that of both sessions' errors. Focal length, f-number and pupil
magnification together are known 50 times better than each; tapes 0.5 % apart turn that combination by more than its error."""

WAVELENGTH_PREFIX = "wavelength"
"""Start of the names of the camera's stated numbers."""

OTHER_FOCUS = 0.1
"""Relative difference of best focus from which aberrations change with the distance about as much."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A number in two sessions. difference: second less first; tested: whether the p-value depends on it."""

    name: str
    first: float
    second: float
    difference: Uncertain
    tested: bool

    @property
    def in_errors(self) -> float:
        """The difference in standard errors; nan where they are 0."""
        return self.difference.value / self.difference.std if self.difference.std else nan

    def as_json(self) -> dict[str, Any]:
        """Return the difference for programs."""
        return {
            "name": self.name,
            "a": self.first,
            "b": self.second,
            **self.difference.as_json(),
            "tested": self.tested,
        }


@dataclass(frozen=True)
class Comparison:
    """Two sessions compared.

    Attributes
    ----------
    first, second : names of the sessions
    p_value : probability of differences as large, or larger, for one lens
    chi2, freedom : squared differences over their covariance, and the number of combinations determined by both sessions
    differences : by number
    wavefronts : second less first by channel, without defocus, with their joint covariance
    notes : other possible differences, in words
    """

    first: str
    second: str
    p_value: float
    chi2: float
    freedom: int
    differences: tuple[Difference, ...]
    wavefronts: dict[str, FittedWavefront]
    notes: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Return whether the sessions may be of one lens, at `FALSE_ALARM`."""
        return self.p_value >= FALSE_ALARM

    @property
    def headline(self) -> str:
        """A sentence that says whether the sessions are of one lens."""
        one = self.largest
        most = f"{one.name} differs most, by {one.difference}"
        verdict = (
            "may be of one lens" if self.same else "are not of one lens, or it changed"
        )
        return f"{self.first} and {self.second} {verdict} ({self.probability}): {most}"

    @property
    def probability(self) -> str:
        """The p-value in words."""
        tiny = self.p_value < LEAST_SHOWN
        return f"p < {LEAST_SHOWN:g}" if tiny else f"p = {self.p_value:.2g}"

    def as_json(self) -> dict[str, Any]:
        """Return the comparison for programs."""
        return {
            "a": self.first,
            "b": self.second,
            "p_value": self.p_value,
            "chi2": self.chi2,
            "freedom": self.freedom,
            "rms_waves": {
                channel: rms(wavefront).as_json()
                for channel, wavefront in self.wavefronts.items()
            },
            "differences": [one.as_json() for one in self.differences],
            "notes": list(self.notes),
        }

    @property
    def largest(self) -> Difference:
        """The tested difference of most standard errors."""
        tested = [one for one in self.differences if one.tested]
        return max(tested, key=lambda one: abs(np.nan_to_num(one.in_errors)))


@dataclass(frozen=True)
class _Differences:
    """Differences of the shared numbers. first, second: (n,); covariance: (n, n); scale: (n,) both sessions' errors."""

    names: tuple[str, ...]
    first: Floats
    second: Floats
    covariance: Floats
    scale: Floats
    tested: tuple[bool, ...] = field(default=())

    @property
    def values(self) -> Floats:
        return self.second - self.first

    def test(self) -> tuple[float, int]:
        """Return chi2 and its degrees of freedom: combinations without variance are the same statement in both plans."""
        at = np.flatnonzero(np.array(self.tested) & (self.scale > 0))
        scaled = self.covariance[np.ix_(at, at)] / np.outer(self.scale[at], self.scale[at])
        variances, vectors = np.linalg.eigh(scaled)
        along = vectors.T @ (self.values[at] / self.scale[at])
        known = variances > LEAST_TESTED_VARIANCE
        return float(np.sum(along[known] ** 2 / variances[known])), int(known.sum())


def compare_results(
    first: Results,
    second: Results,
    *,
    names: tuple[str, str] = ("A", "B"),
    same_focus: bool = False,
    same_camera: bool = True,
) -> Comparison:
    """Compare two sessions' results.

    Parameters
    ----------
    first, second : results
    names : of the sessions
    same_focus : whether lens, camera and rail stayed as they were between them: then best focus is tested too
    same_camera : whether both were taken by one kind of body, whose filters' wavelengths err alike

    Returns
    -------
    Differences, second less first

    Raises
    ------
    DataError
        the sessions have no number in common
    """
    found = _differences(
        _common(first), _common(second), first, second, same_camera, same_focus
    )
    if not found.names:
        raise DataError(
            f"{names[0]} and {names[1]} have no channel with the same modes: fit both with one plan (labkit fit --plan)"
        )
    open_sign = any(w.sign_open for one in (first, second) for w in one.wavefronts)
    found = replace(found, tested=tuple(_tests(found.names, open_sign, same_focus)))
    if open_sign:
        found = min(found, _turned(found), key=lambda one: one.test()[0])
    chi2, freedom = found.test()
    return Comparison(
        *names,
        float(chdtrc(freedom, chi2)) if freedom else 1.0,
        chi2,
        freedom,
        tuple(_rows(found)),
        dict(_wavefronts(found, first)),
        tuple(_notes(first, second, names, open_sign, found)),
    )


def shares_wavelengths(results: Results) -> bool:
    """Return whether errors of wavelengths, which sessions of one body share, are in results."""
    stated = {} if results.common is None else results.common.stated
    return any(name.startswith(WAVELENGTH_PREFIX) for name in stated)


def _common(results: Results) -> CommonNumbers:
    """Return the lens's numbers; of results without them, each channel's best known modes, as if independent."""
    if results.common is not None:
        return results.common
    best = [results.best_known(channel) for channel in results.channels]
    bare = [w.at_focus() for w in best]
    return CommonNumbers(
        tuple(
            f"{MODE_WAVES}.{w.channel}.{j}"
            for w, wavefront in zip(best, bare, strict=True)
            for j in wavefront.noll
        ),
        np.concatenate([w.waves for w in bare]),
        np.asarray(block_diag(*(w.covariance for w in bare))),
    )


def _differences(
    a: CommonNumbers,
    b: CommonNumbers,
    first: Results,
    second: Results,
    same_camera: bool,
    same_focus: bool,
) -> _Differences:
    """Return the differences of the numbers that both have, waves at the first's reference wavelength."""
    names = tuple(name for name in a.names if name in b.names)
    in_a = [a.names.index(name) for name in names]
    in_b = [b.names.index(name) for name in names]
    ratio = second.reference_wavelength_nm / first.reference_wavelength_nm
    factor = np.array([ratio if _is_mode(name) else 1.0 for name in names])
    of_a = a.covariance[np.ix_(in_a, in_a)]
    of_b = b.covariance[np.ix_(in_b, in_b)] * np.outer(factor, factor)
    covariance = of_a + of_b + np.diag(_tapes(names, first, second, same_focus))
    for name, one in a.stated.items():
        other = b.stated.get(name)
        camera = name.startswith(WAVELENGTH_PREFIX)
        if other is None or (one.value, one.std) != (other.value, other.std):
            continue
        if same_camera or not camera:
            both = np.outer(one.moves[in_a], factor * other.moves[in_b])
            covariance = covariance - both - both.T
    return _Differences(
        names,
        a.values[in_a],
        factor * b.values[in_b],
        covariance,
        np.sqrt(np.diag(of_a) + np.diag(of_b)),
    )


def _tapes(
    names: tuple[str, ...], first: Results, second: Results, same_focus: bool
) -> Floats:
    """Return the variance (n,) of best focus between two tapes, which a lens that stayed in its place has not."""
    tapes = sum(one.plan.fit.range_zero_std_mm**2 for one in (first, second))
    own = [name.startswith(BEST_FOCUS_MM) and not same_focus for name in names]
    return np.where(own, tapes, 0.0)


def _tests(names: tuple[str, ...], open_sign: bool, same_focus: bool) -> Iterator[bool]:
    """Yield whether each number is tested: with an open sign only those of either sign."""
    either = (FOCAL_LENGTH_MM, F_NUMBER_AT_INFINITY)
    for name in names:
        if _is_mode(name) or name in either:
            yield True
        else:
            focus = name.startswith(BEST_FOCUS_MM)
            yield not open_sign and (same_focus or not focus)


def _turned(found: _Differences) -> _Differences:
    """Return the differences from the second session's twin."""
    signs = np.array(
        [
            -1.0 if _is_mode(name) and is_even(int(name.split(".")[-1])) else 1.0
            for name in found.names
        ]
    )
    return replace(found, second=signs * found.second)


def _rows(found: _Differences) -> Iterator[Difference]:
    stds = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    columns = (found.names, found.first, found.second, found.values, stds, found.tested)
    for name, first, second, value, std, tested in zip(*columns, strict=True):
        difference = Uncertain(value, std, _unit(name))
        yield Difference(name, float(first), float(second), difference, tested)


def _wavefronts(
    found: _Differences, first: Results
) -> Iterator[tuple[str, FittedWavefront]]:
    """Yield the difference of the wavefronts of each channel."""
    for channel in first.channels:
        start = f"{MODE_WAVES}.{channel}."
        at = [k for k, name in enumerate(found.names) if name.startswith(start)]
        if at:
            best = first.best_known(channel).fitted
            covariance = found.covariance[np.ix_(at, at)]
            yield (
                channel,
                replace(
                    best,
                    noll=tuple(int(found.names[k].split(".")[-1]) for k in at),
                    waves=found.values[at],
                    covariance=(covariance + covariance.T) / 2,
                ),
            )


def _notes(
    first: Results,
    second: Results,
    names: tuple[str, str],
    open_sign: bool,
    found: _Differences,
) -> Iterator[str]:
    """Yield what the p-value does not allow for, in words."""
    for name, results in zip(names, (first, second), strict=True):
        if results.common is None:
            yield f"{name} holds no joint covariance: channels count as independent; fit it again"
        if not all(confirmed(w, results.wavefronts) for w in results.wavefronts):
            yield f"errors of {name} are not all known: its p-value is too small"
        others = {n for n in _common(results).names if _is_mode(n)} - set(found.names)
        if others:
            yield f"{len(others)} modes of {name} are not compared: the other session has none of them"
    if open_sign:
        yield "the sign of defocus is open: of the two twins the nearer is compared"
    stops = [results.plan.lens.f_number for results in (first, second)]
    if stops[0] != stops[1]:
        yield f"the plans state f/{stops[0]:g} and f/{stops[1]:g}: wavefronts are over different pupils"
    foci = {
        pair
        for name, *pair_ in zip(found.names, found.first, found.second, strict=True)
        if name.startswith(BEST_FOCUS_MM) and (pair := tuple(pair_))
    }
    for near, far in map(sorted, foci):
        if far > (1 + OTHER_FOCUS) * near:
            yield f"focused at {near:.0f} and {far:.0f} mm: a lens's aberrations change with the distance"
    apart_mm, size_mm = _apart_mm(first, second)
    if apart_mm > size_mm / 2:
        yield f"the targets stood {apart_mm:.2f} mm apart on the sensor: aberrations change over the field"


def _apart_mm(first: Results, second: Results) -> tuple[float, float]:
    """Return how far apart the targets' centres were on the sensor, and the size of the first's picture; nan if unknown."""
    centres, size_mm = [], nan
    for results in (second, first):
        placed = next((w.placement for w in results.wavefronts if w.placement), None)
        if placed is None:
            return nan, nan
        pitch_mm = 1e-3 * results.plan.sensor.pixel_pitch_um
        corners = placed.corners_px[0] * pitch_mm
        centres.append(corners.mean(axis=0))
        size_mm = float(np.ptp(corners[:, 0]))
    return float(np.linalg.norm(centres[0] - centres[1])), size_mm


def _is_mode(name: str) -> bool:
    return name.startswith(f"{MODE_WAVES}.")


def _unit(name: str) -> str:
    kind = name.split(".")[0]
    if kind == MODE_WAVES:
        return "waves"
    return {"mm": "mm", "um": "µm"}.get(kind.rpartition("_")[2], "")
