"""Results as tables: rows of text for a terminal, HTML for a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from labkit.results.model import Focus, Wavefront
from labkit.uncertain import Uncertain

Rows = list[list[str]]


def wavefront_rows(wavefronts: Sequence[Wavefront], reference_wavelength_nm: float) -> Rows:
    """A heading, and a row for each range and channel: defocus, RMS of all modes, how well the model fits."""
    waves = f"waves at {reference_wavelength_nm:g} nm"
    rows = [["range/mm", "channel", f"defocus/{waves}", "RMS, all modes", "χ²/pixel", "optimum"]]
    for w in wavefronts:
        defocus = "not fitted" if w.defocus is None else _signed(w.defocus)
        range_mm = "" if w.range_mm is None else f"{w.range_mm:g}"
        rows.append([range_mm, w.channel, defocus, f"{w.rms().value:.4f}", f"{w.chi2_per_pixel:.3f}", _verdict(w)])
    return rows


def focus_rows(focus: Focus | None) -> Rows:
    """A heading, best focus of each channel, and the pupil magnification; one row that says so if there are none."""
    if focus is None:
        return [["best focus: not fitted, see the warnings"]]
    rows = [["quantity", "estimate"]]
    rows += [[f"best focus {channel}", str(best)] for channel, best in focus.best_focus_mm.items()]
    note = "" if focus.identifiable else " (these ranges do not determine it)"
    rows.append(["pupil magnification", f"{focus.pupil_magnification}{note}"])
    return rows


def as_html(title: str, *tables: Rows) -> str:
    """Tables under a title, for a notebook."""
    return f"<p><b>{escape(title)}</b></p>" + "".join(map(_table, tables))


def _signed(value: Uncertain) -> str:
    return f"{value.value:+.4f} ± {value.std:.4f}"


def _verdict(w: Wavefront) -> str:
    if w.test is None:
        return "untested"
    return "accepted" if w.test.accepted else "REJECTED"


def _table(rows: Rows) -> str:
    head, *body = rows
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in body)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{lines}</tbody></table>"
