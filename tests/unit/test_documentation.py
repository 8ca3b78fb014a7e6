"""What the documentation is made of: every message explained, every key, column and option described, every link alive."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from docs.check_site import Index, Page, dead_links
from docs.generators import MADE, PLACE, filled
from docs.generators.commands import leaves
from docs.generators.messages import entries, explained, messages, messages_of
from docs.generators.plan_keys import keys, plan_keys
from labkit.advice.advise import advise
from labkit.advice.tables import range_rows
from labkit.plan import Plan
from tests.plans import SMALL, plan_text

ROOT = Path(__file__).parents[2]
PAGES = [path for path in sorted((ROOT / "docs").rglob("*.md")) if "build" not in path.parts]


def test_every_message_has_an_entry_in_troubleshooting() -> None:
    assert set(messages()) - set(explained()) == set(), "run: python -m docs.generators.messages"


def test_no_entry_in_troubleshooting_is_of_a_message_that_is_gone() -> None:
    assert set(explained()) - set(messages()) == set(), "run: python -m docs.generators.messages"


def test_messages_are_read_from_raises_warnings_and_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("docs.generators.messages.ROOT", tmp_path)
    code = '''"""A docstring is no message, however long."""
raise PlanError(f"lens {name!r} is unknown; known are {', '.join(known)}")
raise ValueError("an array of another shape than this")
notes.append(f"the photographs were taken at {a:g} mm, " f"not at {b:g}")
key = "focal_length_mm"
'''
    (tmp_path / "some.py").write_text(code)
    found = ["lens … is unknown; known are …", "the photographs were taken at … mm, not at …"]
    assert list(messages_of(tmp_path / "some.py")) == found


def test_entries_are_the_code_above_an_explanation() -> None:
    page = "Some `code` in a text.\n\n`one …` ``say `two` ``\n: What to do with `three`.\n"
    assert list(entries(page)) == ["one …", "say `two`"]


@pytest.mark.parametrize(("key", "field"), list(keys()))
def test_every_plan_key_says_what_it_is_and_what_it_takes(key: str, field: object) -> None:
    entry = plan_keys().partition(f"{{confval}} {key}\n")[2].partition(":::")[0]
    meaning, _, facts = entry.strip().partition("\n\n")
    assert re.fullmatch(r"[A-Z0-9`\"].{15,}[.]", meaning), key
    assert re.fullmatch(r"Allowed: .+\. Default: .+\.", facts), key


def test_every_option_and_argument_says_what_it_is() -> None:
    parameters = [(path, p) for path, command in leaves() for p in command.params if p.name != "help"]
    assert [f"{path} {p.name}" for path, p in parameters if not (p.help or "").endswith(".")] == []


def test_the_columns_of_advise_are_those_that_are_documented() -> None:
    heading, *rows = range_rows(advise(Plan.parse(plan_text(SMALL)), ranges_mm=[2000.0]))
    page = (ROOT / "docs" / "reference" / "advise.md").read_text(encoding="utf-8")
    documented = re.findall(r"^\| `(.+?)` \|", page.partition("## For the whole session")[0], re.MULTILINE)
    assert heading == documented
    assert [len(row) for row in rows] == [len(heading)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_pages_generated_places_are_known(page: Path) -> None:
    assert {place[1] for place in PLACE.finditer(page.read_text(encoding="utf-8"))} <= set(MADE)


def test_a_place_is_filled_and_the_text_around_it_stays() -> None:
    assert filled("before\n<!-- generated: panels -->\nafter").startswith("before\n| `display.panel` |")


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
    found = {"docnames": ["one", "two"], "terms": {"rail": [0, 1], "photograph": 1}, "titleterms": {"home": 0}}
    (tmp_path / "searchindex.js").write_text(f"Search.setIndex({json.dumps(found)})")
    index = Index(tmp_path)
    assert index.search("rails") == {"one", "two"}
    assert index.search("the rail's home") == {"one"}
    assert index.search("photographs of a rail") == {"two"}
