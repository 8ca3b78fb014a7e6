"""Commands for sessions and plans: demo, import, plan, verify, fit, report, advise, study."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import PlanPath, SessionPath, app
from labkit.console import Console
from labkit.errors import DataError, LabkitError

if TYPE_CHECKING:
    from labkit.results import Results

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


@app.command()
def demo(
    ctx: typer.Context,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Where; by default a new labkit-demo.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Which lens, sensor, rail and noise.")] = 1,
) -> None:
    """A whole session on simulated devices, to the report; prints the truth beside the estimate."""
    from labkit.demo import new_folder, run_demo

    console: Console = ctx.obj
    folder = out or new_folder(Path("labkit-demo"))
    comparison = run_demo(folder, seed, console.progress)
    console.table([["quantity", "truth", "estimate", "std. error", "error/std."], *comparison.rows()])
    heading = ["waves RMS", "truth", "error", "expected", "worst mode's error/std."]
    console.table([heading, *comparison.wavefront_rows()])
    console.say(f"report: {comparison.report}")
    console.answer(comparison.as_json())


@app.command("import")
def import_(
    ctx: typer.Context,
    frames: Annotated[Path, typer.Argument(metavar="FRAMES.csv", help="file,kind,range_mm of each photograph")],
    plan: PlanPath,
    session: SessionPath,
) -> None:
    """Make a session of photographs taken elsewhere."""
    from labkit.session.import_frames import import_frames

    console: Console = ctx.obj
    with console.progress("importing") as report:
        made = import_frames(frames, plan, session, report)
    for warning in made.warnings:
        console.warn(warning)
    kinds = {kind: sum(frame.kind == kind for frame in made.frames) for kind in ("target", "flat", "dark", "bias")}
    console.say(f"{session}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count))
    console.answer({"session": str(session), "frames": len(made.frames), "kinds": kinds})


@app.command("plan")
def plan_(
    ctx: typer.Context,
    image: Annotated[
        Path | None, typer.Argument(metavar="[IMAGE]", help="a photograph: raw, JPEG, TIFF, PNG, PGM")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="PLAN.toml", help="What to write; nothing is overwritten.")] = Path(
        "plan.toml"
    ),
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Ask for each value; a photograph gives the defaults.")
    ] = False,
) -> None:
    """A plan made from a photograph, with what its file does not say left to fill in; or by questions."""
    from labkit.session.draft_plan import draft_plan, write_draft

    console: Console = ctx.obj
    if interactive:
        _ask_for_plan(console, image, out)
        return
    if image is None:
        raise DataError("give a photograph to make the plan from, or --interactive to be asked")
    draft = draft_plan(image)
    write_draft(draft, out)
    console.say(f"{out}: fill in {', '.join(draft.fill_in)}")
    console.answer({"plan": str(out), "fill_in": list(draft.fill_in)})


def _ask_for_plan(console: Console, image: Path | None, out: Path) -> None:
    """Write a plan by questions, all of it at the end. Raises InputError where there is one already."""
    from labkit.cli.plan_questions import plan_by_questions
    from labkit.cli.questions import ask_until
    from labkit.files import refuse_taken, write_new

    refuse_taken(out)
    console.hint = "; nothing was written"
    text, notes = plan_by_questions(ask_until, out.parent, image)
    console.hint = ""
    write_new(out, text)
    console.warn(*notes)
    console.say(f"{out}: labkit advise {out} says what it will determine")
    console.answer({"plan": str(out), "fill_in": []})


@app.command()
def verify(ctx: typer.Context, session: SessionPath) -> None:
    """Check every frame against its checksum, and the journal against the folder."""
    from labkit.session.session import Session
    from labkit.session.verify import remarks
    from labkit.session.verify import verify as find_problems

    console: Console = ctx.obj
    opened = Session.open(session)
    problems = find_problems(opened)
    notes = [*opened.warnings, *remarks(opened)]
    for note in notes:
        console.warn(note)
    console.answer({"session": str(session), "frames": len(opened.frames), "problems": problems, "remarks": notes})
    if problems:
        raise LabkitError(f"{session}: {'; '.join(problems)}")
    console.say(f"{session}: {len(opened.frames)} frames, all as they were taken")


OnlyRanges = Annotated[list[float] | None, typer.Option("--range", metavar="MM", help="Only this range; again.")]
OnlyChannels = Annotated[list[str] | None, typer.Option("--channel", metavar="NAME", help="Only this channel; again.")]
OtherPlan = Annotated[Path | None, typer.Option(metavar="PLAN.toml", help="Instead of the session's own.")]
Modes = Annotated[str | None, typer.Option(metavar="FIRST:LAST", help="Of Zernike's, by Noll: such as 4:22.")]
ResultsName = Annotated[str | None, typer.Option(metavar="NAME", help="Of the results; by default latest.")]
Patience = Annotated[
    float, typer.Option(min=0.0, metavar="S", help="Seconds, after which a wavefront is searched no more.")
]
Joint = Annotated[bool, typer.Option("--joint", help="Climb over all frames at once in the end.")]
Split = Annotated[bool, typer.Option("--split", help="Fit apart what came before and after a change of the lens.")]
Plain = Annotated[bool, typer.Option("--plain", help="Take no part of the camera into the model that the plan lacks.")]
Diagnose = Annotated[bool, typer.Option("--diagnose", help="Show what parts of the camera were tried.")]
Workers = Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes; by default one a core.")]


@app.command()
def fit(
    ctx: typer.Context,
    session: SessionPath,
    range_mm: OnlyRanges = None,
    channel: OnlyChannels = None,
    plan: OtherPlan = None,
    noll: Modes = None,
    name: ResultsName = None,
    workers: Workers = None,
    patience: Patience = 120.0,
    joint: Joint = False,
    split: Split = False,
    plain: Plain = False,
    diagnose: Diagnose = False,
) -> None:
    """Flat field, wavefronts, the lens that they have in common."""
    from labkit.analysis.fit import fit as fit_session
    from labkit.session.session import Session

    console: Console = ctx.obj
    opened = Session.open(session)
    console.warn(*opened.warnings)
    with console.progress("fitting") as report:
        results = fit_session(
            opened,
            plan=plan,
            ranges_mm=range_mm,
            channels=channel,
            noll=_modes(noll),
            workers=workers,
            name=name,
            patience_s=patience,
            joint=joint,
            split=split,
            plain=plain,
            progress=report,
        )
    _show(console, results, opened.warnings, diagnose)


def _show(console: Console, results: Results, told: Sequence[str], diagnose: bool) -> None:
    """What a fit found, and with diagnose what parts of the camera were tried. told: warnings that were shown before.

    Raises DataError for what it was to find and could not.
    """
    for warning in results.warnings:
        if warning not in (*told, results.unanswered):
            console.warn(warning)
    if diagnose and results.parts_tried:
        console.table(results.part_rows())
    console.table(results.wavefront_rows())
    console.table(results.focus_rows())
    if results.budget:
        console.table(results.budget_rows())
    if results.joint:
        most = max(results.joint, key=results.joint.__getitem__)
        console.say(f"jointly climbed: {most} moved most, by {results.joint[most]:.2f} standard errors")
    console.say(f"results: {results.folder}/results.json")
    console.answer(results.as_json())
    if results.unanswered:
        raise DataError(results.unanswered)


def _modes(noll: str | None) -> tuple[int, int] | None:
    """First and last mode in "4:22". Raises DataError."""
    if noll is None:
        return None
    if not re.fullmatch(r"\d{1,4}:\d{1,4}", noll):
        raise DataError(f"--noll {noll}: give first and last mode, such as 4:22")
    first, last = noll.split(":")
    return int(first), int(last)


@app.command()
def report(
    ctx: typer.Context,
    session: SessionPath,
    name: Annotated[str, typer.Option(metavar="NAME", help="Of the results.")] = "latest",
) -> None:
    """The measurement as one HTML page with figures."""
    from labkit.report.html import write_report
    from labkit.results import Results
    from labkit.session.session import Session

    console: Console = ctx.obj
    _ = Session.open(session).plan  # one that was altered is named before anything is reported
    made = write_report(Results.load(session, name))
    console.say(f"report: {made}")
    console.answer({"report": str(made)})


@app.command()
def advise(
    ctx: typer.Context,
    plan: PlanPath,
    ranges_mm: Annotated[
        list[float] | None, typer.Option("--range", metavar="MM", help="Instead of the plan's; once for each.")
    ] = None,
    electrons: Annotated[float, typer.Option(metavar="N", help="At white, in one photograph.")] = 20_000,
    want: Annotated[float | None, typer.Option(metavar="WAVES", help="A wavefront error to be reached.")] = None,
) -> None:
    """Before capture: what the target, the light and the ranges of a plan will tell."""
    from labkit.analysis.advice_tables import range_rows, session_rows
    from labkit.analysis.advise import advise as advise_on
    from labkit.plan import Plan

    console: Console = ctx.obj
    advice = advise_on(Plan.load(plan), ranges_mm=ranges_mm, electrons=electrons, want_waves=want)
    console.table(range_rows(advice))
    console.table(session_rows(advice))
    for note in advice.notes:
        console.say(note)
    console.answer(advice.as_json())


@app.command()
def study(
    ctx: typer.Context,
    name: Annotated[str, typer.Argument(metavar="NAME", help="which; a wrong one lists them")],
    quick: Annotated[bool, typer.Option("--quick", help="A few trials: to see that it works.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write its figure, CSV and JSON here.")] = None,
    workers: Workers = None,
) -> None:
    """An experiment of the thesis; prints its claims beside ours as JSON."""
    from labkit.execute import default_workers
    from labkit.experiments.runner import Setting, run_study

    console: Console = ctx.obj
    with console.progress(name) as report:
        summary = run_study(name, Setting(quick, workers or default_workers(), report), out)
    console.json = True  # its contract: one JSON object, asked for or not
    console.answer(summary)
