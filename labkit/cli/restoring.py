"""Restore photographs with a session's lens: the command."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from labkit.cli.app import Workers, a_file_or_session, app
from labkit.cli.console import Console
from labkit.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    from labkit.restoration.job import Area, Job
    from labkit.restoration.restored_photographs import Restoration
    from labkit.restoration.strength import Choice
    from labkit.types import Floats32

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

METHOD_NAMES = (
    "model",
    "richardson-lucy",
    "richardson-lucy-blind",
    "wiener",
    "total-variation",
)

Photographs = Annotated[
    list[Path],
    typer.Argument(
        metavar="IMAGE... | SESSION",
        help="Raw files of one scene, or a session's folder.",
    ),
]
Psf = Annotated[
    Path | None,
    typer.Option(
        metavar="SESSION",
        help="Whose lens took them.",
        show_default="the session given",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Folder to make.", show_default="beside the photograph"
    ),
]
ResultsName = Annotated[
    str, typer.Option("--name", metavar="NAME", help="Of the session's results.")
]
Range = Annotated[
    float | None,
    typer.Option(
        "--range",
        metavar="MM",
        help="From which they were taken.",
        show_default="the session's only one",
    ),
]
Channels = Annotated[
    list[str] | None,
    typer.Option(
        "--channel",
        metavar="NAME",
        help="Only this colour; may be repeated.",
        show_default="all",
    ),
]
Strength = Annotated[
    str, typer.Option("--lambda", metavar="L", help="A number, discrepancy, or l-curve.")
]
Samples = Annotated[
    int | None,
    typer.Option(min=1, max=32, metavar="N", help="To a pixel.", show_default="Nyquist's"),
]
Crop = Annotated[
    str | None,
    typer.Option(
        metavar="R0,C0,R1,C1", help="Only these rows and columns.", show_default="all"
    ),
]
Tile = Annotated[
    int | None,
    typer.Option(
        min=32, metavar="PX", help="Side of a tile.", show_default="what memory allows"
    ),
]
Memory = Annotated[
    float | None,
    typer.Option(
        min=0.01, metavar="GB", help="To use at most.", show_default="what is free"
    ),
]
FitDefocus = Annotated[
    bool, typer.Option("--fit-defocus", help="Estimate the photograph's own defocus.")
]
Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Take the PSF though camera, aperture or colour is another."
    ),
]
SixteenBit = Annotated[
    bool, typer.Option("--sixteen-bit", help="Write a linear 16-bit TIFF too.")
]
Method = Annotated[
    str, typer.Option(metavar="NAME", help=f"One of {', '.join(METHOD_NAMES)}.")
]


@app.command()
def restore(
    ctx: typer.Context,
    photographs: Photographs,
    psf: Psf = None,
    out: Out = None,
    name: ResultsName = "latest",
    range_mm: Range = None,
    channel: Channels = None,
    strength: Strength = "discrepancy",
    samples: Samples = None,
    crop: Crop = None,
    tile: Tile = None,
    memory: Memory = None,
    fit_defocus: FitDefocus = False,
    force: Force = False,
    sixteen_bit: SixteenBit = False,
    method: Method = "model",
    workers: Workers = None,
) -> None:
    """Restore the scene behind photographs. By a session's lens, with standard errors."""
    a_file_or_session(*photographs, psf)
    from labkit.jobs.execute import default_workers
    from labkit.restoration.restored_photographs import Wanted
    from labkit.restoration.scenes import scenes_of

    if method not in METHOD_NAMES:
        raise DataError(f"--method {method}: allowed is {', '.join(METHOD_NAMES)}")
    wanted = Wanted(
        strength=_strength(strength),
        channels=tuple(channel or ()),
        range_mm=range_mm,
        samples=samples,
        crop=_area(crop),
        tile_px=tile,
        memory_gb=memory,
        fit_defocus=fit_defocus,
        force=force,
        method=method,
        baseline=_baseline(method),
        sixteen_bit=sixteen_bit,
        workers=workers or default_workers(),
    )
    console: Console = ctx.obj
    answers = []
    for scene in scenes_of(photographs, psf, out, name, wanted):
        with console.progress("restoring") as report:
            made = scene(say=console.say, progress=report)
        answers.append(_shown(console, made, method))
    console.answer(answers[0] if len(answers) == 1 else {"restored": answers})


def _shown(console: Console, made: Restoration, method: str) -> dict[str, Any]:
    """Print the outcome of a restoration; return the outcome as JSON."""
    console.warn(*made.notes)
    chosen = made.about["lambda"]
    by = f"lambda {chosen['value']:.3g} by {chosen['chosen_by']}" if chosen else method
    console.say(f"restored: {made.folder}, {by}, {made.about['seconds']:.0f} s")
    return {"folder": str(made.folder), **made.about}


def _baseline(method: str) -> Callable[[Job], Floats32] | None:
    """Return a method to compare with; None for labkit's own."""
    if method == "model":
        return None
    from labkit.experiments.methods.restoration_baselines import baseline

    return partial(baseline, method=method)


def _strength(given: str) -> float | Choice:
    """Parse a strength. Raises DataError unless it is a number above 0 or a way to choose one."""
    from labkit.experiments.methods.l_curve import L_CURVE
    from labkit.restoration.strength import DISCREPANCY

    for choice in (DISCREPANCY, L_CURVE):
        if given == choice.name:
            return choice
    try:
        value = float(given)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e30:
        raise DataError(f"--lambda {given}: a number above 0, discrepancy, or l-curve")
    return value


def _area(crop: str | None) -> Area | None:
    """Parse an area. Raises DataError unless the text holds four whole numbers."""
    if crop is None:
        return None
    if not re.fullmatch(r"\d{1,6}(,\d{1,6}){3}", crop):
        raise DataError(
            f"--crop {crop}: give first row, first column, row and column after the last, such as 0,0,256,256"
        )
    r0, c0, r1, c1 = map(int, crop.split(","))
    return slice(r0, r1), slice(c0, c1)
