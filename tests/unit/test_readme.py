"""The README says what was measured, and tests hold it."""

from typing import Any

import pytest

from benchmarks.claims import CLAIMS, ROOT, rewritten


def test_the_readmes_tables_are_those_that_the_command_writes() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme == rewritten(readme), "run: make readme"


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


def test_a_readme_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="no place for the tables"):
        rewritten("# labkit\n")
