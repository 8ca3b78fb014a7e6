"""The command line: wiring only. Exit status 0 done, 1 failed, 2 wrong usage or bad input, 130 interrupted."""

from __future__ import annotations

import logging
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from labkit import __version__
from labkit.console import Console, error_line
from labkit.errors import DataError, LabkitError, PlanError

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

GLOBAL_FLAGS = ("--debug", "--quiet", "--json")

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

CameraPlace = Annotated[str, typer.Argument(metavar="[PLAN.toml | ADDRESS]", help="a plan, or such as gphoto2:")]
PlanPath = Annotated[Path, typer.Argument(metavar="PLAN.toml", help="what to do and with what")]
SessionPath = Annotated[Path, typer.Argument(metavar="SESSION", help="the session's folder")]


def main() -> None:
    """Run the command line and leave with its exit status."""
    sys.exit(run(sys.argv[1:]))


def run(args: Sequence[str]) -> int:
    """Run a command line; returns the exit status. --debug, --quiet and --json may stand anywhere before a "--"."""
    end = args.index("--") if "--" in args else len(args)
    flags = [arg for arg in args[:end] if arg in GLOBAL_FLAGS]
    rest = [arg for arg in args[:end] if arg not in GLOBAL_FLAGS] + list(args[end:])
    console = Console()
    logging.getLogger("tifffile").addHandler(logging.NullHandler())  # it logs what it raises as well
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        status = typer.main.get_command(app).main(
            [*flags, *rest], prog_name="labkit", standalone_mode=False, obj=console
        )
        sys.stdout.flush()
    except BrokenPipeError:
        # whoever read our output has had enough; Python must not complain about it again on exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except BaseException as error:
        return _failed(error, console)
    if status == 130:
        return _interrupted(console)
    return status if isinstance(status, int) else 0


def _failed(error: BaseException, console: Console) -> int:
    """Say what went wrong, in one line; returns the exit status."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return _interrupted(console)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if console.debug:
        traceback.print_exception(error)
    if isinstance(error, TyperException):
        usage = error.format_message()
        if "\n" in usage:  # the help that a bare command prints
            print(usage, file=sys.stderr)
        else:
            error_line(f"{usage} See labkit --help.")
        return error.exit_code
    if isinstance(error, LabkitError):
        error_line(f"{error}{console.hint}")
        return error.exit_status
    if isinstance(error, OSError):
        error_line(f"{error.filename or 'the system'}: {error.strerror or error}")
        return 2
    error_line(f"this is a fault in labkit: {type(error).__name__}: {error}; --debug shows where")
    return 1


def _interrupted(console: Console) -> int:
    error_line(f"interrupted{console.hint}")
    return 130


def _version(asked: bool) -> None:
    if asked:
        print(f"labkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    ctx: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Options of every command; they may stand after it too."""
    ctx.obj.debug, ctx.obj.quiet, ctx.obj.json = debug, quiet, json


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


@app.command()
def devices(
    ctx: typer.Context,
    udev: Annotated[bool, typer.Option("--udev", help="Print the udev rules that give access, and no more.")] = False,
) -> None:
    """What is connected, who holds it, what may not be opened, and which drivers are installed."""
    from labkit.devices.inventory import look_around, udev_rules

    console: Console = ctx.obj
    found = look_around()
    if udev:
        console.say(udev_rules(found))
        console.answer({"udev": udev_rules(found)})
        return
    for title, rows in (
        ("USB", [[d.where, d.vendor_product, d.name, "camera" if d.is_camera else ""] for d in found.usb]),
        ("Serial ports", [[port.path, port.vendor_product, port.name, port.stable_path] for port in found.serial]),
        ("Installed drivers", [[device, ", ".join(f"{n}:" for n in names)] for device, names in found.drivers.items()]),
    ):
        console.say(title)
        console.table(rows or [["none"]], indent="  ")
    for note in found.notes:
        console.warn(note)
    console.answer(asdict(found))


