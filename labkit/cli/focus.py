"""`labkit camera focus`: photograph again and again, with the sharpness of each photograph."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import CameraPlace, camera_app
from labkit.cli.console import Console
from labkit.cli.paths import perhaps_a_plan
from labkit.errors import PlanError

if TYPE_CHECKING:
    from labkit.acquisition.camera_check import LoneCamera
    from labkit.acquisition.focusing import FocusReading
    from labkit.devices.context import DeviceContext

HISTORY = 24
BARS = "▁▂▃▄▅▆▇█"
LEAST_SPAN = 0.1  # of the sharpest: less is the noise of one frame and the next

# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.


At = Annotated[
    float | None,
    typer.Option(
        "--range",
        metavar="MM",
        help="Home the plan's rail and move it to this range first.",
        show_default="it stays",
    ),
]
Monitor = Annotated[
    bool,
    typer.Option("--monitor", help="Serve an operator's page that shows each photograph."),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Where that page listens, such as 0.0.0.0:8642.",
        show_default="this machine only",
    ),
]


@camera_app.command("focus")
def camera_focus(
    ctx: typer.Context,
    where: CameraPlace = "gphoto2:",
    range_mm: At = None,
    monitor: Monitor = False,
    listen: Listen = None,
) -> None:
    """Photograph on and on, to focus by. Sharpness, clipping, the target's outline, until Ctrl-C; nothing is kept."""
    perhaps_a_plan(where)
    from labkit.acquisition.camera_check import open_lone_camera
    from labkit.acquisition.focusing import focus
    from labkit.devices.context import DeviceContext
    from labkit.devices.operator import Operator
    from labkit.devices.registry import observers_of, open_monitor

    console: Console = ctx.obj
    context = DeviceContext(
        show_link=console.link, warn=console.warn, operator=Operator(console.still)
    )
    readings: list[FocusReading] = []
    with ExitStack() as stack:
        alone = open_lone_camera(where, context)
        stack.enter_context(alone.camera)
        if monitor or listen:
            page = stack.enter_context(
                open_monitor(f"web://{listen}" if listen else "web:", alone.plan, context)
            )
            context = replace(context, observers=(page,))
        shown = _set_up(alone, range_mm, context, stack)
        with suppress(KeyboardInterrupt):  # the way to end it
            for reading in focus(alone, observers_of(context, shown)):
                readings.append(reading)
                console.say(line(readings))
    _say_best(console, readings)


def _set_up(
    alone: LoneCamera, range_mm: float | None, context: DeviceContext, stack: ExitStack
) -> Sequence[object]:
    """Show the plan's target and move its rail, if the plan has them; return the opened devices."""
    from labkit.acquisition.sequence import shown_target
    from labkit.devices.registry import open_rail

    plan, opened = alone.plan, list[object]()
    if range_mm is not None:
        if plan.rail is None:
            raise PlanError(
                f"--range {range_mm:g}: to move a rail it takes a plan with [rail]"
            )
        rail = stack.enter_context(open_rail(plan.rail.address, plan, context))
        reached = sorted(
            plan.rail.range_mm(end)
            for end in (rail.travel_mm.low_mm, rail.travel_mm.high_mm)
        )
        if not reached[0] <= range_mm <= reached[1]:
            raise PlanError(
                f"--range {range_mm:g}: the rail reaches {reached[0]:g} to {reached[1]:g} mm"
            )
        rail.home()
        rail.move_to(plan.rail.position_mm(range_mm))
        opened.append(rail)
    if plan.display is not None:
        opened.append(stack.enter_context(shown_target(plan, context)))
    return opened


def line(readings: Sequence[FocusReading]) -> str:
    """Return one line on the last reading, compared with the readings before."""
    last = readings[-1]
    words = [f"{last.source} {last.number}"]
    if last.edge_px is not None:
        edges = [reading.edge_px for reading in readings if reading.edge_px is not None]
        words.append(
            f"edges rise over {last.edge_px:.1f} px, best {min(edges):.1f} {bars(edges)}"
        )
    words.append(f"clipped {last.full_percent:.2g} %")
    if last.corners_px is not None:
        words.append(
            f"target: blur {last.blur_px:.1f} px, {last.margin_px:.0f} px inside the frame"
        )
    return "; ".join([*words, *([last.note] if last.note else [])])


def bars(values: Sequence[float]) -> str:
    """Return the last values as bars of proportional height."""
    least = min(values)
    span = max(max(values) - least, LEAST_SPAN * least) or 1.0
    shown = deque(values, maxlen=HISTORY)
    return "".join(BARS[round((len(BARS) - 1) * (value - least) / span)] for value in shown)


def _say_best(console: Console, readings: Sequence[FocusReading]) -> None:
    sharp = [reading for reading in readings if reading.edge_px is not None]
    best = min(sharp, key=lambda reading: reading.edge_px or 0.0, default=None)
    if best is not None:
        console.say(
            f"sharpest: {best.source} {best.number}, edges rise over {best.edge_px:.1f} px"
        )
    console.answer(
        {
            "best": None if best is None else best.number,
            "readings": [asdict(each) for each in readings],
        }
    )
