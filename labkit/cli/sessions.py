"""Commands for sessions and plans: demo, import, plan, verify, fit, report, advise, study."""

from __future__ import annotations

import re
import time
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import (
    AcceptFailed,
    Dask,
    PlanPath,
    SessionPath,
    Workers,
    a_file,
    a_plan,
    a_session,
    app,
    channels,
    cluster_or_none,
    kept_if_interrupted,
    studies,
)
from labkit.cli.console import Console
from labkit.errors import DataError, InputError, LabkitError
from labkit.jobs.pace import EARLIER, RULE

if TYPE_CHECKING:
    from labkit.plan import Plan
    from labkit.results import Results
    from labkit.session.session import Session

FIT = "fit"
"""Name of fits among the paces that were learnt."""

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


@app.command()
def demo(
    ctx: typer.Context,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder to make.",
            show_default="labkit-demo, or the next free name",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Number of the lens, sensor, rail and noise to simulate.",
        ),
    ] = 1,
) -> None:
    """Measure a simulated lens. From capture to report; prints the truth beside the estimate, then what to do next."""
    from labkit.demo import new_folder, next_steps, run_demo

    console: Console = ctx.obj
    folder = out or new_folder(Path("labkit-demo"))
    comparison = run_demo(folder, seed, console.progress)
    console.table(
        [["quantity", "truth", "estimate", "std. error", "error/std."], *comparison.rows()]
    )
    heading = ["waves RMS", "truth", "error", "expected", "worst mode's error/std."]
    console.table([heading, *comparison.wavefront_rows()])
    console.say(f"report: {comparison.report}")
    console.say_lines(next_steps(folder))
    console.answer(comparison.as_json())


@app.command("import")
def import_(
    ctx: typer.Context,
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES.csv",
            help="The list of photographs: file, kind, range_mm.",
        ),
    ],
    plan: PlanPath,
    session: SessionPath,
) -> None:
    """Make a session of existing photographs. All are checked and copied, or nothing is made."""
    a_file(frames)
    a_plan(plan)
    from labkit.session.import_frames import import_frames

    console: Console = ctx.obj
    with console.progress("importing") as report:
        made = import_frames(frames, plan, session, report)
    for warning in made.warnings:
        console.warn(warning)
    kinds = {
        kind: sum(frame.kind == kind for frame in made.frames)
        for kind in ("target", "flat", "dark", "bias")
    }
    console.say(
        f"{session}: "
        + ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    )
    console.answer({"session": str(session), "frames": len(made.frames), "kinds": kinds})