@camera_app.command("settings")
def camera_settings(ctx: typer.Context, where: CameraPlace = "gphoto2:") -> None:
    """Everything that a camera lets be set or read."""
    from labkit.capture.camera_check import offered, open_alone

    console: Console = ctx.obj
    alone = open_alone(where)
    with alone.camera as camera:
        info, settings = camera.identify(), offered(camera)
    console.say(f"{info.model}, serial {info.serial}, {info.driver}")
    rows = [["setting", "now", "allowed"]]
    for setting in settings:
        allowed = "read only" if setting.readonly else ", ".join(map(str, setting.choices))
        cells = (setting.name, str(setting.value), allowed)
        rows.append(["".join(letter for letter in cell if letter.isprintable()) for cell in cells])
    console.table(rows)
    console.answer({**asdict(info), "settings": [asdict(setting) for setting in settings]})


@camera_app.command("test")
def camera_test(ctx: typer.Context, where: CameraPlace = "gphoto2:") -> None:
    """Take one photograph, keep nothing of it: focus, clipping, noise."""
    from labkit.capture.camera_check import open_alone, take_test_frame

    console: Console = ctx.obj
    alone = open_alone(where)
    with alone.camera:
        found = take_test_frame(alone)
    console.say(f"{found.pixels[0]} × {found.pixels[1]} pixels, {found.exposure_s:g} s, ISO {found.iso or 'unknown'}")
    rows = [["colour", "middle", "brightest", "full", "noise"]]
    for colour in found.colours:
        full = f"{colour.full_percent:.2g} %"
        rows.append([colour.name, f"{colour.median:.0f}", f"{colour.brightest:.0f}", full, f"{colour.noise:.1f}"])
    console.table(rows)
    if found.edge_px is not None:
        blur = "" if found.blur_px is None else f"; a point spreads over {found.blur_px:.1f} pixels"
        console.say(f"focus: the sharpest edges rise over {found.edge_px:.1f} pixels{blur}")
    console.say(f"target: {found.target}")
    for words in (*found.problems, *(f"check by hand: {words}" for words in found.by_hand)):
        console.warn(words)
    console.answer(asdict(found))


@target_app.command("render")
def target_render(
    ctx: typer.Context,
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="a plan, or sierpinski:order=5,size_mm=46.8")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="what to write: .png or .pdf")],
    dpi: Annotated[float | None, typer.Option(help="Raster in dots per inch.")] = None,
    pixels: Annotated[int | None, typer.Option(help="Raster in dots along the height, instead of --dpi.")] = None,
) -> None:
    """A target as a picture of its true size."""
    from labkit.target import open_target
    from labkit.target_file import read_spec, render_file

    console: Console = ctx.obj
    made = render_file(open_target(read_spec(spec)), file, dpi=dpi, pixels=pixels)
    height, width = made.size_mm
    console.say(f"{made.path}: {made.pixels[0]} × {made.pixels[1]} pixels, {height:g} × {width:g} mm")
    for note in made.notes:
        console.say(note)
    console.answer({**asdict(made), "path": str(made.path)})


@target_app.command("serve")
def target_serve(
    ctx: typer.Context,
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="a plan, or sierpinski:order=5,size_mm=46.8")],
    panel: Annotated[
        list[str] | None, typer.Option(help="The display's panel; again for each further one. By default the plan's.")
    ] = None,
    listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="0.0.0.0:8642 to be reached from other machines.")
    ] = "127.0.0.1:8642",
) -> None:
    """A target on an iPad or any browser, until Ctrl-C; other pictures by the operator's page."""
    from labkit.devices.context import DeviceContext
    from labkit.devices.registry import open_display
    from labkit.devices.serve_target import panel_plans, serve_target
    from labkit.target import open_target
    from labkit.target_file import read_spec

    console: Console = ctx.obj
    target = open_target(read_spec(spec))
    context = DeviceContext(link=console.link, tell=console.warn)
    with ExitStack() as stack:
        plans = panel_plans(spec, panel or [], listen)
        displays = [stack.enter_context(open_display(address, plan, context)) for address, plan in plans]
        with suppress(KeyboardInterrupt):  # the way to end it
            serve_target(target, displays, context)


