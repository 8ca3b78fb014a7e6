"""Advice as rows of text, for the command line."""

from __future__ import annotations

from labkit.analysis.advise import Advice


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
