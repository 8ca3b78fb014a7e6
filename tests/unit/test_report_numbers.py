"""No number in a report's tables without its error or the reason why it has none: the page as it is rendered is walked."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.report.html import write_report
from labkit.results import OptimumTest, OtherOptimum, ResidualSpectrum
from labkit.results.model import PartTried
from labkit.uncertain import Uncertain
from tests.results_samples import a_wavefront, written

# a number by itself: not one in a name ("2nd", "target_3000.dng", "RMS2"), nor the exponent of a unit
NUMBER = re.compile(r"(?<![\w.])[-−+]?\d+(?:\.\d+)?(?![\w])")
WITH_ERROR = re.compile(r"\d ± \d|not determined|error unknown")


@dataclass
class Cell:
    text: str = ""
    marks: list[str] = field(default_factory=list)
    exact: bool = False


class Tables(HTMLParser):
    """Of each table its rows of cells, the first of them the heading, and the notes that stand below it."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tables: list[list[list[Cell]]] = []
        self.notes: list[str] = []
        self._cell: Cell | None = None
        self._mark = self._in_notes = self._exact_row = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        exact = "exact" in (dict(attrs).get("class") or "").split()
        if tag == "table":
            self.tables.append([])
            self.notes.append("")
        elif tag == "tr":
            self.tables[-1].append([])
            self._exact_row = exact
        elif tag in ("td", "th"):
            self._cell = Cell(exact=exact or self._exact_row)
            self.tables[-1][-1].append(self._cell)
        elif tag == "sup":
            self._mark = True
        elif tag == "p":
            self._in_notes = dict(attrs).get("class") == "notes"

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._cell = None
        elif tag == "sup":
            self._mark = False
        elif tag == "p":
            self._in_notes = False

    def handle_data(self, data: str) -> None:
        data = data.replace("\N{NO-BREAK SPACE}", " ")
        if self._in_notes:
            self.notes[-1] += f"[{data}]" if self._mark else data
        elif self._cell is not None and self._mark:
            self._cell.marks.append(data)
        elif self._cell is not None:
            self._cell.text += data


def bare_numbers(html: str) -> list[str]:
    """Cells with a number that has no error, in a column and a row whose heading gives no reason."""
    found, page = [], Tables(html)
    for rows, notes in zip(page.tables, page.notes, strict=True):
        heading = rows[0]
        reasons = set(re.findall(r"\[(\w)\] \S", notes))
        for row in rows[1:]:
            for k, cell in enumerate(row):
                why = [
                    *row[0].marks,
                    *(heading[k].marks if len(heading) == len(row) else []),
                    *cell.marks,
                ]
                if (
                    NUMBER.search(cell.text)
                    and not WITH_ERROR.search(cell.text)
                    and not cell.exact
                    and not (len(heading) == len(row) and heading[k].exact)
                    and not set(why) & reasons
                ):
                    found.append(
                        f"{row[0].text.strip()} | {heading[min(k, len(heading) - 1)].text}: {cell.text}"
                    )
    return found


SPECTRUM = ResidualSpectrum(np.linspace(0.02, 0.5, 12), np.ones(12), 2 * np.ones(12))
DOUBTFUL = OptimumTest(
    "starts",
    False,
    0.001,
    4,
    ("astigmatism",),
    (OtherOptimum(np.zeros(3), 41.0),),
    explains=False,
)


def spread(**changed: Any) -> tuple[Any, ...]:
    """Fits whose modes differ from range to range."""
    return tuple(
        a_wavefront(
            r,
            c,
            d,
            waves=np.array([d, 0.03 + 1e-6 * r, -0.04]),
            residual_spectrum=SPECTRUM,
            test=DOUBTFUL,
            **changed,
        )
        for r, d in ((3000.0, 0.08), (3200.0, 1.14))
        for c in ("R", "B")
    )


CASES: dict[str, dict[str, Any]] = {
    "a session with its lens": {},
    "without a lens": {"lens": None, "budget": {}},
    "without best focus": {"focus": None, "lens": None, "budget": {}},
    "without ranges": {
        "wavefronts": (a_wavefront(None, "R"),),
        "focus": None,
        "lens": None,
        "budget": {},
    },
    "fits by themselves": {"wavefronts": spread(), "lens": None},
    "errors unknown": {
        "wavefronts": spread(covariance=np.full((3, 3), np.nan), f_number_std=np.nan),
        "lens": None,
    },
    "a camera's parts": {
        "model_parts": {
            "low_pass_filter.rows_px": Uncertain(0.55, 0.004, "px"),
            "veil.share": Uncertain(0.01),
        },
        "parts_tried": (
            PartTried("low_pass_filter", 812.3, True),
            PartTried("veil", 0.0, False),
        ),
        "widest_light_nm": {"R": 20.0, "B": 17.0},
    },
}


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are walked: their sections are there, and figures, which take most of the time, are not drawn."""
    monkeypatch.setattr(
        "labkit.report.html.draw_figures", lambda *_: {"fits": [], "place": []}
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_each_number_of_a_table_has_its_error_or_the_reason_why_it_has_none(
    tmp_path: Path, case: str
) -> None:
    html = write_report(written(tmp_path, **CASES[case])).read_text()
    assert len(Tables(html).tables) >= 8
    assert bare_numbers(html) == []


@pytest.mark.slow
def test_no_error_is_printed_as_nothing(tmp_path: Path) -> None:
    small = a_wavefront(covariance=np.diag([1e-14, 1e-13, 1e-12]), f_number_std=1e-9)
    html = write_report(written(tmp_path, wavefronts=(small,), focus=None)).read_text()
    assert not re.findall(r"±\N{NO-BREAK SPACE}0(?:\.0+)?(?!\d|\.)", html)


def test_a_bare_number_would_be_found() -> None:
    table = "<table><tr><th>mode</th><th>waves</th></tr><tr><td>coma</td><td>0.03</td></tr></table>"
    assert bare_numbers(table) == ["coma | waves: 0.03"]
    marked = table.replace("waves", "waves<sup>a</sup>")
    assert bare_numbers(marked) == ["coma | waves: 0.03"]
    assert (
        bare_numbers(
            f"{marked}<p class=notes>Without an error: <sup>a</sup>\N{NO-BREAK SPACE}stated.</p>"
        )
        == []
    )
