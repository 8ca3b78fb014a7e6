"""Checks the site that `make docs` built: no dead link, nothing fetched from elsewhere, search finds all that is named."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import labkit
from docs.generators.commands import leaves
from docs.generators.plan_keys import keys
from labkit.findings.texts import TEXTS

WORD = re.compile(r"\w+")


class Page(HTMLParser):
    """A page's anchors, its links, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element has of these."""
        given = dict(attrs)
        self.anchors.update(
            value for key, value in attrs if key in ("id", "name") and value
        )
        place = given.get("href") or given.get("src")
        if place:
            (self.links if tag == "a" else self.loaded).append(place)


def dead_links(site: Path) -> Iterator[str]:
    """Links to files or anchors that are not there, and files that a page would load from elsewhere."""
    pages = {
        path: Page(path.read_text(encoding="utf-8"))
        for path in sorted(site.rglob("*.html"))
    }
    for path, page in pages.items():
        where = path.relative_to(site)
        yield from (
            f"{where}: loads {place}" for place in page.loaded if urlsplit(place).netloc
        )
        for place in (*page.links, *page.loaded):
            parts = urlsplit(place)
            if parts.scheme or parts.netloc:
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not file.is_file():
                yield f"{where}: {place} is not there"
            elif (
                parts.fragment
                and file in pages
                and unquote(parts.fragment) not in pages[file].anchors
            ):
                yield f"{where}: {place} has no such anchor"


class Index:
    """What the site's search finds: documents by word, as its own script looks them up."""

    def __init__(self, site: Path) -> None:
        from sphinx.search.en import SearchEnglish

        text = (site / "searchindex.js").read_text(encoding="utf-8")
        found = json.loads(text.removeprefix("Search.setIndex(").rstrip(");\n"))
        self.pages: list[str] = found["docnames"]
        self.stemmer = SearchEnglish({})
        self.words: dict[str, set[int]] = {}
        for table in (found["terms"], found["titleterms"]):
            for word, pages in table.items():
                self.words.setdefault(word, set()).update(
                    [pages] if isinstance(pages, int) else pages
                )

    def search(self, query: str) -> set[str]:
        """Pages that hold every word of a query."""
        pages = set(range(len(self.pages)))
        for word in WORD.findall(query.lower()):
            if word not in self.stemmer.stopwords and len(word) > 1 and not word.isdigit():
                pages &= self.words.get(self.stemmer.stem(word), set()) | self.words.get(
                    word, set()
                )
        return {self.pages[page] for page in pages}


def not_found(index: Index) -> Iterator[str]:
    """Public names, plan keys, commands and codes of findings that a search for them does not lead to."""
    wanted = [
        ("reference/api", f"labkit.{name}")
        for name in labkit.__all__
        if name != "__version__"
    ]
    wanted += [("reference/plan", key) for key, _ in keys()]
    wanted += [("reference/commands", path) for path, _ in leaves()]
    wanted += [("troubleshooting/", code) for code in TEXTS]
    for place, query in wanted:
        if not any(page.startswith(place) for page in index.search(query)):
            yield f"a search for {query!r} does not find {place}"


def main(site: Path) -> int:
    """Print what is wrong; returns the exit status."""
    problems = [*dead_links(site), *not_found(Index(site))]
    print(*problems, sep="\n", end="\n" if problems else "")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve()))
