"""What a session's fits amount to, and how they are kept: results.json (schema 1), psf.npz, residuals.npz."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import labkit
from labkit.analysis.focus import FocusFit
from labkit.files import write_atomically
from labkit.imaging.model import Optics
from labkit.inference.fit import WavefrontFit
from labkit.optics.psf import Pupil
from labkit.types import Floats

SCHEMA = 1
OTHERS = 5  # other optima at most that are told of
PSF_SAMPLES_PER_AIRY = 6.0  # of the shortest wavelength's lambda N: three times Nyquist, fine enough to interpolate
PSF_HALF_WIDTH_AIRY = 32.0  # of the longest wavelength's lambda N: 0.6 % of the light lies beyond


@dataclass(frozen=True)
class Plane:
    """One Bayer plane of a fitted frame: counts with black removed, their model, its noise; nan where not used."""

    data: Floats
    model: Floats
    sigma: Floats


@dataclass(frozen=True)
class Wavefront:
    """A fit with what it was made from. planes: [frame][Bayer plane]."""

    range_mm: float | None
    measured_range_mm: float | None
    channel: str
    optics: Optics
    fit: WavefrontFit
    frames: tuple[str, ...]
    planes: tuple[tuple[Plane, ...], ...]

    @property
    def key(self) -> str:
        """As its arrays are called in the npz files."""
        return f"{range_name(self.range_mm)}_{self.channel}"

    def summary(self) -> dict[str, Any]:
        """Its entry in results.json."""
        fit, state = self.fit, self.fit.state
        poses = [[float(x) for x in pose.v] for pose in state.poses]
        return {
            "range_mm": self.range_mm,
            "measured_range_mm": self.measured_range_mm,
            "channel": self.channel,
            "wavelength_nm": round(self.optics.wavelength_um * 1e3, 6),
            "noll": list(fit.noll),
            "waves_rms": [float(x) for x in fit.waves],
            "std": [float(x) for x in fit.std],
            "covariance": [[float(x) for x in row] for row in fit.covariance],
            "pose": poses[0],
            "poses": poses,
            "gain": state.gain,
            "read_noise": state.read_noise,
            "chi2_per_pixel": fit.chi2_per_pixel,
            "global_test": {
                "name": fit.verdict.name,
                "p_value": fit.verdict.p_value,
                "accepted": fit.verdict.accepted,
                "undetermined": list(fit.verdict.undetermined),
                "starts": fit.starts,
                "others": [
                    {"waves_rms": [float(x) for x in o.waves], "log_likelihood_below": round(o.below, 1)}
                    for o in fit.others[:OTHERS]
                ],
            },
            "seconds": round(fit.seconds, 3),
            "frames": list(self.frames),
        }


@dataclass(frozen=True)
class Results:
    """All wavefronts of a session, and the focus fit over them or None.

    unanswered: what was asked for and these frames cannot tell, in words; one of the warnings too.
    """

    plan_sha256: str
    reference_wavelength_nm: float
    convention: str
    wavefronts: tuple[Wavefront, ...]
    focus: FocusFit | None
    warnings: tuple[str, ...]
    unanswered: str | None = None

    def summary(self) -> dict[str, Any]:
        """The content of results.json."""
        return {
            "schema": SCHEMA,
            "labkit_version": labkit.__version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "plan_sha256": self.plan_sha256,
            "convention": self.convention,
            "reference_wavelength_nm": self.reference_wavelength_nm,
            "wavefronts": [w.summary() for w in self.wavefronts],
            "focus": None if self.focus is None else _focus_summary(self.focus),
            "warnings": list(self.warnings),
        }

    def write(self, folder: Path) -> Path:
        """Write all files into a folder, each whole or not at all, results.json last. Returns its path."""
        folder.mkdir(parents=True, exist_ok=True)
        files = {  # made before the first is written: files of two fits never lie side by side for long
            "psf.npz": _packed(self.psfs()),
            "residuals.npz": _packed(self.residuals()),
            "results.json": json.dumps(self.summary(), indent=1, allow_nan=False).encode() + b"\n",
        }
        for name, content in files.items():
            write_atomically(folder / name, content)
        return folder / "results.json"

    def psfs(self) -> dict[str, npt.NDArray[Any]]:
        """PSFs of the optics alone on one grid for all: unit sum, centred, odd; and their spacing_um."""
        airy = [w.optics.airy_um for w in self.wavefronts]
        spacing_um = min(airy) / PSF_SAMPLES_PER_AIRY
        half = int(np.ceil(PSF_HALF_WIDTH_AIRY * max(airy) / spacing_um))
        arrays: dict[str, npt.NDArray[Any]] = {"spacing_um": np.array(spacing_um)}
        for w in self.wavefronts:
            optics = w.optics
            pupil = Pupil(optics.wavelength_um, optics.reference_um, optics.f_number, spacing_um, 4 * half, optics.noll)
            psf = pupil.psf(w.fit.waves)[half : 3 * half + 1, half : 3 * half + 1]
            arrays[f"psf_{w.key}"] = (psf / psf.sum()).astype(np.float32)
        return arrays

    def residuals(self) -> dict[str, npt.NDArray[Any]]:
        """data_, model_ and sigma_ of each wavefront, (frames, planes, rows, columns)."""
        return {
            f"{name}_{w.key}": np.array([[getattr(plane, name) for plane in frame] for frame in w.planes], np.float32)
            for w in self.wavefronts
            for name in ("data", "model", "sigma")
        }


def range_name(range_mm: float | None) -> str:
    """A range as keys name it."""
    return "none" if range_mm is None else f"{range_mm:.10g}"


def _focus_summary(focus: FocusFit) -> dict[str, Any]:
    std = focus.std
    return {
        "best_focus_mm": {
            c: {"value": float(v), "std": float(s)}
            for c, v, s in zip(focus.channels, focus.best_focus_mm, std, strict=False)
        },
        "pupil_magnification": {
            "value": focus.pupil_magnification,
            "std": float(std[-1]),
            "identifiable": focus.identifiable,
        },
        "residual_waves": focus.residual_waves,
        "covariance": [[float(x) for x in row] for row in focus.covariance],
        "chi2_per_freedom": focus.chi2_per_freedom,
    }


def _packed(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
