"""Advice as rows of text, for the command line."""

from __future__ import annotations

from labkit.analysis.advise import Advice
from labkit.analysis.outlook import NUMBERS, Errors, Outlook

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
    """What to expect of all ranges together: standard errors, beside those that the plan states."""
    light = f"{advice.electrons:g} electrons at white, focus in the middle of the ranges"
    rows = [["whole session", light]]
    session = advice.session
    if session is None:
        rows.append(["best focus", "needs defocus, mode 4, from at least two ranges"])
    else:
        for key, std in session.std.items():
            name, unit = NUMBERS.get(key) or (f"best focus {key.partition('.')[2]}", " mm")
            stated = session.stated.get(key)
            rows.append([name, f"± {std:.2g}{unit}" + (f", stated ± {stated:.2g}{unit}" if stated is not None else "")])
        rows += [[f"with {what}", _in_a_line(std)] for what, std in _would_be(advice, session).items()]
    if advice.frames is not None:
        rows.append(["photographs", f"{advice.frames} for each range, so exposed, for the error wanted"])
    return rows


def _would_be(advice: Advice, session: Outlook) -> dict[str, Errors]:
    """Errors with one thing measured better, or at other ranges."""
    would = {remedy.what: remedy.std for remedy in session.remedies}
    if advice.proposed_ranges_mm:
        would[f"ranges {', '.join(f'{r:g}' for r in advice.proposed_ranges_mm)} mm"] = advice.proposed_std
    return would


def _in_a_line(std: Errors) -> str:
    return ", ".join(f"{name} ± {std[key]:.2g}{unit}" for key, (name, unit) in NUMBERS.items())
