"""The messages that a user may meet, read from the code: errors, warnings and notes, each as a template with … for what varies.

`python -m docs.generators.messages` prints those that no page under docs/troubleshooting explains, and entries of messages
that are gone.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import labkit.errors

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "troubleshooting"

ERRORS = {name for name, value in vars(labkit.errors).items() if isinstance(value, type)} | {
    "problem",
    "not_allowed",
    "Takes",
    "matches",
}
"""What is raised with a message for a user."""

OTHERS = {"ValueError", "TypeError", "KeyError", "AttributeError", "NotImplementedError", "RuntimeError"}
"""What is raised for the author of a script."""

SILENT = (
    "labkit/__init__.py",
    "labkit/acquisition/log.py",
    "labkit/advice/outlook.py",
    "labkit/advice/tables.py",
    "labkit/cli/",
    "labkit/console.py",
    "labkit/demo.py",
    "labkit/devices/bluesky.py",
    "labkit/experiments/",
    "labkit/imaging/",
    "labkit/inference/",
    "labkit/optics/",
    "labkit/plan/fields.py",
    "labkit/report/",
    "labkit/results/tables.py",
    "labkit/session/describe.py",
    "labkit/session/draft_plan.py",
    "drivers/simulated/controllers/",
    "drivers/web/access.py",
    "drivers/web/monitor.py",
    "drivers/zaber/protocol.py",
)
"""Where only what is raised is a message: the rest is help, tables, units or pages."""

SPOKEN = ("words", "finding")
"""Attributes of parts of the camera that go into messages: their text is one wherever it is."""

FEWEST_WORDS = 4
"""Of what is not raised; what varies counts as one."""

WORD = re.compile(r"[A-Za-z]{2,}")
NO_PROSE = re.compile(
    r"^\S*$|\(\?|SUBSYSTEM|MODE=|\[camera\]\n|^unreachable|^#|^\[sensor|^pixels = \{|^numbers = |charset=|^Unexpected end"
)
"""Identifiers, patterns, and text that is written into files."""
SPAN = re.compile(r"(`+) ?(.+?) ?\1(?!`)")


@cache
def messages() -> tuple[str, ...]:
    """Every template, sorted."""
    paths = [path for folder in ("labkit", "drivers", "targets") for path in (ROOT / folder).rglob("*.py")]
    return tuple(sorted({text for path in paths for text in messages_of(path)}))


def explained() -> list[str]:
    """Every template that has an entry in the pages."""
    return sorted(text for page in PAGES.glob("*.md") for text in entries(page.read_text(encoding="utf-8")))


def entries(page: str) -> Iterator[str]:
    """The templates of a page: code in the lines above those that begin with a colon."""
    lines = page.splitlines()
    for line, following in pairwise(lines):
        if following.startswith(": "):
            yield from (found[2] for found in SPAN.finditer(line))


def messages_of(path: Path) -> Iterator[str]:
    """The templates in a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):  # an f-string's own pieces, and docstrings, are no messages by themselves
        for child in ast.iter_child_nodes(node):
            child.parent = node  # type: ignore[attr-defined]
    silent, spoken = path.relative_to(ROOT).as_posix().startswith(SILENT), _spoken(tree)
    for node in ast.walk(tree):
        text, quiet = template(node), silent and node not in spoken
        if text and not _is_part(node) and not NO_PROSE.search(text):
            callee = _callee(node)
            words = len(WORD.findall(text)) + ("…" in text)
            if (callee in ERRORS and words > 1) or (not quiet and callee not in OTHERS and words >= FEWEST_WORDS):
                yield " ".join(text.split())


def _spoken(tree: ast.AST) -> set[ast.AST]:
    """Everything within definitions of attributes that go into messages."""
    spoken = set[ast.AST]()
    for node in ast.walk(tree):
        name = getattr(node, "name", getattr(getattr(node, "target", None), "id", ""))
        if name in SPOKEN and isinstance(node, ast.FunctionDef | ast.AnnAssign):
            spoken |= {*ast.walk(node)}
    return spoken


def template(node: ast.AST) -> str | None:
    """A string with … for what varies; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return None


def _is_part(node: ast.AST) -> bool:
    """Whether a string is a docstring, a piece of an f-string, or a few words within one."""
    if isinstance(getattr(node, "parent", None), ast.JoinedStr | ast.Expr):
        return True
    few = isinstance(node, ast.Constant) and len(WORD.findall(str(node.value))) < 5
    return few and any(isinstance(outer, ast.FormattedValue) for outer in _around(node))


def _callee(node: ast.AST) -> str:
    """What is called with a string among its arguments, however deep; empty where nothing is."""
    for outer in _around(node):
        if isinstance(outer, ast.Call):
            name = getattr(outer.func, "id", getattr(outer.func, "attr", ""))
            if name in ERRORS | OTHERS:
                return str(name)
    return ""


def _around(node: ast.AST) -> Iterator[ast.AST]:
    """Its parents within the statement."""
    parent: ast.AST | None = getattr(node, "parent", None)
    while parent is not None and not isinstance(parent, ast.stmt):
        yield parent
        parent = getattr(parent, "parent", None)


if __name__ == "__main__":
    known, found = set(explained()), set(messages())
    print(*(f"no entry:  {text}" for text in sorted(found - known)), sep="\n")
    print(*(f"no more:   {text}" for text in sorted(known - found)), sep="\n")
