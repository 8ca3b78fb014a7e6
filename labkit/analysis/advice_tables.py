"""Advice as rows of text, for the command line."""

from __future__ import annotations

from labkit.analysis.advise import Advice

Rows = list[list[str]]

HEADING = [
    "range/mm",
    "target/px",
    "cell/Airy radii",
    "best order",
    "least side/mm",
    "defocus/waves",
    "std. error",
    "whole wavefront",
]


def range_rows(advice: Advice) -> Rows:
    """A heading and a row for each range."""
    rows = [HEADING]
    for at in advice.ranges:
        rows.append(
            [
                f"{at.range_mm:g}",
                f"{at.size_px:.0f}",
                "" if at.cell_airy is None else f"{at.cell_airy:.2f}",
                f"{at.order}",
                "" if at.size_mm is None else f"{at.size_mm:.1f}",
                f"{at.defocus_waves:+.2f}",
                f"{at.std_defocus_waves:.5f}",
                f"{at.std_wavefront_waves:.5f}",
            ]
        )
    return rows


def session_rows(advice: Advice) -> Rows:
    """What to expect of all ranges together."""
    light = f"channel {advice.channel}, {advice.electrons:g} electrons at white, focus in the middle of the ranges"
    rows = [["quantity", light]]
    if advice.best_focus_std_mm is None or advice.magnification_std is None:
        rows.append(["best focus", "needs defocus, mode 4, from at least two ranges"])
    else:
        verdict = "determined" if advice.magnification_determined else "not determined at these ranges"
        rows.append(["best focus", f"± {advice.best_focus_std_mm:.2g} mm"])
        rows.append(["pupil magnification", f"± {advice.magnification_std:.2g}: {verdict}"])
    if not advice.magnification_determined and advice.proposed_std is not None:
        ranges = ", ".join(f"{r:g}" for r in advice.proposed_ranges_mm)
        rows.append(["", f"± {advice.proposed_std:.2g} from ranges such as {ranges} mm, the lens focused among them"])
    if advice.frames is not None:
        rows.append(["photographs", f"{advice.frames} for each range, so exposed, for the error wanted"])
    return rows