@app.command()
def capture(
    ctx: typer.Context,
    plan: PlanPath,
    session: SessionPath,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a session that was interrupted.")] = False,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Use simulated devices, whatever the plan names.")
    ] = False,
    no_preflight: Annotated[
        bool, typer.Option("--no-preflight", help="Begin without looking first whether all is right.")
    ] = False,
    monitor: Annotated[
        bool, typer.Option("--monitor", help="Serve an operator's page; a web display brings one anyway.")
    ] = False,
    listen: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Where --monitor listens, such as 0.0.0.0:8642 for the lab's network."),
    ] = None,
) -> None:
    """Run a plan: flats and photographs of the target at every range."""
    from labkit.capture.capture import capture as run_capture
    from labkit.capture.sequence import missing, picture_for
    from labkit.devices.context import DeviceContext
    from labkit.devices.operator import Operator
    from labkit.devices.registry import open_devices, open_monitor
    from labkit.plan import load_plan
    from labkit.session.session import JOURNAL, begin, refuse_existing

    console: Console = ctx.obj
    flags = [flag for flag, given in (("--simulate", simulate), ("--monitor", monitor)) if given]
    flags += ["--listen", listen] if listen else []
    again = shlex.join(["labkit", "capture", str(plan), str(session), "--resume", *flags])
    wanted = load_plan(plan)
    if not resume:
        refuse_existing(session)
    context = DeviceContext(link=console.link, tell=console.warn, operator=Operator(console.still))
    with ExitStack() as stack:
        going_on = resume and (session / JOURNAL).exists()
        if going_on and not missing(opened := stack.enter_context(begin(plan, session, resume))):
            console.say(f"{session}: {len(opened.frames)} frames, all that the plan asks for")
            console.answer({"session": str(session), "frames": len(opened.frames)})
            return
        if monitor or listen:
            stack.enter_context(open_monitor(f"web://{listen}" if listen else "web:", wanted, context))
        bench = stack.enter_context(open_devices(wanted, "simulated:" if simulate else None, context))
        picture_for(wanted, bench)  # a plan that cannot be run here begins no session
        console.hint = f"; every photograph so far is safe, go on with: {again}"
        if not going_on:
            opened = stack.enter_context(begin(plan, session, resume))
        report = stack.enter_context(console.progress("capturing"))
        for warning in opened.warnings:
            console.warn(warning)
        ask = partial(context.operator.ask, wants="done") if context.operator.present else None
        run_capture(opened, bench, progress=report, ask=ask, warn=console.warn, check=not no_preflight)
        frames = len(opened.frames)
    console.say(f"{session}: {frames} frames")
    console.answer({"session": str(session), "frames": frames})


def _ask(request: str) -> None:
    typer.prompt(f"{request}, then press Enter", default="", show_default=False, err=True)


