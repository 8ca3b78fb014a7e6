"""The command for edges."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import Channels, Workers, a_file_or_session, app, photographs_and_plan
from labkit.cli.console import Console
from labkit.errors import DataError

if TYPE_CHECKING:
    from labkit.edges.found_edges import Box
    from labkit.edges.outcome import EdgesOutcome
    from labkit.plan import Plan
    from labkit.uncertain import Uncertain

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

Images = Annotated[
    list[Path],
    typer.Argument(
        metavar="IMAGE... PLAN.toml",
        help="Frames of one scene, and their plan.",
    ),
]
Boxes = Annotated[
    list[str] | None,
    typer.Option(
        "--box",
        metavar="R0,C0,R1,C1",
        help="Around an edge, in raw pixels; may be repeated.",
        show_default="edges are looked for",
    ),
]
Psf = Annotated[
    Path | None,
    typer.Option(
        metavar="SESSION",
        help="Whose wavefront and best focus are taken.",
        show_default="none: fitted along",
    ),
]
Focus = Annotated[
    str | None,
    typer.Option(
        metavar="MM[±MM]",
        help="What the lens is focused at.",
        show_default="as in the session",
    ),
]
OneRange = Annotated[
    bool, typer.Option("--one-range", help="All edges stand at one range.")
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Take the PSF of another camera, channel or aperture."),
]


Most = Annotated[
    int,
    typer.Option(
        min=1, metavar="N", help="Edges that are looked for where no box is given."
    ),
]
Edition = Annotated[
    int,
    typer.Option(
        metavar="YEAR",
        help="Of ISO 12233 for the e-SFR; 2017 has a straight line and Hamming's window.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write edges.json and the depth map here.",
        show_default="nothing is written",
    ),
]


@app.command()
def edges(
    ctx: typer.Context,
    images: Images,
    psf: Psf = None,
    psf_name: Annotated[
        str, typer.Option("--psf-name", metavar="NAME", help="Of the session's results.")
    ] = "latest",
    box: Boxes = None,
    focus: Focus = None,
    channel: Channels = None,
    one_range: OneRange = False,
    most: Most = 60,
    edition: Edition = 2023,
    out: Out = None,
    force: Force = False,
    workers: Workers = None,
) -> None:
    """Estimate ranges from straight edges. And the camera's response across them, by the fit and by ISO 12233."""
    a_file_or_session(psf)
    photographs, plan = photographs_and_plan(images, "edges")
    from labkit.edges.measurement import measure_edges
    from labkit.results import Results

    console: Console = ctx.obj
    with console.progress("edges") as report:
        outcome = measure_edges(
            photographs,
            plan,
            psf=None if psf is None else Results.load(psf, psf_name),
            boxes=[_box(text) for text in box or ()],
            focus_mm=None if focus is None else _focus(focus),
            channels=channel,
            one_range=one_range,
            most=most,
            edition=edition,
            force=force,
            workers=workers,
            progress=report,
        )
    _show(console, outcome, photographs[0], plan, out)


def _show(
    console: Console, outcome: EdgesOutcome, image: Path, plan: Plan, out: Path | None
) -> None:
    """Print the measured edges. Raises DataError if no edge could be measured."""
    console.warn(*(finding.text for finding in outcome.findings))
    measured = bool(outcome.edges) or any(of.responses for of in outcome.rejected)
    if measured:
        console.table(outcome.rows())
    for of in outcome.rejected:
        console.warn(f"box {','.join(map(str, of.box))}: {of.why}")
    if out is not None:
        for path in outcome.write(out, image, plan):
            console.say(f"written: {path}")
    console.answer(outcome.as_json())
    if not measured:
        raise DataError(f"{image}: no edge could be measured: {outcome.rejected[0].why}")


def _box(text: str) -> Box:
    """Parse a box. Raises DataError."""
    if not re.fullmatch(r"\s*-?\d{1,6}(\s*,\s*-?\d{1,6}){3}\s*", text):
        raise DataError(
            f"--box {text}: give R0,C0,R1,C1, whole pixels of the raw, such as 100,200,164,264"
        )
    r0, c0, r1, c1 = map(int, text.split(","))
    return r0, c0, r1, c1


def _focus(text: str) -> Uncertain:
    """Parse a best focus. Raises DataError."""
    from labkit.uncertain import Uncertain

    number = r"\d{1,7}(?:\.\d{1,6})?"
    match = re.fullmatch(rf"({number})(?:(?:±|\+-)({number}))?", text.replace(" ", ""))
    if match is None or not float(match[1]) > 0:
        raise DataError(
            f"--focus {text}: give millimetres above 0, such as 5012, or with their standard error, 5012±10"
        )
    return Uncertain(float(match[1]), float(match[2] or 0), "mm")
