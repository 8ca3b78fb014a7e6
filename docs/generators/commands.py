"""Every command with its arguments and options, from the command line itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer

from docs.generators.markdown import code, directive
from labkit.cli.app import app
from labkit.cli.command_line import load_commands

load_commands()


def commands() -> str:
    """A section for each command."""
    root = typer.main.get_command(app)
    parts = [
        _options("labkit", root),
        *(_section(path, command) for path, command in leaves()),
    ]
    return "\n".join(parts)


def leaves() -> Iterator[tuple[str, Any]]:
    """Each command that does something, by what one types, such as "labkit target render"."""
    yield from _leaves("labkit", typer.main.get_command(app))


def _leaves(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, inner in command.commands.items():
        yield from _leaves(f"{path} {name}", inner)


def _section(path: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    words = [p.metavar if p.required else f"[{p.metavar.strip('[]')}]" for p in arguments]
    usage = " ".join([path, *words, "[OPTIONS]"])
    lines = [
        f"## {code(path)}",
        "",
        f"```text\n{usage}\n```",
        "",
        " ".join((command.help or "").split()),
        "",
    ]
    lines += [f"- {code(p.metavar.strip('[]'))}: {p.help}{_default(p)}" for p in arguments]
    return "\n".join([*lines, "", _options(path, command)])


def _options(path: str, command: Any) -> str:
    options = [p for p in command.params if p.param_type_name == "option"]
    parts = [directive("program", path, "")]
    for option in options:
        value = "" if option.is_flag else f" {option.metavar or option.name.upper()}"
        parts.append(
            directive(
                "option",
                f"{', '.join(option.opts)}{value}",
                f"{option.help or ''}{_default(option)}",
            )
        )
    return "\n".join(parts)


def _default(option: Any) -> str:
    default = option.default
    shown = option.show_default if isinstance(option.show_default, str) else default
    if shown is None or isinstance(shown, bool) or callable(shown):
        return ""
    return f" Default: {shown if shown is option.show_default else code(str(shown))}."
