"""Results and advice as rows of text, for the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from labkit.analysis.advise import Advice
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


def advice_rows(advice: Advice) -> tuple[list[list[str]], list[list[str]]]:
    """A heading and a row for each range; then what to expect of the ranges together."""
    rows = [
        [
            "range/mm",
            "target/px",
            "cell/Airy radii",
            "best order",
            "least side/mm",
            "defocus/waves",
            "std. error",
            "whole wavefront",
        ]
    ]
    for one in advice.ranges:
        cell = "" if one.cell_airy is None else f"{one.cell_airy:.2f}"
        rows.append(
            [
                f"{one.range_mm:g}",
                f"{one.size_px:.0f}",
                cell,
                f"{one.order}",
                "" if one.size_mm is None else f"{one.size_mm:.1f}",
                f"{one.defocus_waves:+.2f}",
                f"{one.std_defocus_waves:.5f}",
                f"{one.std_wavefront_waves:.5f}",
            ]
        )
    light = f"channel {advice.channel}, {advice.electrons:g} electrons at white, focus in the middle of the ranges"
    together = [["quantity", light]]
    if advice.best_focus_std_mm is None or advice.magnification_std is None:
        together.append(["best focus", "needs defocus, mode 4, from at least two ranges"])
    else:
        verdict = "determined" if advice.magnification_determined else "not determined at these ranges"
        together.append(["best focus", f"± {advice.best_focus_std_mm:.2g} mm"])
        together.append(["pupil magnification", f"± {advice.magnification_std:.2g}: {verdict}"])
    if not advice.magnification_determined and advice.proposed_std is not None:
        ranges = ", ".join(f"{r:g}" for r in advice.proposed_ranges_mm)
        together.append(
            ["", f"± {advice.proposed_std:.2g} from ranges such as {ranges} mm, the lens focused among them"]
        )
    if advice.frames is not None:
        together.append(["photographs", f"{advice.frames} for each range, so exposed, for the error wanted"])
    return rows, together


def _range(range_mm: float | None) -> str:
    return "none" if range_mm is None else f"{range_mm:g}"
