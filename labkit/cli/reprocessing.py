"""The command for many sessions: reprocess."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labkit.cli.app import (
    AcceptFailed,
    Dask,
    Workers,
    app,
    cluster_or_none,
    kept_if_interrupted,
)
from labkit.cli.console import Console
from labkit.errors import LabkitError


@app.command()
def reprocess(
    ctx: typer.Context,
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION...", help="The sessions' folders.")
    ],
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name of the results in each session.")
    ] = "latest",
    workers: Workers = None,
    dask: Dask = None,
    force: Annotated[
        bool, typer.Option("--force", help="Fit sessions that are up to date too.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what would be fitted, and why.")
    ] = False,
    accept_failed: AcceptFailed = False,
) -> None:
    """Fit many sessions again. Results that are up to date are skipped; all fits are one stream, and go on if killed."""
    from labkit.analysis.reprocess import reprocess as reprocess_sessions

    console: Console = ctx.obj
    with (
        kept_if_interrupted(console),
        cluster_or_none(dask, workers) as cluster,
        console.progress("reprocessing") as report,
    ):
        rows = reprocess_sessions(
            sessions,
            name=name,
            force=force,
            dry_run=dry_run,
            accept_failed=accept_failed,
            workers=workers,
            run=cluster,
            progress=report,
        )
    cells = [
        [str(row.session), row.state, str(row.fits), f"{row.seconds:.0f}", row.why]
        for row in rows
    ]
    console.table([["session", "state", "fits", "seconds", "why"], *cells])
    console.answer({"schema": 1, "sessions": [row.as_json() for row in rows]})
    failed = [str(row.session) for row in rows if row.state == "failed"]
    if failed:
        raise LabkitError(
            f"{len(failed)} of {len(rows)} sessions are not done: {', '.join(failed)}; the table says why"
        )