@app.command("plan")
def plan_(
    ctx: typer.Context,
    image: Annotated[
        Path | None,
        typer.Argument(
            metavar="[IMAGE]",
            help="A photograph: raw, JPEG, TIFF, PNG or PGM.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(metavar="PLAN.toml", help="File to write; nothing is overwritten."),
    ] = Path("plan.toml"),
    interactive: Annotated[
        bool,
        typer.Option(
            "--interactive", help="Ask for each value; a photograph gives the defaults."
        ),
    ] = False,
) -> None:
    """Draft a plan from a photograph, or ask. Values that its file does not state are left to fill in, with an example."""
    a_file(image)
    from labkit.session.draft_plan import draft_plan, write_draft

    console: Console = ctx.obj
    if interactive:
        _ask_for_plan(console, image, out)
        return
    if image is None:
        raise DataError(
            "give a photograph to make the plan from, or --interactive to be asked"
        )
    draft = draft_plan(image)
    write_draft(draft, out)
    console.say(f"{out}: fill in {', '.join(draft.fill_in)}")
    console.answer({"plan": str(out), "fill_in": list(draft.fill_in)})


def _ask_for_plan(console: Console, image: Path | None, out: Path) -> None:
    """Write a plan by questions, all at the end. Raises InputError if the file exists."""
    from labkit.cli.plan_questions import plan_by_questions
    from labkit.cli.questions import ask_until
    from labkit.storage.files import refuse_taken, write_new

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
    """Check a session against its checksums. Every frame, the plan, and the journal against the folder."""
    a_session(session)
    from labkit.session.session import Session
    from labkit.session.verify import as_error, remarks
    from labkit.session.verify import verify as find_problems

    console: Console = ctx.obj
    opened = Session.open(session)
    problems = find_problems(opened)
    notes = [*opened.warnings, *remarks(opened)]
    for note in notes:
        console.warn(note)
    console.answer(
        {
            "session": str(session),
            "frames": len(opened.frames),
            "problems": problems,
            "remarks": notes,
        }
    )
    if problems:
        raise LabkitError(f"{session}: {as_error(problems)}")
    console.say(f"{session}: {len(opened.frames)} frames, all as they were taken")


OnlyRanges = Annotated[
    list[float] | None,
    typer.Option(
        "--range",
        metavar="MM",
        help="Fit this range only; may be repeated.",
        show_default="all",
    ),
]
OnlyChannels = Annotated[
    list[str] | None,
    typer.Option(
        "--channel",
        metavar="NAME",
        help="Fit this channel only; may be repeated.",
        show_default="all",
        autocompletion=channels,
    ),
]
OtherPlan = Annotated[
    Path | None,
    typer.Option(
        metavar="PLAN.toml",
        help="Plan to fit by.",
        show_default="the session's own",
    ),
]
Modes = Annotated[
    str | None,
    typer.Option(
        metavar="FIRST:LAST",
        help="First and last Zernike mode, in Noll's order.",
        show_default="as in the plan",
    ),
]
ResultsName = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Name for the results.",
        show_default="latest; of a fit in part, its ranges and channels",
    ),
]
Patience = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        metavar="S",
        help="Processor seconds after which the search for a wavefront ends.",
        show_default="as many starts as it needs",
    ),
]
Joint = Annotated[
    bool, typer.Option("--joint", help="Finally climb over all frames at once.")
]
Split = Annotated[
    bool,
    typer.Option(
        "--split", help="Fit separately what came before and after the lens was changed."
    ),
]
Plain = Annotated[
    bool,
    typer.Option("--plain", help="Use no part of the camera that the plan does not state."),
]
Diagnose = Annotated[
    bool, typer.Option("--diagnose", help="Show which parts of the camera were tried.")
]


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
    patience: Patience = None,
    joint: Joint = False,
    split: Split = False,
    plain: Plain = False,
    diagnose: Diagnose = False,
    dask: Dask = None,
    accept_failed: AcceptFailed = False,
) -> None:
    """Estimate wavefronts, best focus, the lens. Results go to SESSION/results/NAME; a fit that was killed goes on."""
    a_session(session)
    a_plan(plan)
    from labkit.analysis.fit import fit as fit_session
    from labkit.plan import Plan
    from labkit.session.session import Session

    console: Console = ctx.obj
    opened = Session.open(session)
    console.warn(*opened.warnings)
    other = None if plan is None else Plan.load(plan)
    timed = _Timed.of(opened, other or opened.plan, range_mm, channel, workers)
    with (
        kept_if_interrupted(console),
        cluster_or_none(dask, workers) as cluster,
        console.progress("fitting", *timed.expected) as report,
    ):
        results = fit_session(
            opened,
            plan=other,
            ranges_mm=range_mm,
            channels=channel,
            noll=_modes(noll),
            workers=workers,
            name=name,
            patience_s=inf if patience is None else patience,
            joint=joint,
            split=split,
            plain=plain,
            accept_failed=accept_failed,
            run=cluster,
            progress=report,
        )
    timed.learn()
    _show(console, results, diagnose)


@dataclass(frozen=True, slots=True)
class _Timed:
    """The size of a fit and its begin.

    Attributes
    ----------
    size : see `fit_size`; 0 if the fit will be refused
    whole : whether no fits are kept from an interrupted one
    """

    size: float
    whole: bool
    began_s: float = field(default_factory=time.monotonic)

    @classmethod
    def of(
        cls,
        session: Session,
        plan: Plan,
        ranges_mm: list[float] | None,
        names: list[str] | None,
        workers: int | None,
    ) -> _Timed:
        from labkit.analysis.fit_size import fit_size
        from labkit.analysis.kept_fits import FOLDER
        from labkit.jobs.execute import default_workers

        size = 0.0
        with suppress(InputError):  # which the fit will say
            size = fit_size(
                session.frames, plan, ranges_mm, names, workers or default_workers()
            )
        return cls(size, not any(session.folder.glob(f"results/*/{FOLDER}")))

    @property
    def expected(self) -> tuple[float | None, str]:
        """Expected duration in seconds, and whose it is."""
        from labkit.analysis.fit_size import USUAL_S
        from labkit.jobs.learnt_paces import Paces

        if not self.size:
            return None, EARLIER
        learnt_s = Paces.of_user().expected_s(FIT, self.size)
        return (self.size * USUAL_S, RULE) if learnt_s is None else (learnt_s, EARLIER)

    def learn(self) -> None:
        """Remember how long the fit took."""
        from labkit.jobs.learnt_paces import Paces

        if self.whole:
            Paces.of_user().learn(FIT, self.size, time.monotonic() - self.began_s)


