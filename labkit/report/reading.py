"""What a report is written from: a results folder, read and checked."""

import json
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from labkit.errors import DataError
from labkit.types import Floats

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and its standard error; nan where there is none."""

    value: float
    std: float = nan


@dataclass(frozen=True, slots=True)
class Verdict:
    """The test of whether a fit stands at the global optimum. next_below: log-likelihood of the next optimum seen, below."""

    name: str
    accepted: bool
    p_value: float
    starts: int | None
    next_below: float = nan


@dataclass(frozen=True, slots=True)
class Residuals:
    """(frames, planes, rows, cols) counts of the pixels fitted, their model and its noise; nan where masked."""

    data: Floats
    model: Floats
    sigma: Floats

    @property
    def normalised(self) -> Floats:
        """Data minus model, in standard deviations of the noise."""
        return np.asarray((self.data - self.model) / self.sigma)


@dataclass(frozen=True, slots=True)
class Wavefront:
    """One fit: the wavefront of a channel at a range, in waves RMS at the reference wavelength."""

    range_mm: float | None
    channel: str
    wavelength_nm: float
    noll: tuple[int, ...]
    waves: Floats
    std: Floats
    covariance: Floats | None
    pose: Floats
    gain: float
    read_noise: float
    chi2_per_pixel: float
    verdict: Verdict | None
    seconds: float
    frames: tuple[str, ...]
    psf: Floats | None
    residuals: Residuals | None

    @property
    def key(self) -> str:
        """As the arrays of psf.npz and residuals.npz are named, without their first word."""
        return _key(self.range_mm, self.channel)

    @property
    def defocus(self) -> Estimate | None:
        """Noll 4, where it was fitted."""
        if 4 not in self.noll:
            return None
        k = self.noll.index(4)
        return Estimate(float(self.waves[k]), float(self.std[k]))

    def rms(self, without: tuple[int, ...] = ()) -> Estimate:
        """Root sum of squares over the modes fitted, but for some; the error to first order."""
        keep = np.array([j not in without for j in self.noll], bool)
        waves = self.waves[keep]
        covariance = np.diag(self.std**2) if self.covariance is None else self.covariance
        total = float(np.sqrt(np.sum(waves**2)))
        if total == 0:
            return Estimate(0.0)
        slope = waves / total
        variance = float(slope @ covariance[np.ix_(keep, keep)] @ slope)
        return Estimate(total, float(np.sqrt(variance)) if variance >= 0 else nan)


@dataclass(frozen=True, slots=True)
class Focus:
    """Best focus of each channel and the pupil magnification; the residuals of that fit in waves RMS."""

    best_mm: dict[str, Estimate]
    pupil_magnification: Estimate
    identifiable: bool
    residual_waves: dict[str, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Measurement:
    """A results folder."""

    folder: Path
    version: str
    created: str
    plan_sha256: str
    convention: str
    reference_wavelength_nm: float
    wavefronts: tuple[Wavefront, ...]
    focus: Focus | None
    warnings: tuple[str, ...]
    psf_spacing_um: float

    @property
    def ranges_mm(self) -> tuple[float | None, ...]:
        """Each range once, ascending; the fits without one come first."""
        ranges = {w.range_mm for w in self.wavefronts}
        return tuple(sorted(ranges, key=lambda r: -inf if r is None else r))

    @property
    def channels(self) -> tuple[str, ...]:
        """Each channel once, as they come."""
        return tuple(dict.fromkeys(w.channel for w in self.wavefronts))

    def at_range(self, range_mm: float | None) -> tuple[Wavefront, ...]:
        """The fits of one range."""
        return tuple(w for w in self.wavefronts if w.range_mm == range_mm)

    def of_channel(self, channel: str) -> tuple[Wavefront, ...]:
        """The fits of one channel that know their range."""
        return tuple(w for w in self.wavefronts if w.channel == channel and w.range_mm is not None)


def read_measurement(folder: Path) -> Measurement:
    """Read results.json, and psf.npz and residuals.npz where they are.

    Raises DataError where there are no results, or none of this schema.
    """
    path = folder / "results.json"
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"no {path}: fit the session before reporting on it") from None
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}; fit the session again") from None
    schema = results.get("schema") if isinstance(results, dict) else None
    if schema != SCHEMA:
        raise DataError(f"{path} has schema {schema!r}; this version reads schema {SCHEMA}: fit the session again")
    psfs, residuals = _arrays(folder / "psf.npz"), _arrays(folder / "residuals.npz")
    try:
        return Measurement(
            folder=folder,
            version=str(results["labkit_version"]),
            created=str(results["created"]),
            plan_sha256=str(results["plan_sha256"]),
            convention=str(results["convention"]),
            reference_wavelength_nm=float(results["reference_wavelength_nm"]),
            wavefronts=tuple(_wavefront(w, psfs, residuals) for w in results["wavefronts"]),
            focus=None if results["focus"] is None else _focus(results["focus"]),
            warnings=tuple(str(w) for w in results["warnings"]),
            psf_spacing_um=float(psfs.get("spacing_um", nan)),
        )
    except (KeyError, TypeError, ValueError) as error:
        detail = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{path} is not as schema {SCHEMA} has it: {detail}; fit the session again") from None


def _arrays(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            return dict(archive)
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"cannot read {path}: {error}; fit the session again") from None


def _key(range_mm: float | None, channel: str) -> str:
    return f"{'none' if range_mm is None else format(range_mm, 'g')}_{channel}"


def _number(value: Any) -> float:
    return nan if value is None else float(value)


def _numbers(values: Any) -> Floats:
    return np.array(values, dtype=float)  # None becomes nan


def _estimate(entry: dict[str, Any]) -> Estimate:
    return Estimate(_number(entry.get("value")), _number(entry.get("std")))


def _verdict(test: dict[str, Any] | None) -> Verdict | None:
    if test is None:
        return None
    name, others = str(test.get("name", "")), test.get("others") or [{}]
    next_below = _number(others[0].get("log_likelihood_below"))
    return Verdict(name, bool(test["accepted"]), _number(test.get("p_value")), test.get("starts"), next_below)


def _wavefront(entry: dict[str, Any], psfs: dict[str, Any], residuals: dict[str, Any]) -> Wavefront:
    noll = tuple(int(j) for j in entry["noll"])
    waves, std = _numbers(entry["waves_rms"]), _numbers(entry["std"])
    if not waves.shape == std.shape == (len(noll),):
        raise ValueError(f"{len(noll)} modes, {waves.size} coefficients and {std.size} standard errors")
    range_mm = entry["range_mm"]
    key = _key(range_mm, entry["channel"])
    covariance = entry.get("covariance")
    parts = [residuals[name] for part in ("data", "model", "sigma") if (name := f"{part}_{key}") in residuals]
    return Wavefront(
        range_mm=None if range_mm is None else float(range_mm),
        channel=str(entry["channel"]),
        wavelength_nm=float(entry["wavelength_nm"]),
        noll=noll,
        waves=waves,
        std=std,
        covariance=None if covariance is None else _numbers(covariance),
        pose=_numbers(entry.get("pose") or []),
        gain=_number(entry.get("gain")),
        read_noise=_number(entry.get("read_noise")),
        chi2_per_pixel=_number(entry.get("chi2_per_pixel")),
        verdict=_verdict(entry.get("global_test")),
        seconds=_number(entry.get("seconds")),
        frames=tuple(str(f) for f in entry.get("frames", ())),
        psf=psfs.get(f"psf_{key}"),
        residuals=Residuals(*parts) if len(parts) == 3 else None,
    )


def _focus(entry: dict[str, Any]) -> Focus:
    magnification = entry["pupil_magnification"]
    return Focus(
        best_mm={str(c): _estimate(e) for c, e in entry["best_focus_mm"].items()},
        pupil_magnification=_estimate(magnification),
        identifiable=bool(magnification.get("identifiable", True)),
        residual_waves={str(c): tuple(map(_number, v)) for c, v in entry.get("residual_waves", {}).items()},
    )
