"""The README and docs/accuracy.md state measured figures, and tests hold them."""

from typing import Any

import pytest

from benchmarks.claims import CLAIMS, PAGES, ROOT, headlines, rewritten


@pytest.mark.parametrize("page", PAGES)
def test_a_pages_tables_are_as_the_command_writes_them(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert text == rewritten(page, text), "run: make readme"


def test_the_readmes_table_has_eight_lines_at_most() -> None:
    assert 2 < len(headlines().splitlines()) <= 2 + 8


@pytest.mark.parametrize("claim", CLAIMS["held"], ids=lambda claim: claim["name"])
def test_a_claims_test_holds_each_of_its_figures_within_a_factor_of_two(
    claim: dict[str, Any],
) -> None:
    source = (ROOT / claim["test"]).read_text(encoding="utf-8")
    assert f'"{claim["name"]}"' in source
    for name, figure in claim["figures"].items():
        assert figure["measured"] < figure["limit"] <= 2 * figure["measured"], name
        assert f'"{name}"' in source or "for name in figures" in source, (
            f"{claim['test']} does not hold {name}"
        )


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="no place for the tables"):
        rewritten("README.md", "# labkit\n")