def _show(console: Console, results: Results, diagnose: bool) -> None:
    """Print a fit's results; with diagnose also the tested parts of the camera.

    Raises DataError for a requested quantity that could not be estimated.
    """
    from labkit.findings.findings import UNANSWERED_CODES

    said = {"session-mended"} | (
        set(UNANSWERED_CODES) if results.unanswered else set()
    )  # before the fit, and as the error
    for finding in results.findings:
        if finding.warns and finding.code not in said:
            console.warn(finding.text)
    if diagnose and results.parts_tried:
        console.table(results.part_rows())
    console.say(results.headline)
    for rows in (
        results.lens_rows(),
        results.colour_rows(),
        results.focus_rows(),
        results.wavefront_rows(),
    ):
        console.table(rows)
    if results.budget:
        console.table(results.budget_rows())
    if results.joint:
        most = max(results.joint, key=results.joint.__getitem__)
        console.say(
            f"jointly climbed: {most} moved most, by {results.joint[most]:.2f} standard errors"
        )
    console.say(f"results: {results.folder}/results.json")
    console.answer(results.as_json())
    if results.unanswered:
        raise DataError(results.unanswered)


def _modes(noll: str | None) -> tuple[int, int] | None:
    """Return the first and last mode of "4:22". Raises DataError."""
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
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name of the results to report.")
    ] = "latest",
    pdf: Annotated[
        bool,
        typer.Option(
            "--pdf", help="Print it as report.pdf too: needs Chromium, Chrome or Edge."
        ),
    ] = False,
    tile: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="ROW COLUMN",
            help="Tile whose wavefronts are shown one by one.",
            show_default="the tile nearest to the centre of the frame",
        ),
    ] = None,
) -> None:
    """Write the report as one HTML page. The page needs no other file; figures also lie in the folder."""
    a_session(session)
    from labkit.report.html import write_report
    from labkit.results import Results
    from labkit.session.session import Session

    console: Console = ctx.obj
    opened = Session.open(session)
    _ = opened.plan  # one that was altered is named before anything is reported
    opened.results_folder(name)  # and so are links
    with console.progress("reporting") as progress:
        made = write_report(
            Results.load(session, name), pdf=pdf, tile=tile, progress=progress
        )
    console.say(f"report: {made}")
    printed = made.with_suffix(".pdf") if pdf else None
    if printed is not None:
        console.say(f"PDF: {printed}")
    console.answer({"report": str(made), "pdf": printed and str(printed)})


@app.command()
def advise(
    ctx: typer.Context,
    plan: PlanPath,
    ranges_mm: Annotated[
        list[float] | None,
        typer.Option(
            "--range",
            metavar="MM",
            help="A range; may be repeated.",
            show_default="the plan's",
        ),
    ] = None,
    electrons: Annotated[
        float, typer.Option(metavar="N", help="Electrons at white in one photograph.")
    ] = 20_000,
    want: Annotated[
        float | None,
        typer.Option(
            metavar="WAVES",
            help="Report how many photographs this standard error requires.",
        ),
    ] = None,
) -> None:
    """Predict what a plan will determine. Standard errors at each range and of the lens, and what would reduce them."""
    a_plan(plan)
    from labkit.advice.advise import advise as advise_on
    from labkit.advice.tables import range_rows, session_rows
    from labkit.plan import Plan

    console: Console = ctx.obj
    advice = advise_on(
        Plan.load(plan), ranges_mm=ranges_mm, electrons=electrons, want_waves=want
    )
    console.table(range_rows(advice))
    console.table(session_rows(advice))
    for note in advice.notes:
        console.say(note)
    console.answer(advice.as_json())


@app.command()
def study(
    ctx: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="The study; a wrong name lists them.",
            autocompletion=studies,
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Run a few trials only, to see that it works.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for figure, CSV and JSON.",
            show_default="nothing is written",
        ),
    ] = None,
    workers: Workers = None,
) -> None:
    """Run an experiment of the thesis. Prints its claims beside ours as JSON."""
    from labkit.experiments.runner import run_study

    console: Console = ctx.obj
    with console.progress(name) as report:
        summary = run_study(name, quick=quick, folder=out, workers=workers, progress=report)
    console.json = True  # its contract: one JSON object, asked for or not
    console.answer(summary)
