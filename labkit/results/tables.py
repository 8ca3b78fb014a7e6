"""Results as tables: rows of text for a terminal, HTML for a notebook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import sqrt

from labkit.results.model import Focus, Lens, PartTried, Wavefront
from labkit.uncertain import Uncertain, decimals

Rows = list[list[str]]


def wavefront_rows(wavefronts: Sequence[Wavefront], reference_wavelength_nm: float) -> Rows:
    """A heading, and a row for each range and channel: defocus, RMS of all modes, how well the model fits."""
    waves = f"waves at {reference_wavelength_nm:g} nm"
    rows = [
        ["range/mm", "channel", f"defocus/{waves}", "RMS, all modes", "χ²/pixel", "optimum"]
    ]
    for w in wavefronts:
        defocus = "not fitted" if w.defocus is None else _signed(w.defocus)
        range_mm = "" if w.range_mm is None else f"{w.range_mm:g}"
        rows.append(
            [
                range_mm,
                w.channel,
                defocus,
                _to_error(w.rms()),
                f"{w.chi2_per_pixel:.3f}",
                _verdict(w),
            ]
        )
    return rows


def focus_rows(focus: Focus | None, lens: Lens | None = None) -> Rows:
    """A heading, best focus of each channel, and the lens; one row that says so if there is no focus."""
    if focus is None:
        return [["best focus: not fitted, see the warnings"]]
    rows = [["quantity", "estimate"]]
    rows += [
        [f"best focus {channel}", str(best)]
        for channel, best in focus.best_focus_mm.items()
    ]
    note = "" if focus.identifiable else " (these ranges do not determine it)"
    rows.append(["pupil magnification", f"{focus.pupil_magnification}{note}"])
    if lens is not None:
        rows.append(["focal length", str(lens.focal_length)])
        rows.append(["f-number at infinity", str(lens.f_number)])
        rows.append(["true ranges less stated", str(lens.range_zero)])
    return rows


def budget_rows(budget: Mapping[str, Mapping[str, float]]) -> Rows:
    """A heading, and a row for each number: its standard error by source, and the whole."""
    sources = list(dict.fromkeys(source for shares in budget.values() for source in shares))
    rows = [["standard error of", *sources, "all"]]
    for name, shares in budget.items():
        whole = sqrt(sum(share**2 for share in shares.values()))
        digits = decimals(whole)
        rows.append(
            [
                name,
                *(f"{shares.get(source, 0.0):.{digits}f}" for source in sources),
                f"{whole:.{digits}f}",
            ]
        )
    return rows


def part_rows(tried: Sequence[PartTried]) -> Rows:
    """Return a heading and a row for each part and group of modes that was tested for; empty if none was."""
    rows = [
        [p.name.replace("_", " "), f"{p.gain:.1f}", "taken in" if p.adopted else ""]
        for p in tried
    ]
    return [["part of the camera", "log-likelihood gained", ""], *rows] if rows else []


def as_html(title: str, tables: Sequence[Rows], warnings: Sequence[str]) -> str:
    """Tables and warnings under a title, for a notebook."""
    html = f"<p><b>{escape(title)}</b></p>" + "".join(map(_table, tables))
    if not warnings:
        return html
    items = "".join(f"<li>{escape(warning)}</li>" for warning in warnings)
    return f"{html}<p><b>Warnings</b></p><ul>{items}</ul>"


def _signed(value: Uncertain) -> str:
    """With its sign, to the digits of its error: never ± 0.0000."""
    return ("" if value.value < 0 else "+") + _to_error(value)


def _to_error(value: Uncertain) -> str:
    return str(Uncertain(value.value, value.std))  # its unit stands in the heading


def _verdict(w: Wavefront) -> str:
    if w.test is None:
        return "untested"
    return "accepted" if w.test.accepted else "REJECTED"


def _table(rows: Rows) -> str:
    head, *body = rows
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in body
    )
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{lines}</tbody></table>"
