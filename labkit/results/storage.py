"""results.json, psf.npz and residuals.npz: nothing else in labkit knows what stands in them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, nan, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from labkit import npz
from labkit.errors import DataError, PlanError
from labkit.files import (
    check_name,
    drop_link,
    refuse_links,
    write_atomically,
    writing,
)
from labkit.finding import NOTE, Finding
from labkit.key import Key
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.results.model import (
    Focus,
    Lens,
    OptimumTest,
    OtherOptimum,
    PartTried,
    Placement,
    Residuals,
    ResidualSpectrum,
    Wavefront,
)
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results

RESULTS, RESIDUALS, PSFS = "results.json", "residuals.npz", "psf.npz"
SCHEMA, READABLE = 3, (1, 2, 3)
FIRST_WITH_FINDINGS = 3
MOST_OTHERS = 5  # other optima that are kept, the likeliest
PSF_SAMPLES_PER_AIRY = 6.0  # of the shortest wavelength's lambda N: three times Nyquist, fine enough to interpolate
PSF_HALF_WIDTH_AIRY = (
    32.0  # of the longest wavelength's lambda N: 0.6 % of the light lies beyond
)
PARTS = ("data", "model", "sigma")  # of residuals
MOST_BYTES = 8  # of a number
MOST_PIXELS = 2**28  # of any photograph
REPORT = ("report.html", "figures")  # made of results: stale as soon as there are others

Json = dict[str, Any]

LENS = {
    "focal_length_mm": ("focal_length", "mm"),
    "f_number": ("f_number", ""),
    "pupil_magnification": ("pupil_magnification", ""),
    "range_zero_mm": ("range_zero", "mm"),
}
"""Keys of the lens, the fields that they hold, and their units."""


def write(folder: Path, results: Results) -> Path:
    """Write all files into a folder, each whole or not at all, results.json last; the report of earlier results goes.

    Returns the path of results.json. Raises InputError where the folder cannot be written to, or is a link.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder)
    files = {  # made before the first is written: files of two fits never lie side by side for long
        PSFS: npz.packed(psfs(results.wavefronts)),
        RESIDUALS: npz.packed(_residuals(results.wavefronts)),
        RESULTS: json.dumps(entry(results), indent=1, allow_nan=False).encode() + b"\n",
    }
    (folder / REPORT[0]).unlink(missing_ok=True)
    drop_link(folder / REPORT[1])
    shutil.rmtree(folder / REPORT[1], ignore_errors=True)
    for name, packed in files.items():
        write_atomically(folder / name, packed)
    return folder / RESULTS


