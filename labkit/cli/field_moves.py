"""Commands over several sessions with a field: field check-move, field split."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import a_plan, a_session, channels, field_app
from labkit.cli.console import Console
from labkit.errors import InputError

if TYPE_CHECKING:
    from labkit.field.split import Split

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

Channel = Annotated[
    str | None,
    typer.Option(
        "--channel",
        metavar="NAME",
        help="Channel.",
        show_default="G, or the first",
        autocompletion=channels,
    ),
]
ResultsName = Annotated[
    str, typer.Option("--name", metavar="NAME", help="Name of the results.")
]


@field_app.command("check-move")
def check_move(
    ctx: typer.Context,
    before: Annotated[
        Path, typer.Argument(metavar="BEFORE", help="Session before the move.")
    ],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="Session after the move.")],
    screw: Annotated[
        int,
        typer.Option("--screw", metavar="K", help="Number of the turned screw, from 1."),
    ],
    turn: Annotated[
        float,
        typer.Option("--turn", metavar="DEG", help="Its turn in degrees, clockwise."),
    ],
    plan: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            metavar="PLAN.toml",
            help="Plan whose [mount] table has the screws.",
            show_default="the plan of AFTER",
        ),
    ] = None,
    channel: Channel = None,
    name: ResultsName = "latest",
) -> None:
    """Prove which way a screw works. Compares the tilt before and after one screw was turned by a known angle."""
    for session in (before, after):
        a_session(session)
    a_plan(plan)
    from labkit.field.tables import text
    from labkit.field.turned import check_screw_move
    from labkit.plan import Plan
    from labkit.results import Results

    console: Console = ctx.obj
    both = [Results.load(one, name, residuals=False) for one in (before, after)]
    screws = None if plan is None else Plan.load(plan)
    move = check_screw_move(both[0], both[1], screw, turn, screws, channel)
    measured = move.measured
    console.table(
        [
            ["slope of focus/(µm/mm)", "down", "right"],
            ["measured change", *(text(part) for part in (measured.down, measured.right))],
            [
                "predicted, if clockwise is away from the lens",
                *(f"{value:.2f}" for value in move.predicted),
            ],
        ]
    )
    console.say(move.words)
    if move.clockwise is not None:
        console.say(f'in the plan: [mount] clockwise = "{move.clockwise}"')
    console.answer(move.as_json())


@field_app.command()
def split(
    ctx: typer.Context,
    sessions: Annotated[
        list[Path],
        typer.Argument(metavar="SESSION...", help="Folders of two sessions or more."),
    ],
    turned: Annotated[
        str,
        typer.Option(
            "--turned",
            metavar="DEG,DEG...",
            help="Angle of the lens against the body in each session, clockwise as seen from behind the camera.",
        ),
    ],
    channel: Channel = None,
    name: ResultsName = "latest",
) -> None:
    """Tell a tilted camera from a tilted lens. Compares sessions with the lens turned by known angles."""
    for session in sessions:
        a_session(session)
    angles = _angles(turned)
    from labkit.field.turned import split_fields
    from labkit.results import Results

    console: Console = ctx.obj
    loaded = [Results.load(one, name, residuals=False) for one in sessions]
    parts = split_fields(loaded, angles, channel)
    console.table([SPLIT_HEADING, *(row for each in parts.items() for row in _rows(*each))])
    for what, part in parts.items():
        if part.p_value < CONTRADICTORY_P:
            console.warn(
                f"{_words(what)}: the sessions contradict each other (p = {part.p_value:.1g}): "
                "check the angles, and whether the lens was refocused"
            )
    console.answer(
        {
            "schema": 1,
            "turned_deg": list(angles),
            "parts": {what: part.as_json() for what, part in parts.items()},
        }
    )


SPLIT_HEADING = ["misalignment", "of", "down", "right", "unit", "p if none"]

CONTRADICTORY_P = 0.01
"""Probability of sessions that contradict each other by chance."""


def _rows(what: str, split_: Split) -> list[list[str]]:
    """Return the rows of body and lens."""
    from labkit.field.tables import probability, text

    rows = []
    for of, pair in (("body", split_.body), ("lens", split_.lens)):
        chance = probability(pair.p_value).removeprefix("= ")
        unit = pair.unit.replace("um", "µm")
        rows.append([_words(what), of, text(pair.down), text(pair.right), unit, chance])
    return rows


def _words(what: str) -> str:
    return what.replace("_", " ")


def _angles(turned: str) -> tuple[float, ...]:
    """Return the angles of --turned. Raises InputError for anything but numbers with commas."""
    try:
        return tuple(float(part) for part in turned.split(","))
    except ValueError as error:
        raise InputError(
            f"--turned {turned}: angles in degrees with commas between them are needed, such as 0,180"
        ) from error
