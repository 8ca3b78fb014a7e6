"""Ask the user questions, one by one at a terminal, or read the answers from piped input."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

from labkit.cli.console import print_line
from labkit.devices.operator import forget_typed
from labkit.errors import InputError

Value = TypeVar("Value")


def at_terminal() -> bool:
    """Return whether somebody can be asked again."""
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def ask(question: str, default: str = "") -> str:
    """Return the trimmed answer, or the default for an empty one.

    Characters typed before the question are dropped. Raises InputError at the end of the
    input.
    """
    terminal = at_terminal()
    if terminal:
        forget_typed(sys.stdin)
    print_line(f"{question}{f' [{default}]' if default else ''}: ", end="", file=sys.stderr)
    line = sys.stdin.readline() if sys.stdin is not None and not sys.stdin.closed else ""
    if not (terminal and line.endswith("\n")):
        print_line("", file=sys.stderr)
    if not line:
        raise InputError(f"the input ended at the question: {question}")
    return line.strip() or default


def ask_until(question: str, read: Callable[[str], Value], default: str = "") -> Value:
    """Return the answer after `read`; at a terminal ask again when `read` raises InputError.

    Raises the error if answers are piped in, because the next line answers the next
    question.
    """
    while True:
        try:
            return read(ask(question, default))
        except InputError as error:
            if not at_terminal() or str(error).startswith("the input ended"):
                raise
            print_line(f"  {error}", file=sys.stderr)