@rail_app.command("calibrate")
def rail_calibrate(
    ctx: typer.Context,
    plan: PlanPath,
    at: Annotated[list[float] | None, typer.Option(metavar="MM", help="A rail position to measure at; again.")] = None,
) -> None:
    """Find rail.direction and rail.range_at_zero_mm: the rail moves, you measure."""
    from labkit.devices.context import DeviceContext
    from labkit.devices.rail_calibration import find_zero, stops
    from labkit.devices.registry import open_rail
    from labkit.plan import load_plan

    console: Console = ctx.obj
    wanted = load_plan(plan)
    if wanted.rail is None:
        raise PlanError("the plan has no [rail]")
    with open_rail(wanted.rail.address, wanted, DeviceContext()) as rail:
        places = stops(rail.travel_mm, at or [])
        _ask(f"The rail will home and then move to {', '.join(f'{mm:g}' for mm in places)} mm. Clear its way")
        rail.home()
        positions, ranges = [], []
        for place in places:
            positions.append(rail.move_to(place))
            question = f"The rail stands at {positions[-1]:.3f} mm. Range from the target to the lens, in mm"
            ranges.append(typer.prompt(question, type=float, err=True))
    zero = find_zero(positions, ranges)
    error = "" if zero.std_mm is None else f"  # ± {zero.std_mm:.1f}"
    console.say(f"[rail]\nrange_at_zero_mm = {zero.range_at_zero_mm:.1f}{error}\ndirection = {zero.direction}")
    for place, misfit in zip(positions, zero.misfit_mm, strict=True):
        console.say(f"# at {place:g} mm measured {misfit:+.1f} mm from that")
    console.answer(asdict(zero))


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
    kinds = {kind: sum(frame.kind == kind for frame in made.frames) for kind in ("target", "flat", "dark", "bias")}
    console.say(f"{session}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count))
    console.answer({"session": str(session), "frames": len(made.frames), "kinds": kinds})


@app.command()
def verify(ctx: typer.Context, session: SessionPath) -> None:
    """Check every frame against its checksum, and the journal against the folder."""
    from labkit.session.session import Session
    from labkit.session.session import verify as find_problems

    console: Console = ctx.obj
    opened = Session.open(session)
    problems = find_problems(opened)
    for warning in opened.warnings:
        console.warn(warning)
    console.answer({"session": str(session), "frames": len(opened.frames), "problems": problems})
    if problems:
        raise LabkitError(f"{session}: {'; '.join(problems)}")
    console.say(f"{session}: {len(opened.frames)} frames, all as they were taken")


@app.command()
def fit(
    ctx: typer.Context,
    session: SessionPath,
    range_mm: Annotated[float | None, typer.Option("--range", metavar="MM", help="Only this range.")] = None,
    channel: Annotated[str | None, typer.Option(metavar="NAME", help="Only this channel.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes; by default one a core.")] = None,
) -> None:
    """Flat field, wavefronts, best focus."""
    from labkit.analysis.wavefronts import fit_session
    from labkit.session.session import Session
    from labkit.summary import focus_rows, read_results, wavefront_rows

    console: Console = ctx.obj
    opened = Session.open(session)
    for warning in opened.warnings:
        console.warn(warning)
    with console.progress("fitting") as report:
        made = fit_session(opened, range_mm=range_mm, channel=channel, workers=workers, progress=report)
    results: dict[str, Any] = read_results(opened.results_folder())
    for warning in results["warnings"]:
        if warning not in (*opened.warnings, made.unanswered):
            console.warn(warning)
    console.table(wavefront_rows(results))
    console.table(focus_rows(results))
    console.say(f"results: {opened.results_folder() / 'results.json'}")
    console.answer(results)
    if made.unanswered:
        raise DataError(made.unanswered)


@app.command()
def report(ctx: typer.Context, session: SessionPath) -> None:
    """The measurement as one HTML page with figures."""
    from labkit.report.html import write_report
    from labkit.session.session import Session

    console: Console = ctx.obj
    made = write_report(Session.open(session).results_folder())
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
    from labkit.analysis.advise import advise as advise_on
    from labkit.plan import load_plan
    from labkit.summary import advice_rows

    console: Console = ctx.obj
    advice = advise_on(load_plan(plan), ranges_mm=ranges_mm, electrons=electrons, want_waves=want)
    told, focus = advice_rows(advice)
    console.table(told)
    console.table(focus)
    for note in advice.notes:
        console.say(note)
    console.answer(advice.as_json())


@app.command()
def study(
    ctx: typer.Context,
    name: Annotated[str, typer.Argument(metavar="NAME", help="which; a wrong one lists them")],
    quick: Annotated[bool, typer.Option("--quick", help="A few trials: to see that it works.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write its figure, CSV and JSON here.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes; by default one a core.")] = None,
) -> None:
    """An experiment of the thesis; prints its claims beside ours as JSON."""
    from labkit.execute import default_workers
    from labkit.experiments.runner import Setting, run_study

    console: Console = ctx.obj
    with console.progress(name) as report:
        summary = run_study(name, Setting(quick, workers or default_workers(), report), out)
    console.json = True  # its contract: one JSON object, asked for or not
    console.answer(summary)
