"""Groups of the command line, its global options, and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labkit.version import __version__

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

app = typer.Typer(
    help="Measure a camera's optics from photographs of a known target.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
target_app = typer.Typer(help="Targets to print or to show.", no_args_is_help=True)
app.add_typer(target_app, name="target")
camera_app = typer.Typer(help="The camera by itself.", no_args_is_help=True)
app.add_typer(camera_app, name="camera")
rail_app = typer.Typer(help="The rail by itself.", no_args_is_help=True)
app.add_typer(rail_app, name="rail")

CameraPlace = Annotated[
    str,
    typer.Argument(
        metavar="[PLAN.toml | ADDRESS]",
        help="A plan, or a camera's address.",
    ),
]
PlanPath = Annotated[
    Path,
    typer.Argument(
        metavar="PLAN.toml",
        help="The plan: what to do, and with what.",
    ),
]
SessionPath = Annotated[
    Path,
    typer.Argument(metavar="SESSION", help="The session's folder."),
]


def _version(asked: bool) -> None:
    if asked:
        print(f"labkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    ctx: typer.Context,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show where in the code an error arose.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print the answer as JSON, nothing else.")
    ] = False,
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Accept the options of every command, which may also follow the command."""
    ctx.obj.debug, ctx.obj.quiet, ctx.obj.json = debug, quiet, json