def read(folder: Path, name: str) -> dict[str, Any]:
    """The fields of results: of a session's folder those of that name, or those of a results folder.

    Raises DataError, or SessionError for a name that is unsafe, and for links.
    """
    session = folder / "results"
    place = (
        session / check_name(name)
        if session.is_dir() or not (folder / RESULTS).exists()
        else folder
    )
    path = place / RESULTS
    refuse_links(session, place, path, place / RESIDUALS)
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise DataError(f"no {path}: run labkit fit first{_others(session)}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"cannot read {path}: {error}; fit the session again") from None
    schema = entry.get("schema") if isinstance(entry, dict) else None
    if schema not in READABLE:
        known = f"{READABLE[0]} to {READABLE[-1]}"
        raise DataError(
            f"{path} has schema {schema!r}; this version reads schemas {known}: fit the session again"
        )
    try:
        return _fields(entry, place)
    except PlanError as error:
        raise DataError(f"{path}: {error}; fit the session again") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        detail = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(
            f"{path} is not as schema {schema} has it: {detail}; fit the session again"
        ) from None


def kept_keys(folder: Path) -> set[Key]:
    """Keys of the wavefronts whose results a folder holds; empty where it holds none that can be read."""
    try:
        entries = json.loads((folder / RESULTS).read_text(encoding="utf-8"))["wavefronts"]
        return {_key(entry) for entry in entries}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()


def entry(results: Results) -> Json:
    """The content of results.json."""
    r, plan = results, results.plan
    return {
        "schema": SCHEMA,
        "labkit_version": r.labkit_version,
        "created": r.created,
        "plan_sha256": r.plan_sha256,
        "plan": plan.model_dump(mode="json", exclude_none=True),
        "convention": plan.fit.convention,
        "reference_wavelength_nm": plan.reference_wavelength_nm,
        "wavefronts": [_wavefront_json(w) for w in r.wavefronts],
        "focus": None if r.focus is None else _focus_json(r.focus),
        "lens": None if r.lens is None else _lens_json(r.lens),
        "budget": {name: dict(shares) for name, shares in r.budget.items()},
        "joint": dict(r.joint),
        "model_parts": {name: number.as_json() for name, number in r.model_parts.items()},
        "parts_tried": [
            {"part": p.name, "gain": round(p.gain, 1), "adopted": p.adopted}
            for p in r.parts_tried
        ],
        "widest_light_nm": {name: round(nm, 1) for name, nm in r.widest_light_nm.items()},
        "findings": [finding.as_json() for finding in r.findings],
        "warnings": list(r.warnings),
        "unanswered": r.unanswered,
    }


def psfs(wavefronts: Sequence[Wavefront]) -> dict[str, npt.NDArray[Any]]:
    """PSFs of the optics alone on one grid for all: unit sum, centred, odd; and their spacing_um."""
    airy_um = [w.wavelength_nm * 1e-3 * w.f_number for w in wavefronts]
    spacing_um = min(airy_um) / PSF_SAMPLES_PER_AIRY
    size = 2 * int(np.ceil(PSF_HALF_WIDTH_AIRY * max(airy_um) / spacing_um)) + 1
    arrays: dict[str, npt.NDArray[Any]] = {"spacing_um": np.array(spacing_um)}
    for w in wavefronts:
        arrays[f"psf_{w.key}"] = w.psf(spacing_um, size).astype(np.float32)
    return arrays


def _residuals(wavefronts: Sequence[Wavefront]) -> dict[str, npt.NDArray[Any]]:
    """data_, model_ and sigma_ of each wavefront, (frames, planes, rows, columns)."""
    return {
        f"{part}_{w.key}": getattr(w.residuals, part).astype(np.float32)
        for w in wavefronts
        if w.residuals is not None
        for part in PARTS
    }


def _wavefront_json(w: Wavefront) -> Json:
    entry = {
        "key": w.key.as_json(),
        "range_mm": w.range_mm,
        "measured_range_mm": w.measured_range_mm,
        "channel": w.channel,
        "wavelength_nm": w.wavelength_nm,
        "spectrum": None if w.spectrum == Spectrum() else w.spectrum.lines(w.wavelength_nm),
        "f_number": w.f_number,
        "f_number_working": w.working_f_number.as_json(),
        "blur_um": None if w.blur is None else w.blur.as_json(),
        "noll": list(w.noll),
        "waves_rms": _listed(w.waves),
        "std": _listed(w.std),
        "covariance": _listed(w.covariance),
        "pose": _listed(w.poses[0]),
        "poses": _listed(w.poses),
        "gain": _number(w.gain),
        "read_noise": _number(w.read_noise),
        "chi2_per_pixel": _number(w.chi2_per_pixel),
        "global_test": None if w.test is None else _test_json(w.test),
        "optimum": None if w.test is None else _optimum_json(w.test),
        "model": None
        if w.test is None
        else {
            "accepted": w.test.explains,
            "p_value": _number(w.test.p_value),
            "missing": list(w.missing),
        }
        | (
            {}
            if w.residual_spectrum is None
            else {"residual_spectrum": w.residual_spectrum.as_json()}
        ),
        "seconds": round(w.seconds, 3) if isfinite(w.seconds) else None,
        "frames": list(w.frames),
    }
    if w.placement is not None:
        entry["origin_px"], entry["shape_px"] = (
            list(w.placement.origin_px),
            list(w.placement.shape_px),
        )
        entry["corners_px"] = _listed(w.placement.corners_px)
    return entry


def _test_json(test: OptimumTest) -> Json:
    return {
        "name": test.name,
        "p_value": _number(test.p_value),
        "accepted": test.accepted,
        "undetermined": list(test.undetermined),
        "starts": test.starts,
        "others": [
            {
                "waves_rms": _listed(other.waves),
                "log_likelihood_below": round(other.log_likelihood_below, 1),
            }
            for other in test.others[:MOST_OTHERS]
        ],
    }


def _optimum_json(test: OptimumTest) -> Json:
    return {
        "accepted": test.accepted,
        "p_value": _number(test.p_value),
        "others": len(test.others),
    }


def _lens_json(lens: Lens) -> Json:
    return {name: getattr(lens, field).as_json() for name, (field, _) in LENS.items()}


def _focus_json(focus: Focus) -> Json:
    return {
        "best_focus_mm": {
            channel: best.as_json() for channel, best in focus.best_focus_mm.items()
        },
        "pupil_magnification": {
            **focus.pupil_magnification.as_json(),
            "identifiable": focus.identifiable,
        },
        "residual_waves": {
            channel: list(rest) for channel, rest in focus.residual_waves.items()
        },
        "residual_std_waves": {
            channel: list(std) for channel, std in focus.residual_std_waves.items()
        },
        "covariance": None if focus.covariance is None else _listed(focus.covariance),
        "chi2_per_freedom": focus.chi2_per_freedom,
    }


def _listed(values: Floats) -> Any:
    """Nested lists of numbers, None for those that are not finite."""
    values = np.asarray(values, float)
    return (
        [_listed(row) for row in values]
        if values.ndim > 1
        else [_number(x) for x in values]
    )


def _number(value: float) -> float | None:
    return float(value) if isfinite(value) else None


def _others(session: Path) -> str:
    names = sorted(path.parent.name for path in session.glob(f"*/{RESULTS}"))
    return f"; results there are: {', '.join(names)} (--name)" if names else ""


def _with_residuals(wavefronts: Sequence[Wavefront], path: Path) -> Iterator[Wavefront]:
    """Yield wavefronts with their residuals in a file, where it holds them."""
    most_bytes = {
        f"{part}_{w.key}": MOST_BYTES * len(w.poses) * _pixels(w)
        for w in wavefronts
        for part in PARTS
    }
    try:
        content = path.read_bytes() if path.exists() else None
        arrays = {} if content is None else npz.unpacked(content, most_bytes.get)
        for w in wavefronts:
            names = [f"{part}_{w.key}" for part in PARTS]
            if all(name in arrays for name in names):
                w = replace(w, residuals=Residuals(*(arrays[name] for name in names)))
            yield w
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}; fit the session again") from None


