"""Advice as rows of text, for the command line."""

from __future__ import annotations

from labkit.advice.advise import Advice, RangeAdvice
from labkit.advice.expected_fit import DETERMINED_WAVES
from labkit.advice.outlook import LENS_NUMBERS, Errors, Outlook, Proposal

Rows = list[list[str]]


HEADINGS = [
    "range/mm",
    "target/px",
    "cell/Airy radii",
    "best order",
    "least side/mm",
    "defocus/waves",
    "std. error",
    "whole wavefront",
]
"""Of the table of ranges; docs/reference/advise.md explains them."""


def range_rows(advice: Advice) -> Rows:
    """Return a heading and a row for each range."""
    return [HEADINGS, *map(_range_row, advice.ranges)]


def _range_row(at: RangeAdvice) -> list[str]:
    return [
        f"{at.range_mm:g}",
        f"{at.size_px:.0f}",
        "" if at.cell_airy is None else f"{at.cell_airy:.2f}",
        f"{at.order}",
        "" if at.size_mm is None else f"{at.size_mm:.1f}",
        f"{at.defocus_waves:+.2f}",
        f"{at.std_defocus_waves:.5f}",
        f"{at.std_wavefront_waves:.5f}",
    ]


def session_rows(advice: Advice) -> Rows:
    """Return rows of a session's predicted standard errors beside the plan's stated ones."""
    rows = [
        [
            "whole session",
            f"{advice.electrons:g} electrons at white, focus in the middle of the ranges",
        ]
    ]
    if advice.session is None:
        rows.append(["best focus", "needs defocus, mode 4, from at least two ranges"])
    else:
        rows += _error_rows(advice.session)
        rows += [
            [f"with {one.what}", _in_a_line(one.std)] for one in advice.session.remedies
        ]
    if advice.proposed_ranges_mm:
        proposal = Proposal(advice.proposed_ranges_mm, advice.proposed_std)
        rows.append([f"with {proposal.what}", _in_a_line(proposal.std)])
    told = f"to Noll {advice.determined_noll}, each to {DETERMINED_WAVES:g} waves or better"
    rows.append(
        ["modes", told if advice.determined_noll else f"none to {DETERMINED_WAVES:g} waves"]
    )
    if advice.frames is not None:
        rows.append(
            [
                "photographs",
                f"{advice.frames} for each range, so exposed, for the error wanted",
            ]
        )
    return rows


def _error_rows(session: Outlook) -> Rows:
    rows = []
    for key, std in session.std.items():
        name, unit = LENS_NUMBERS.get(key) or (f"best focus {key.partition('.')[2]}", " mm")
        stated = (
            f", stated ± {session.stated[key]:.2g}{unit}" if key in session.stated else ""
        )
        rows.append([name, f"± {std:.2g}{unit}{stated}"])
    return rows


def _in_a_line(std: Errors) -> str:
    return ", ".join(
        f"{name} ± {std[key]:.2g}{unit}" for key, (name, unit) in LENS_NUMBERS.items()
    )
