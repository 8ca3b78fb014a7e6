"""Complete studies, channels, panels and kinds of target for the tab key, without slow imports."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path

import typer


def studies(incomplete: str) -> list[str]:
    """Return the names of studies."""
    from labkit.experiments.studies import STUDIES

    return _begin(incomplete, STUDIES)


def panels(incomplete: str) -> list[str]:
    """Return the names of known panels."""
    from labkit.panel.panels import PANELS

    return _begin(incomplete, PANELS)


def targets(incomplete: str) -> list[str]:
    """Return kinds of target, and plans in the folder."""
    from importlib.metadata import entry_points

    kinds = (f"{entry.name}:" for entry in entry_points(group="labkit.targets"))
    return _begin(incomplete, [*kinds, *map(str, Path().glob("*.toml"))])


def channels(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the channels of the session on the command line; the usual ones without a session."""
    session = ctx.params.get("session") or next(
        iter(ctx.args), ""
    )  # a line that is not complete has it left over
    try:
        plan = tomllib.loads((Path(session) / "plan.toml").read_text(encoding="utf-8"))
        names = [str(channel["name"]) for channel in plan["channel"]]
    except (KeyError, TypeError, OSError, ValueError):
        names = ["R", "G", "B"]
    return _begin(incomplete, names)


def _begin(incomplete: str, words: Iterable[str]) -> list[str]:
    return sorted(word for word in words if word.startswith(incomplete))
