"""Advice as rows of text, for the command line."""

from __future__ import annotations

from labkit.analysis.advise import Advice
from labkit.analysis.outlook import NUMBERS, Errors, Outlook

Rows = list[list[str]]

COLUMNS = {
    "range/mm": "Range, as the plan or `--range` gives it.",
    "target/px": "Side of the target in the photograph, in pixels of the raw file.",
    "cell/Airy radii": "Smallest cell of a Sierpinski carpet, in radii of the Airy disc on the target, for the shortest "
    "wavelength. Cells below 1 are not resolved. Empty for other kinds of target.",
    "best order": "Highest order of a carpet of this size whose cells the lens resolves.",
    "least side/mm": "Least side of the target at which the lens resolves the plan's order. Empty for other kinds of target.",
    "defocus/waves": "Expected, in waves RMS at the reference wavelength, the lens being focused on the middle of the ranges.",
    "std. error": "Expected standard error of that defocus from the plan's photographs, the f-number of the cone being known.",
    "whole wavefront": "Expected standard error of the whole wavefront, waves RMS: of all modes of `fit.zernike_noll`.",
}
"""Columns of the table of ranges, and what they mean."""

SESSION_ROWS = {
    "whole session": "Light at white in one photograph (`--electrons`), and where the lens is taken to be focused.",
    "best focus NAME": "Expected standard error of a channel's best focus on the rail's scale.",
    "focal length": "Expected standard error, then the one that the plan states for the engraving.",
    "f-number": "Expected standard error at infinity, then the one that the plan states for the engraving.",
    "pupil magnification": "Expected standard error. Above 0.1 these ranges do not determine it.",
    "zero of the tape": "Expected standard error of true ranges less stated ones, then the one that the plan states.",
    "with MEASUREMENT": "Standard errors if this were known better as well: a tape right to 1 mm, a focal length right to "
    "0.1 %, an f-number right to 0.5 %, a target's size right to 1e-5; or at other ranges, where the plan's do not determine "
    "the pupil magnification.",
    "photographs": "With `--want`: photographs for each range that the wanted wavefront error requires.",
}
"""Rows of the table of the whole session, and what they mean."""


def range_rows(advice: Advice) -> Rows:
    """A heading and a row for each range."""
    rows = [list(COLUMNS)]
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
