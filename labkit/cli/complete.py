"""What the tab key completes: studies, channels, panels, kinds of target. Nothing heavy is imported for it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path

import typer


def studies(incomplete: str) -> list[str]:
    """Names of studies."""
    from labkit.experiments.studies import STUDIES

    return _begin(incomplete, STUDIES)


def panels(incomplete: str) -> list[str]:
    """Names of panels that a display may have."""
    from labkit.devices.panels import PANELS

    return _begin(incomplete, PANELS)


def targets(incomplete: str) -> list[str]:
    """Kinds of target, and plans in the folder."""
    from importlib.metadata import entry_points

    kinds = (f"{entry.name}:" for entry in entry_points(group="labkit.targets"))
    return _begin(incomplete, [*kinds, *map(str, Path().glob("*.toml"))])


def channels(ctx: typer.Context, incomplete: str) -> list[str]:
    """Channels of the session that was given; the usual ones where there is none to read."""
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