def _pixels(w: Wavefront) -> int:
    """Return the largest number of pixels that a wavefront was fitted to in a photograph."""
    return MOST_PIXELS if w.placement is None else prod(w.placement.shape_px)


def _fields(entry: Json, folder: Path) -> dict[str, Any]:
    plan = _plan(entry, folder)
    return {
        "plan": plan,
        "plan_sha256": str(entry["plan_sha256"]),
        "wavefronts": tuple(
            _with_residuals(
                [_wavefront(w, plan) for w in entry["wavefronts"]], folder / RESIDUALS
            )
        ),
        "focus": None if entry["focus"] is None else _focus(entry["focus"]),
        "lens": None if entry.get("lens") is None else _lens(entry["lens"]),
        "budget": {
            str(name): dict(shares) for name, shares in entry.get("budget", {}).items()
        },
        "joint": {
            str(name): float(moved) for name, moved in entry.get("joint", {}).items()
        },
        "model_parts": {
            str(name): Uncertain.from_json(number, _unit(name))
            for name, number in entry.get("model_parts", {}).items()
        },
        "parts_tried": tuple(
            PartTried(str(p["part"]), _optional(p["gain"]), bool(p["adopted"]))
            for p in entry.get("parts_tried", ())
        ),
        "widest_light_nm": {
            str(name): float(nm) for name, nm in entry.get("widest_light_nm", {}).items()
        },
        "findings": tuple(_findings(entry)),
        "unanswered": entry.get("unanswered"),
        "created": str(entry["created"]),
        "labkit_version": str(entry["labkit_version"]),
        "folder": folder,
    }


def _findings(entry: Json) -> list[Finding]:
    """All findings; of results before schema 3, which had none, their warnings."""
    warnings = [str(text) for text in entry["warnings"]]
    if entry["schema"] < FIRST_WITH_FINDINGS:
        return [Finding(NOTE, None, {}, text) for text in warnings]
    return [Finding.from_json(finding, warnings) for finding in entry["findings"]]


def _key(wavefront: Json) -> Key:
    """The identity of a wavefront; before schema 3 its range and channel."""
    return Key.from_json(wavefront.get("key") or wavefront)


def _plan(entry: Json, folder: Path) -> Plan:
    """The plan that the results were made with; of results that do not hold it, the session's."""
    if "plan" not in entry:
        return Plan.load(folder.resolve().parents[1] / "plan.toml")
    try:
        return Plan.from_tables(entry["plan"], files_needed=False)
    except PlanError as error:
        raise PlanError(f"the plan in it cannot be read: {error}") from None


