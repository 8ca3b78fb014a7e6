"""The command for charts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import Channels, Workers, app, photographs_and_plan
from labkit.cli.console import Console

if TYPE_CHECKING:
    from labkit.charts.outcome import ChartOutcome
    from labkit.plan import Plan

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

Charts = Annotated[
    list[Path],
    typer.Argument(
        metavar="IMAGE... PLAN.toml", help="Photographs of a chart, and their plan."
    ),
]
Ranges = Annotated[
    list[float] | None,
    typer.Option(
        "--range",
        metavar="MM",
        help="Of the chart, once for each photograph; two ranges give the sign of focus errors.",
        show_default="unknown",
    ),
]
Columns = Annotated[
    int, typer.Option("--places", metavar="N", help="Places along the frame's rows, odd.")
]
Each = Annotated[
    int, typer.Option("--edges", metavar="N", help="Edges of either direction at a place.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write chart.json, profiles and map here.",
        show_default="nothing is written",
    ),
]


@app.command()
def chart(
    ctx: typer.Context,
    images: Charts,
    range_mm: Ranges = None,
    channel: Channels = None,
    places: Columns = 7,
    edges: Each = 2,
    out: Out = None,
    workers: Workers = None,
) -> None:
    """Measure a lens over the frame by a chart. MTF, focus and distortion, by a checkerboard or slanted squares."""
    photographs, plan = photographs_and_plan(images, "chart")
    from labkit.charts.measurement import measure_chart

    console: Console = ctx.obj
    with console.progress("edges") as report:
        outcome = measure_chart(
            photographs,
            plan,
            ranges_mm=range_mm or (),
            channels=channel,
            columns=places,
            each=edges,
            workers=workers,
            progress=report,
        )
    _show(console, outcome, photographs[outcome.sharpest], plan, out)


def _show(
    console: Console, outcome: ChartOutcome, image: Path, plan: Plan, out: Path | None
) -> None:
    """Print the measured numbers, and write them."""
    from labkit.edges.outcome import grey_picture

    console.warn(*(finding.text for finding in outcome.findings))
    if outcome.edges:
        console.table(outcome.rows())
        console.table(outcome.focus_rows())
    if surfaces := outcome.surface_rows():
        console.table(surfaces)
    if outcome.geometry is not None:
        console.table(outcome.geometry.rows())
        console.say(outcome.geometry.sentence)
    if out is not None:
        for path in outcome.write(out, grey_picture(image, plan)):
            console.say(f"written: {path}")
    console.answer(outcome.as_json())
