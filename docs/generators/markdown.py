"""Markdown, as the generators write it."""

from __future__ import annotations

from collections.abc import Sequence


def table(rows: Sequence[Sequence[str]]) -> str:
    """A heading and rows."""
    heading, *body = rows
    lines = [heading, ["---"] * len(heading), *body]
    return (
        "\n".join(f"| {' | '.join(_cell(cell) for cell in line)} |" for line in lines)
        + "\n"
    )


def directive(
    name: str,
    argument: str,
    body: str,
    options: dict[str, str] | None = None,
    depth: int = 3,
) -> str:
    """A directive with its options; depth: colons of its fence, more than those of what stands in it."""
    fence = ":" * depth
    given = [f":{key}: {value}".rstrip() for key, value in (options or {}).items()]
    return "\n".join(
        [
            f"{fence}{{{name}}} {argument}".rstrip(),
            *given,
            *([""] if given else []),
            body.strip(),
            fence,
            "",
        ]
    )


def code(text: str) -> str:
    """As code within a line, backticks and all."""
    return f"`` {text} ``" if "`" in text else f"`{text}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
