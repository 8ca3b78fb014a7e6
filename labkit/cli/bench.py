"""Commands for devices: what is connected, camera, rail, targets, capture."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import (
    CameraPlace,
    PlanPath,
    SessionPath,
    a_file,
    a_plan,
    app,
    camera_app,
    panels,
    perhaps_a_plan,
    rail_app,
    target_app,
    targets,
)
from labkit.cli.console import Console
from labkit.cli.device_tables import NONE_OF, device_tables
from labkit.errors import LabkitError

if TYPE_CHECKING:
    from labkit.devices.context import Devices
    from labkit.devices.operator import Operator
    from labkit.plan import Plan
    from labkit.session.session import Session

TargetText = Annotated[
    str,
    typer.Argument(
        metavar="SPEC",
        help="A plan, or a target such as sierpinski:order=5,size_mm=46.8.",
        autocompletion=targets,
    ),
]

SAFE = "every photograph so far is safe, "
SESSION_DAMAGED = "photographs are missing or the journal is damaged: labkit verify names them; mend that, then "

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


@app.command()
def devices(
    ctx: typer.Context,
    udev: Annotated[
        bool, typer.Option("--udev", help="Print only the udev rules that give access.")
    ] = False,
    no_probe: Annotated[
        bool,
        typer.Option(
            "--no-probe",
            help="Open no serial port: that restarts some controllers, which then need homing.",
        ),
    ] = False,
) -> None:
    """List devices, ports and drivers. Also which program holds each device, and what may not be opened."""
    from labkit.devices.inventory import list_connected, udev_rules

    console: Console = ctx.obj
    connected = list_connected(probe=not (udev or no_probe))
    if udev:
        console.say_lines(udev_rules(connected))
        console.answer({"udev": udev_rules(connected)})
        return
    for title, rows in device_tables(connected):
        nothing = "not looked at" if rows is None else NONE_OF.get(title, "none")
        console.say(title)
        console.table(rows or [[nothing]], indent="  ")
    for note in connected.notes:
        console.warn(note)
    console.answer(asdict(connected))


@camera_app.command("settings")
def camera_settings(ctx: typer.Context, where: CameraPlace = "gphoto2:") -> None:
    """List what a camera lets be set or read."""
    perhaps_a_plan(where)
    from labkit.acquisition.camera_check import camera_settings as settings_of

    console: Console = ctx.obj
    info, settings = settings_of(where)
    console.say(f"{info.model}, serial {info.serial}, {info.driver}")
    rows = [["setting", "now", "allowed"]]
    for setting in settings:
        allowed = "read only" if setting.readonly else ", ".join(map(str, setting.choices))
        cells = (setting.name, str(setting.value), allowed)
        rows.append([*cells])
    console.table(rows)
    console.answer({**asdict(info), "settings": [asdict(setting) for setting in settings]})


@camera_app.command("test")
def camera_test(ctx: typer.Context, where: CameraPlace = "gphoto2:") -> None:
    """Take one photograph and judge it. Reports light, clipping, noise, focus and the target; keeps nothing.

    With a plan its display shows the target first, and the light is judged in its channels.
    """
    perhaps_a_plan(where)
    from labkit.acquisition.camera_check import check_camera
    from labkit.devices.context import DeviceContext

    console: Console = ctx.obj
    found = check_camera(where, DeviceContext(show_link=console.link, warn=console.warn))
    console.warn(*found.problems)
    console.say(
        f"{found.pixels[0]} × {found.pixels[1]} pixels, {found.exposure_s:g} s, ISO {found.iso or 'unknown'}"
    )
    rows = [["colour", "median", "brightest", "saturated", "noise"]]
    for colour in found.colours:
        full = f"{colour.full_percent:.2g} %"
        rows.append(
            [
                colour.name,
                f"{colour.median:.0f}",
                f"{colour.brightest:.0f}",
                full,
                f"{colour.noise:.1f}",
            ]
        )
    console.table(rows)
    if found.edge_px is not None:
        blur = (
            ""
            if found.blur_px is None
            else f"; a point spreads over {found.blur_px:.1f} pixels"
        )
        console.say(f"focus: the sharpest edges rise over {found.edge_px:.1f} pixels{blur}")
    console.say(f"target: {found.target}")
    console.warn(*(f"check by hand: {words}" for words in found.by_hand))
    console.answer(asdict(found))


@camera_app.command("tone")
def camera_tone(
    ctx: typer.Context,
    photograph: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGE",
            help="The photograph of the wedge: JPEG, PNG or TIFF.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="TONE.toml",
            help="File to write; nothing is overwritten.",
            show_default="the terminal",
        ),
    ] = None,
) -> None:
    """Measure a camera's tone curve. From a photograph of the wedge of labkit target serve; prints a table for the plan."""
    a_file(photograph)
    from labkit.calibration.tone_wedge import measure_tone
    from labkit.storage.files import write_new

    console: Console = ctx.obj
    tone = measure_tone(photograph)
    if out is None:
        console.say_lines(tone.to_toml())
    else:
        write_new(out, tone.to_toml() + "\n")
        console.say(f"{out}: put it into the plan")
    for note in tone.notes():
        console.warn(note)
    console.answer(tone.as_json())


