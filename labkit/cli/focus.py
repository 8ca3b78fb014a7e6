"""`labkit camera focus`: photograph again and again, with the sharpness of each photograph."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.app import CameraPlace, camera_app, perhaps_a_plan
from labkit.cli.console import Console

if TYPE_CHECKING:
    from labkit.acquisition.focusing import FocusReading

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
    from labkit.acquisition.focusing import watch_focus
    from labkit.devices.context import DeviceContext
    from labkit.devices.operator import Operator

    console: Console = ctx.obj
    context = DeviceContext(
        show_link=console.link, warn=console.warn, operator=Operator(console.still)
    )
    page = f"web://{listen}" if listen else "web:" if monitor else None
    readings: list[FocusReading] = []
    with (
        closing(
            watch_focus(where, range_mm=range_mm, page=page, context=context)
        ) as watched,
        suppress(KeyboardInterrupt),  # the way to end it
    ):
        for reading in watched:
            readings.append(reading)
            console.say(line(readings))
    _say_best(console, readings)


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
