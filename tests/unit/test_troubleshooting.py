"""Troubleshooting shows whole messages, each as the code makes it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODES = [ROOT / name for name in ("labkit", "drivers", "targets")]
PAGES = sorted((ROOT / "docs" / "troubleshooting").glob("*.md"))

CODE = re.compile(r"``(?P<ticks>.+?)``(?!`)|`(?P<plain>[^`]+)`")

HOLE = re.compile(r"\{[^{}]*\}")
"""Where a template that is no f-string takes a value."""

LEAST_LETTERS = 5
"""Of a template: shorter ones, such as "{path}: {error}", occur in any message."""

SOME_LETTERS, MANY_LETTERS = 9, 14
"""Of a template whose last or first value may be any words; the last value of a shorter one ends with a semicolon."""

SUBJECT = re.compile(
    r"(plan )?[^\s:]+: (line \d+: |[\w.]+(: | ))?|box [\d,]+, |the GRBL rail at \S+ "
)
"""What a message is about, which is put before the message: files, a box, a rail."""


@dataclass(frozen=True)
class Template:
    """A message in the code: its texts, between which values stand."""

    texts: tuple[str, ...]

    @property
    def letters(self) -> int:
        return len(re.findall("[A-Za-z]", "".join(self.texts)))

    @property
    def longest(self) -> str:
        return max(self.texts, key=len)

    def span(self, message: str) -> tuple[int, int]:
        """Return the part of a message that the template makes; an empty one where it makes none."""
        if self.longest not in message:
            return 0, 0
        found = re.search(".*?".join(map(re.escape, self.texts)), message, re.DOTALL)
        if found is None:
            return 0, 0
        begins, ends = found.span()
        if not self.texts[0] and self.letters >= MANY_LETTERS:
            begins = 0
        if not self.texts[-1]:
            after = message.find("; ", ends) if self.letters < SOME_LETTERS else -1
            ends = len(message) if after < 0 else after
        return begins, ends


def constants(code: ast.Module) -> dict[str, object]:
    """Return the numbers and texts that a module names, such as limits."""
    named: dict[str, object] = {}
    for node in code.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            with suppress(ValueError):
                named[node.targets[0].id] = ast.literal_eval(node.value)
    return named


def texts_of(node: ast.AST, named: Mapping[str, object]) -> tuple[str, ...]:
    """Return the texts of a string or f-string in the code; a module's constants are text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return tuple(HOLE.split(node.value))
    texts = [""]
    for part in node.values if isinstance(node, ast.JoinedStr) else ():
        if isinstance(part, ast.Constant):
            texts[-1] += str(part.value)
        elif isinstance(part, ast.FormattedValue):
            known = named.get(ast.unparse(part.value))
            if known is None:
                texts.append("")
            else:
                spec = part.format_spec
                texts[-1] += format(known, texts_of(spec, {})[0] if spec else "")
    return tuple(texts)


@cache
def templates() -> tuple[Template, ...]:
    """All messages in the code that have some letters."""
    every = set()
    for path in (path for folder in CODES for path in folder.rglob("*.py")):
        code = ast.parse(path.read_text(encoding="utf-8"))
        named = constants(code)
        for node in ast.walk(code):
            template = Template(texts_of(node, named))
            if template.letters >= LEAST_LETTERS:
                every.add(template)
    return tuple(every)


def uncovered(message: str) -> str:
    """Return what of a message no template makes; values are part of their template."""
    made = [False] * len(message)
    if subject := SUBJECT.match(message):
        made[: subject.end()] = [True] * subject.end()
    for template in templates():
        begins, ends = template.span(message)
        made[begins:ends] = [True] * (ends - begins)
    left = [letter for letter, known in zip(message, made, strict=True) if not known]
    return "".join(left).strip(" ;,.:()")


def entries(page: Path) -> Iterator[str]:
    """Yield the messages that a page explains, codes of findings left out."""
    for line, following in pairwise(page.read_text(encoding="utf-8").splitlines()):
        if following.startswith(": ") and line.startswith("`"):
            for found in CODE.finditer(line):
                message = found["ticks"] or found["plain"]
                if " " in message:
                    yield message


def test_hundreds_of_messages_are_explained() -> None:
    assert sum(len(list(entries(page))) for page in PAGES) > 500


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_messages_are_whole(page: Path) -> None:
    verbs = ("is ", "has ", "holds ", "declares ", "contradicts ", "was ", "reports ")
    cut = [
        message
        for message in entries(page)
        if "…" in message or message.startswith((*verbs, ";", ",", "("))
    ]
    assert cut == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_messages_are_those_of_the_code(page: Path) -> None:
    left = {message: uncovered(message) for message in entries(page)}
    assert {message: words for message, words in left.items() if words} == {}


@pytest.mark.parametrize(
    ("message", "left"),
    [
        ("plan bench.toml: not UTF-8 at byte 173", ""),
        ("the session is of another moon", "moon"),
        ("[target] order = 9: a Sierpinski carpet has an order of 1 to 7", "97"),
    ],
)
def test_a_message_that_the_code_does_not_make_is_found(message: str, left: str) -> None:
    assert uncovered(message) == left
