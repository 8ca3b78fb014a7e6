"""What the documentation is made of: every key, column and option described, every link alive."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from docs.check_site import Index, Page, dead_links
from docs.generators import MADE, PLACE, filled
from docs.generators.api import _text
from docs.generators.commands import leaves
from docs.generators.plan_keys import keys, plan_keys
from labkit.advice.advise import advise
from labkit.advice.tables import range_rows
from labkit.plan import Plan
from tests.plans import SMALL, plan_text

ROOT = Path(__file__).parents[2]
PAGES = [
    path for path in sorted((ROOT / "docs").rglob("*.md")) if "build" not in path.parts
]


@pytest.mark.parametrize(("key", "field"), list(keys()))
def test_every_plan_key_says_what_it_is_and_what_it_takes(key: str, field: object) -> None:
    entry = plan_keys().partition(f"{{confval}} {key}\n")[2].partition(":::")[0]
    meaning, _, facts = entry.strip().partition("\n\n")
    assert re.fullmatch(r"[A-Z0-9`\"].{15,}[.]", meaning), key
    assert re.fullmatch(r"Allowed: .+\. Default: .+\.", facts), key


@pytest.mark.parametrize("page", ["docs/reference/glossary.md", "CONTRIBUTING.md"])
def test_files_that_a_page_names_are_there(page: str) -> None:
    named = re.findall(r"`((?:\w+/)+\w+\.py)`", (ROOT / page).read_text(encoding="utf-8"))
    assert len(named) > 3
    assert [
        name
        for name in named
        if not any((ROOT / folder / name).exists() for folder in ("", "labkit"))
    ] == []


def test_a_docstring_in_numpys_form_is_shown_as_lists() -> None:
    made = _text("""Rays.

    Parameters
    ----------
    n : refractive index

    Raises
    ------
    ValueError
        `n` is below 1.

    >>> rays(1.5)
    """)
    parameters, errors = (
        "**Parameters**\n\n- n : refractive index\n",
        "**Raises**\n\n- ValueError\n    `n` is below 1.\n",
    )
    assert made == f"Rays.\n\n{parameters}\n{errors}\n```python\n>>> rays(1.5)\n```"


def test_every_option_and_argument_says_what_it_is() -> None:
    parameters = [
        (path, p) for path, command in leaves() for p in command.params if p.name != "help"
    ]
    assert [
        f"{path} {p.name}" for path, p in parameters if not (p.help or "").endswith(".")
    ] == []


def test_the_columns_of_advise_are_those_that_are_documented() -> None:
    heading, *rows = range_rows(advise(Plan.parse(plan_text(SMALL)), ranges_mm=[2000.0]))
    page = (ROOT / "docs" / "reference" / "advise.md").read_text(encoding="utf-8")
    documented = re.findall(
        r"^\| `(.+?)` \|", page.partition("## For the whole session")[0], re.MULTILINE
    )
    assert heading == documented
    assert [len(row) for row in rows] == [len(heading)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_pages_generated_places_are_known(page: Path) -> None:
    assert {place[1] for place in PLACE.finditer(page.read_text(encoding="utf-8"))} <= set(
        MADE
    )


def test_a_place_is_filled_and_the_text_around_it_stays() -> None:
    assert filled("before\n<!-- generated: panels -->\nafter").startswith(
        "before\n| `display.panel` |"
    )


def test_dead_links_and_what_is_fetched_from_elsewhere_are_found(tmp_path: Path) -> None:
    links = '<a href="b.html#here">1</a><a href="b.html#gone">2</a><a href="c.html">3</a><a href="https://x.org">4</a>'
    (tmp_path / "a.html").write_text(f'{links}<script src="https://cdn.org/x.js"></script>')
    (tmp_path / "b.html").write_text('<p id="here">')
    assert sorted(dead_links(tmp_path)) == [
        "a.html: b.html#gone has no such anchor",
        "a.html: c.html is not there",
        "a.html: loads https://cdn.org/x.js",
    ]
    assert Page('<a href="#x">').links == ["#x"]


def test_the_search_wants_every_word(tmp_path: Path) -> None:
    pytest.importorskip("sphinx")
    found = {
        "docnames": ["one", "two"],
        "terms": {"rail": [0, 1], "photograph": 1},
        "titleterms": {"home": 0},
    }
    (tmp_path / "searchindex.js").write_text(f"Search.setIndex({json.dumps(found)})")
    index = Index(tmp_path)
    assert index.search("rails") == {"one", "two"}
    assert index.search("the rail's home") == {"one"}
    assert index.search("photographs of a rail") == {"two"}