def _unit(name: str) -> str:
    """That a number's name ends with."""
    units = {"px": "px", "px2": "px²", "nm": "nm"}
    return units.get(name.rpartition("_")[2], "")


def _optional(value: Any) -> float:
    return nan if value is None else float(value)


def _numbers(values: Any) -> Floats:
    return np.array(values, dtype=float)  # None becomes nan


def _wavefront(entry: Json, plan: Plan) -> Wavefront:
    key = _key(entry)
    measured_mm = entry.get("measured_range_mm", key.range_mm)
    return Wavefront(
        range_mm=key.range_mm,
        measured_range_mm=None if measured_mm is None else float(measured_mm),
        channel=key.channel,
        tile=key.tile,
        wavelength_nm=float(entry["wavelength_nm"]),
        reference_wavelength_nm=plan.reference_wavelength_nm,
        f_number=float(entry.get("f_number", plan.lens.f_number)),
        f_number_std=_optional(entry.get("f_number_working", {}).get("std")),
        blur=None
        if entry.get("blur_um") is None
        else Uncertain.from_json(entry["blur_um"], "um"),
        noll=tuple(int(j) for j in entry["noll"]),
        waves=_numbers(entry["waves_rms"]),
        covariance=_covariance(entry),
        poses=np.atleast_2d(_numbers(entry.get("poses") or [entry["pose"]])),
        gain=_optional(entry.get("gain")),
        read_noise=_optional(entry.get("read_noise")),
        chi2_per_pixel=_optional(entry.get("chi2_per_pixel")),
        test=_test(entry.get("global_test"), entry.get("model")),
        seconds=_optional(entry.get("seconds")),
        frames=tuple(str(name) for name in entry.get("frames", ())),
        missing=tuple(str(name) for name in (entry.get("model") or {}).get("missing", ())),
        spectrum=Spectrum.of_lines(
            entry.get("spectrum") or [[entry["wavelength_nm"], 1.0]], entry["wavelength_nm"]
        ),
        residual_spectrum=ResidualSpectrum.from_json(
            (entry.get("model") or {}).get("residual_spectrum")
        ),
        placement=_placement(entry),
    )


def _covariance(entry: Json) -> Floats:
    """Of results without one, that of independent errors."""
    covariance = entry.get("covariance")
    return (
        np.diag(_numbers(entry["std"]) ** 2) if covariance is None else _numbers(covariance)
    )


def _placement(entry: Json) -> Placement | None:
    if "corners_px" not in entry:
        return None
    (row, column), (rows, columns) = entry["origin_px"], entry["shape_px"]
    return Placement(
        (int(row), int(column)), (int(rows), int(columns)), _numbers(entry["corners_px"])
    )


def _test(entry: Json | None, model: Json | None) -> OptimumTest | None:
    if entry is None:
        return None
    others = [
        OtherOptimum(_numbers(o["waves_rms"]), _optional(o["log_likelihood_below"]))
        for o in entry.get("others", ())
    ]
    return OptimumTest(
        name=str(entry.get("name", "")),
        accepted=bool(entry["accepted"]),
        p_value=_optional(entry.get("p_value")),
        starts=entry.get("starts"),
        undetermined=tuple(entry.get("undetermined", ())),
        others=tuple(others),
        explains=bool((model or entry)["accepted"]),
    )


def _lens(entry: Json) -> Lens:
    return Lens(
        **{
            field: Uncertain.from_json(entry[name], unit)
            for name, (field, unit) in LENS.items()
        }
    )


def _focus(entry: Json) -> Focus:
    magnification = entry["pupil_magnification"]
    covariance, chi2 = entry.get("covariance"), entry.get("chi2_per_freedom")
    return Focus(
        best_focus_mm={
            str(c): Uncertain.from_json(best, "mm")
            for c, best in entry["best_focus_mm"].items()
        },
        pupil_magnification=Uncertain.from_json(magnification),
        identifiable=bool(magnification.get("identifiable", True)),
        residual_waves={
            str(c): tuple(map(_optional, rest))
            for c, rest in entry.get("residual_waves", {}).items()
        },
        covariance=None if covariance is None else _numbers(covariance),
        chi2_per_freedom=None if chi2 is None else float(chi2),
        residual_std_waves={
            str(c): tuple(map(_optional, std))
            for c, std in entry.get("residual_std_waves", {}).items()
        },
    )