@target_app.command("render")
def target_render(
    ctx: typer.Context,
    spec: TargetText,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="File to write: .png or .pdf.")
    ],
    dpi: Annotated[
        float | None,
        typer.Option(
            metavar="DPI",
            help="Raster in dots per inch.",
            show_default="what suits the file",
        ),
    ] = None,
    pixels: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Raster in dots along the height, instead of --dpi."
        ),
    ] = None,
) -> None:
    """Write a target to print, in its true size."""
    perhaps_a_plan(spec)
    from labkit.target.grid import whole_target
    from labkit.target.rendering import render_target

    console: Console = ctx.obj
    made = render_target(whole_target(spec), file, dpi=dpi, pixels=pixels)
    height, width = made.size_mm
    console.say(
        f"{made.path}: {made.pixels[0]} × {made.pixels[1]} pixels, {height:g} × {width:g} mm"
    )
    for note in made.notes:
        console.say(note)
    console.answer({**asdict(made), "path": str(made.path)})


@target_app.command("serve")
def target_serve(
    ctx: typer.Context,
    spec: TargetText,
    panel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PANEL",
            help="The display's panel; may be repeated for several displays.",
            show_default="the plan's",
            autocompletion=panels,
        ),
    ] = None,
    listen: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT", help="Where to listen; 0.0.0.0:8642 for other machines."
        ),
    ] = "127.0.0.1:8642",
) -> None:
    """Show a target in a browser. On an iPad or any display, until Ctrl-C; the operator's page shows patterns too."""
    perhaps_a_plan(spec)
    from labkit.devices.context import DeviceContext
    from labkit.devices.serve_target import serve_target

    console: Console = ctx.obj
    context = DeviceContext(show_link=console.link, warn=console.warn)
    with suppress(KeyboardInterrupt):  # the way to end it
        serve_target(spec, panel or (), listen, context=context)


Resume = Annotated[
    bool, typer.Option("--resume", help="Continue a session that was interrupted.")
]
Simulate = Annotated[
    bool, typer.Option("--simulate", help="Use simulated devices instead of the plan's.")
]
NoPreflight = Annotated[
    bool, typer.Option("--no-preflight", help="Begin without checking everything first.")
]
WithMonitor = Annotated[
    bool,
    typer.Option("--monitor", help="Serve an operator's page; a web display always does."),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Where the page listens; 0.0.0.0:8642 for the lab's network.",
        show_default="this machine only",
    ),
]


@app.command()
def capture(
    ctx: typer.Context,
    plan: PlanPath,
    session: SessionPath,
    resume: Resume = False,
    simulate: Simulate = False,
    no_preflight: NoPreflight = False,
    monitor: WithMonitor = False,
    listen: Listen = None,
) -> None:
    """Photograph what a plan asks for. Flats and target at every range, then darks; Ctrl-C and --resume are safe."""
    a_plan(plan)
    from labkit.acquisition.capture import run_plan as run_capture
    from labkit.acquisition.sequence import missing, picture_for
    from labkit.plan import Plan
    from labkit.session.journal import JOURNAL
    from labkit.session.making import refuse_existing
    from labkit.session.session import begin

    console: Console = ctx.obj
    wanted = Plan.load(plan)
    if not resume:
        refuse_existing(session, "--resume")
    with ExitStack() as stack:
        begun = resume and (session / JOURNAL).exists()
        if begun and not missing(
            opened := stack.enter_context(begin(plan, session, resume))
        ):
            _report_complete(console, opened)
            return
        page = f"web://{listen}" if listen else "web:" if monitor else None
        bench, operator = stack.enter_context(_open_bench(console, wanted, simulate, page))
        picture_for(wanted, bench)  # a plan that cannot be run here begins no session
        console.hint = f"; go on with: {_resume_command(ctx)}"
        if not begun:
            opened = stack.enter_context(begin(plan, session, resume))
        stack.enter_context(_saying_what_is_safe(console, opened))
        for warning in opened.warnings:
            console.warn(warning)
        report = stack.enter_context(console.progress("capturing"))
        ask = partial(operator.ask, wants="done") if operator.present else None
        run_capture(
            opened,
            bench,
            progress=report,
            ask=ask,
            warn=console.warn,
            check=not no_preflight,
        )
    _report_capture(console, opened)


