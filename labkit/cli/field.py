"""The command for one session's field: field show."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labkit.cli.app import SessionPath, a_session, channels, field_app
from labkit.cli.console import Console

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


@field_app.command()
def show(
    ctx: typer.Context,
    session: SessionPath,
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Name of the results.")
    ] = "latest",
    channel: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Channel of the points, curves and limits.",
            show_default="G, or the first",
            autocompletion=channels,
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="File for MTF and focus against image height, and MTF through focus.",
            show_default="none is written",
        ),
    ] = None,
) -> None:
    """Show the lens over the frame. Tilt, curvature, coma, MTF, distortion, lateral colour, light, screws, tiles, limits."""
    a_session(session)
    from labkit.field import tables
    from labkit.field.summary import summarise_field
    from labkit.results import Results
    from labkit.storage.files import write_atomically

    console: Console = ctx.obj
    summary = summarise_field(Results.load(session, name), channel)
    console.warn(*summary.notes)
    console.say(tables.headline(summary))
    console.say(tables.coverage(summary.covered))
    if summary.camera_tilt is not None:
        console.say(summary.camera_tilt.words)
    for rows in (
        tables.term_rows(summary),
        tables.significance_rows(summary),
        tables.point_rows(summary),
        tables.best_rows(summary),
    ):
        console.table(rows)
    if summary.geometry is not None:
        console.table(tables.place_rows(summary.geometry))
    if summary.illumination:
        console.table(tables.light_rows(summary.illumination))
    if summary.screws:
        console.table(tables.screw_rows(summary.screws))
    if summary.tiles:
        console.table(tables.tile_rows(summary))
    if summary.limits:
        console.table(tables.limit_rows(summary.limits))
    if csv is not None:
        write_atomically(csv, tables.curves_csv(summary).encode())
        console.say(f"curves: {csv}")
    if console.json:
        console.answer(summary.as_json())
