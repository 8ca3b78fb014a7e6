"""results.json as rows of text, for the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from labkit.errors import DataError


def read_results(folder: Path) -> dict[str, Any]:
    """What results.json in a results folder says. Raises DataError if there is none, or it is of another schema."""
    try:
        results: dict[str, Any] = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{folder} holds no results: run labkit fit first") from error
    if results.get("schema") != 1:
        raise DataError(f"{folder / 'results.json'} has schema {results.get('schema')}: labkit reads 1")
    return results


def wavefront_rows(results: dict[str, Any]) -> list[list[str]]:
    """A heading, and a row for each range and channel: defocus, RMS of all modes, how well the model fits."""
    waves = f"waves at {results['reference_wavelength_nm']:g} nm"
    rows = [["range/mm", "channel", f"defocus/{waves}", "RMS, all modes", "χ²/pixel", "optimum"]]
    for fit in results["wavefronts"]:
        numbers = dict(zip(fit["noll"], zip(fit["waves_rms"], fit["std"], strict=True), strict=True))
        defocus = f"{numbers[4][0]:+.4f} ± {numbers[4][1]:.4f}" if 4 in numbers else "not fitted"
        rms = sum(value**2 for value in fit["waves_rms"]) ** 0.5
        test = fit["global_test"]
        verdict = "untested" if test is None else "accepted" if test["accepted"] else "REJECTED"
        rows.append(
            [_range(fit["range_mm"]), fit["channel"], defocus, f"{rms:.4f}", f"{fit['chi2_per_pixel']:.3f}", verdict]
        )
    return rows


def focus_rows(results: dict[str, Any]) -> list[list[str]]:
    """A heading, best focus of each channel, and the pupil magnification; one row that says so if there are none."""
    focus = results["focus"]
    if focus is None:
        return [["best focus: not fitted, see the warnings"]]
    rows = [["quantity", "estimate"]]
    for channel, best in focus["best_focus_mm"].items():
        rows.append([f"best focus {channel}", f"{best['value']:.2f} ± {best['std']:.2f} mm"])
    magnification = focus["pupil_magnification"]
    told = "" if magnification["identifiable"] else " (cannot be told at these ranges)"
    rows.append(["pupil magnification", f"{magnification['value']:.4f} ± {magnification['std']:.4f}{told}"])
    return rows


def _range(range_mm: float | None) -> str:
    return "none" if range_mm is None else f"{range_mm:g}"
