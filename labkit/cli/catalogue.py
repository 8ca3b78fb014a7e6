"""Commands of the catalogue: list, history, compare, catalogue rebuild."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import a_session, app, catalogue_app
from labkit.cli.console import Console

if TYPE_CHECKING:
    from labkit.catalogue.compare import Comparison, Difference
    from labkit.catalogue.entry import Entry
    from labkit.catalogue.history import History

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

Sessions = Annotated[
    Path,
    typer.Argument(metavar="[FOLDER]", help="Folder that the sessions' folders are in."),
]
ResultsOf = Annotated[
    str, typer.Option("--name", metavar="NAME", help="Name of the results.")
]

HISTORY_MODES = (5, 6, 7, 8, 11)
"""Noll's modes in the table of a history: astigmatism, coma, spherical aberration."""


@app.command("list")
def list_(ctx: typer.Context, folder: Sessions = Path()) -> None:
    """List the sessions in a folder. Lens, camera, best focus; sessions that changed are read anew."""
    from labkit.catalogue.sessions import list_sessions

    console: Console = ctx.obj
    with console.progress("reading") as report:
        catalogue = list_sessions(folder, report)
    console.warn(*catalogue.warnings)
    _name_left_out(console, catalogue.entries)
    read = [entry for entry in catalogue.entries if not entry.problem]
    console.table([LIST_HEADING, *map(_row, read)])
    entries = [entry.as_json() for entry in catalogue.entries]
    console.answer({"schema": 1, "sessions": entries})


LIST_HEADING = [
    *("session", "results", "lens", "camera", "taken"),
    *("best focus/mm", "RMS/nm", "numbers"),
]


def _row(entry: Entry) -> list[str]:
    """Return an entry's row, with the numbers of green or the first channel."""
    channels = entry.channels
    channel = "G" if "G" in channels else next(iter(channels), "")
    numbers = [
        str(number).removesuffix(f" {number.unit}") if number is not None else ""
        for quantity in ("best_focus_mm", "rms_nm")
        for number in [entry.numbers.get((quantity, channel))]
    ]
    label = (entry.folder, entry.name, entry.lens_label, entry.camera)
    return [
        *label,
        entry.taken[:16].replace("T", " "),
        *numbers,
        entry.state.partition(":")[0],
    ]


def _name_left_out(console: Console, entries: Iterable[Entry]) -> None:
    """Name each session left out, with the reason."""
    for entry in entries:
        if entry.problem:
            console.warn(f"{entry.folder} is left out: {entry.problem}")


@app.command()
def history(
    ctx: typer.Context,
    lens: Annotated[
        str,
        typer.Option(
            metavar="TEXT", help="Name or serial number of the lens, or a part of them."
        ),
    ],
    channel: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Channel.", show_default="G, or the first"),
    ] = None,
    folder: Sessions = Path(),
    name: ResultsOf = "latest",
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.svg", help="Picture to write.", show_default="no picture"
        ),
    ] = None,
) -> None:
    """Show a lens over time. Best focus, RMS and modes of all its sessions in a folder, with standard errors."""
    from labkit.catalogue.sessions import lens_history

    console: Console = ctx.obj
    with console.progress("reading") as report:
        found = lens_history(lens, channel, folder=folder, name=name, progress=report)
    _name_left_out(console, found.left_out)
    console.say(f"{found.lens}, channel {found.channel}, {len(found.entries)} sessions")
    console.table(_history_rows(found))
    if out is not None:
        from labkit.catalogue.pictures import history_picture
        from labkit.storage.files import write_atomically

        write_atomically(out, history_picture(found))
        console.say(f"picture: {out}")
    console.answer(found.as_json())


def _history_rows(found: History) -> list[list[str]]:
    """Return a heading and a row for each session."""
    quantities = ["best_focus_mm", "rms_nm", *(f"waves.{j}" for j in HISTORY_MODES)]
    modes = [f"Noll {j}/waves" for j in HISTORY_MODES]
    rows = [["taken", "session", "best focus/mm", "RMS/nm", *modes]]
    for entry in found.entries:
        numbers = [found.number(entry, quantity) for quantity in quantities]
        cells = [
            "" if number is None else str(number).removesuffix(f" {number.unit}")
            for number in numbers
        ]
        rows.append([entry.taken[:16].replace("T", " "), entry.folder, *cells])
    return rows


@app.command()
def compare(
    ctx: typer.Context,
    sessions: Annotated[
        list[Path],
        typer.Argument(metavar="SESSION...", help="Folders of two sessions or more."),
    ],
    name: ResultsOf = "latest",
    same_focus: Annotated[
        bool,
        typer.Option(
            "--same-focus",
            help="Lens, camera and rail stayed as they were: test best focus too.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for a map of each pair.", show_default="no map"
        ),
    ] = None,
) -> None:
    """Say whether sessions are of one lens. Differences with standard errors, and the probability of one lens."""
    for session in sessions:
        a_session(session)
    from labkit.catalogue.sessions import compare_readable

    console: Console = ctx.obj
    pairs = []
    compared, left_out = compare_readable(*sessions, name=name, same_focus=same_focus)
    console.warn(*(f"{words} left out: {error}" for words, error in left_out.items()))
    for pair in compared:
        _show(console, pair)
        pairs.append(pair.as_json())
        if out is not None:
            console.say(f"map: {_written(out, pair)}")
    why = {words: str(error) for words, error in left_out.items()}
    console.answer({"schema": 1, "pairs": pairs, "left_out": why})


def _show(console: Console, pair: Comparison) -> None:
    """Print a comparison."""
    console.table(
        [
            ["number", pair.first, pair.second, "difference", "in standard errors"],
            *map(_difference_row, pair.differences),
        ]
    )
    for note in pair.notes:
        console.warn(note)
    console.say(pair.headline)


def _difference_row(one: Difference) -> list[str]:
    """Return the row of a number; one that is not tested says so."""
    value = f"{one.difference:+.2g}" if not one.difference.std else str(one.difference)
    errors = round(one.in_errors, 1) + 0.0  # no minus zero
    in_errors = f"{errors:+.1f}" + ("" if one.tested else ", not tested")
    return [one.name, f"{one.first:.6g}", f"{one.second:.6g}", value, in_errors]


def _written(folder: Path, pair: Comparison) -> Path:
    """Write a pair's map, and return its path."""
    from labkit.catalogue.pictures import comparison_picture
    from labkit.storage.files import write_atomically, writing

    path = folder / f"{Path(pair.first).name}-{Path(pair.second).name}.svg"
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, comparison_picture(pair))
    return path


@catalogue_app.command()
def rebuild(ctx: typer.Context, folder: Sessions = Path()) -> None:
    """Make the catalogue of a folder anew."""
    from labkit.catalogue.sessions import rebuild_catalogue

    console: Console = ctx.obj
    with console.progress("reading") as report:
        catalogue = rebuild_catalogue(folder, report)
    console.warn(*catalogue.warnings)
    _name_left_out(console, catalogue.entries)
    left_out = sum(bool(entry.problem) for entry in catalogue.entries)
    read = len(catalogue.entries) - left_out
    console.say(f"{folder}: {read} results, {left_out} left out")
    console.answer({"schema": 1, "results": read, "left_out": left_out})
