"""The command for a camera's noise: noise."""

from __future__ import annotations

import typer

from labkit.cli.app import SessionPath, a_session, app
from labkit.cli.console import Console

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


@app.command()
def noise(ctx: typer.Context, session: SessionPath) -> None:
    """Measure the camera's noise. Photon transfer by EMVA 1288 from flats and darks of several exposure times."""
    a_session(session)
    from labkit.noise.measure import measure_noise
    from labkit.session.session import Session

    console: Console = ctx.obj
    opened = Session.open(session)
    console.warn(*opened.warnings)
    with console.progress("measuring noise") as report:
        measured = measure_noise(opened, report)
    page = measured.write(opened)
    console.warn(*measured.notes())
    console.table(measured.rows())
    console.say("for the [[channel]] tables of plans with this camera:")
    console.say_lines(measured.to_toml())
    console.say(f"results: {page.with_suffix('.json')}, {page}")
    console.answer(measured.as_json())