@contextmanager
def _open_bench(
    console: Console, plan: Plan, simulate: bool, page_address: str | None
) -> Iterator[tuple[Devices, Operator]]:
    """Open the plan's devices and the operator, with an operator's page at an address if one is given."""
    from labkit.devices.context import DeviceContext
    from labkit.devices.operator import Operator
    from labkit.devices.registry import open_devices, open_monitor

    context = DeviceContext(
        show_link=console.link, warn=console.warn, operator=Operator(console.still)
    )
    with ExitStack() as stack:
        if page_address:
            page = stack.enter_context(open_monitor(page_address, plan, context))
            context = replace(context, observers=(page,))
        yield (
            stack.enter_context(
                open_devices(plan, "simulated:" if simulate else None, context)
            ),
            context.operator,
        )


@contextmanager
def _saying_what_is_safe(console: Console, session: Session) -> Iterator[None]:
    """State which photographs are safe if the capture is interrupted."""
    from labkit.session.verify import is_safe

    try:
        yield
    except BaseException:
        if session.frames:
            safe = SAFE if is_safe(session) else SESSION_DAMAGED
            console.hint = f"; {safe}{console.hint.removeprefix('; ')}"
        raise


def _resume_command(ctx: typer.Context) -> str:
    """Return the command that continues an interrupted capture: as typed, with --resume."""
    console: Console = ctx.obj
    given = {
        "resume": True,
        **ctx.params,
        "quiet": console.quiet,
        "json": console.json,
        "debug": console.debug,
    }
    words = [str(given.pop(name)) for name in ("plan", "session")]
    for name, value in {**given, "resume": True}.items():
        if value:
            words += (
                [f"--{name.replace('_', '-')}"]
                if value is True
                else [f"--{name}", str(value)]
            )
    return shlex.join(["labkit", "capture", *words])


def _report_complete(console: Console, session: Session) -> None:
    """Report a complete session. Raises LabkitError for damaged photographs."""
    from labkit.session.verify import altered, as_error

    if damage := altered(session):
        raise LabkitError(
            f"{session.folder} has all that the plan asks for, but {as_error(damage)}"
        )
    _report_capture(console, session, ", all that the plan asks for")


def _report_capture(console: Console, session: Session, remark: str = "") -> None:
    from labkit.acquisition.sequence import next_command

    frames = len(session.frames)
    command = next_command(session.plan, session.folder)
    console.say(f"{session.folder}: {frames} frames{remark}; next: {command}")
    console.answer({"session": str(session.folder), "frames": frames})


@rail_app.command("calibrate")
def rail_calibrate(
    ctx: typer.Context,
    plan: PlanPath,
    at: Annotated[
        list[float] | None,
        typer.Option(
            metavar="MM",
            help="A rail position to measure at; may be repeated.",
            show_default="three, over the travel",
        ),
    ] = None,
) -> None:
    """Determine the rail's direction and zero. The rail moves, you measure; prints two lines for the plan."""
    a_plan(plan)
    from labkit.cli.questions import ask, ask_until, at_terminal
    from labkit.devices.rail_calibration import calibrate_rail, read_range
    from labkit.plan import Plan

    console: Console = ctx.obj
    wanted = Plan.load(plan)
    read = partial(read_range, focal_length_mm=wanted.lens.focal_length_mm)
    zero = calibrate_rail(
        wanted,
        lambda question: ask_until(question, read),
        at_mm=at or (),
        ready=lambda words: ask(f"{words}. Clear its way, press Enter"),
        say=console.warn if at_terminal() else None,
    )
    std = "" if zero.std_mm is None else f"  # ± {zero.std_mm:.1f}"
    console.say_lines(
        f"[rail]\nrange_at_zero_mm = {zero.range_at_zero_mm:.1f}{std}\ndirection = {zero.direction}"
    )
    for place, misfit in zip(zero.positions_mm, zero.misfit_mm, strict=True):
        console.say(f"# at {place:g} mm measured {misfit:+.1f} mm from that")
    console.answer(asdict(zero))
