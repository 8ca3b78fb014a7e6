"""The README's figures: where they are kept, which tests hold them, and the tables made of them."""

import json
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
CLAIMS: dict[str, list[dict[str, Any]]] = tomllib.loads(
    (ROOT / "benchmarks/claims.toml").read_text(encoding="utf-8")
)
BEGIN, END = (
    "<!-- written by `make readme` from benchmarks/claims.toml -->\n",
    "<!-- end -->\n",
)


def limit(claim: str, figure: str) -> float:
    """What a test allows a figure of a claim to be. Raises KeyError for one that is not held."""
    return float(_held(claim)["figures"][figure]["limit"])


def _held(claim: str) -> dict[str, Any]:
    return {entry["name"]: entry for entry in CLAIMS["held"]}[claim]


def tables() -> str:
    """Both tables of the README, in Markdown."""
    held = [
        _row(c, {k: f["measured"] for k, f in c["figures"].items()}, f"[test]({c['test']})")
        for c in CLAIMS["held"]
    ]
    run = [_row(c, _published(c), "") for c in CLAIMS["run"]]
    return "\n".join(
        [
            "Held by tests, whose limits are at most twice these figures:",
            "",
            "| what | measured | command | held by |",
            "|---|---|---|---|",
            *held,
            "",
            "By longer commands, on two cores, which no test repeats:",
            "",
            "| what | measured | command |",
            "|---|---|---|",
            *(row.removesuffix("  |") for row in run),
            "",
        ]
    )


def _row(claim: dict[str, Any], figures: dict[str, float], test: str) -> str:
    return f"| {claim['what']} | {claim['says'].format(**figures)} | `{claim['command']}` | {test} |"


def _published(claim: dict[str, Any]) -> dict[str, float]:
    """Figures of a study, out of the file that it wrote."""
    if "results" not in claim:
        return {}
    published = json.loads((ROOT / claim["results"]).read_text(encoding="utf-8"))["claims"]
    measured = {entry["what"]: entry["measured"] for entry in published}
    return {name: measured[what] for name, what in claim["figures"].items()}


def rewritten(readme: str) -> str:
    """A README with its tables as they should be. Raises ValueError where their place is not marked."""
    before, began, rest = readme.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (began and ended):
        raise ValueError(
            f"README.md has no place for the tables, between {BEGIN.strip()} and {END.strip()}"
        )
    return before + began + tables() + ended + after


def main() -> None:
    """Write the README's tables."""
    path = ROOT / "README.md"
    path.write_text(rewritten(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
