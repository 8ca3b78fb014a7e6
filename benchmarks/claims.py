"""Write the measured figures into README.md and docs/accuracy.md, from one file that tests read too."""

import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
CLAIMS: dict[str, list[dict[str, Any]]] = tomllib.loads(
    (ROOT / "benchmarks/claims.toml").read_text(encoding="utf-8")
)
BEGIN = "<!-- written by `make readme` from benchmarks/claims.toml -->\n"
END = "<!-- end -->\n"


def limit(claim: str, figure: str) -> float:
    """Return the limit of a claim's figure in tests. Raises KeyError for an unknown figure."""
    return float(_held(claim)["figures"][figure]["limit"])


def _held(claim: str) -> dict[str, Any]:
    return {entry["name"]: entry for entry in CLAIMS["held"]}[claim]


def headlines() -> str:
    """Return the README's table: figures that a reader understands without the method."""
    named = {
        claim["name"]: claim
        for claim in [*CLAIMS["held"], *CLAIMS["run"]]
        if "name" in claim
    }
    rows = [_cells(line, _figures(named[line["claim"]])) for line in CLAIMS["headline"]]
    return "\n".join(["| quantity | measured |", "|---|---|", *map(_row, rows), ""])


def tables() -> str:
    """Return both tables of docs/accuracy.md: figures that tests hold, and figures of longer commands."""
    held = [[*_cells(c, _figures(c)), *_sources(c)] for c in CLAIMS["held"]]
    run = [[*_cells(c, _figures(c)), *_sources(c)] for c in CLAIMS["run"]]
    return "\n".join(
        [
            "Tests hold these figures, with limits of at most twice the measured value:",
            "",
            "| case | measured | command | test |",
            "|---|---|---|---|",
            *map(_row, held),
            "",
            "Longer commands, on two cores, gave these figures; no test repeats them:",
            "",
            "| case | measured | command |",
            "|---|---|---|",
            *map(_row, run),
            "",
        ]
    )


def _cells(claim: Mapping[str, Any], figures: Mapping[str, float]) -> list[str]:
    return [claim["what"], claim["says"].format(**figures)]


def _sources(claim: Mapping[str, Any]) -> list[str]:
    return [f"`{claim[key]}`" for key in ("command", "test") if key in claim]


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _figures(claim: Mapping[str, Any]) -> dict[str, float]:
    """Return a claim's figures: as measured, or from the file that a study wrote."""
    figures: dict[str, Any] = claim.get("figures", {})
    if "test" in claim:
        return {name: figure["measured"] for name, figure in figures.items()}
    if "results" not in claim:
        return {}
    published = json.loads((ROOT / claim["results"]).read_text(encoding="utf-8"))["claims"]
    measured = {entry["what"]: entry["measured"] for entry in published}
    return {name: measured[what] for name, what in figures.items()}


PAGES: dict[str, Callable[[], str]] = {
    "README.md": headlines,
    "docs/accuracy.md": tables,
}


def rewritten(page: str, text: str) -> str:
    """Return a page of `PAGES` with its tables written anew. Raises ValueError for a page without marks."""
    before, began, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (began and ended):
        raise ValueError(
            f"{page} has no place for the tables, between {BEGIN.strip()} and {END.strip()}"
        )
    return before + began + PAGES[page]() + ended + after


def main() -> None:
    """Write the tables of all pages."""
    for page in PAGES:
        path = ROOT / page
        text = rewritten(page, path.read_text(encoding="utf-8"))
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
