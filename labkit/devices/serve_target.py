"""Shows a target on displays until Ctrl-C, or whatever other picture a person picks on the operator's page."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Display, Picture
from labkit.devices.registry import observers_of, open_display
from labkit.devices.test_patterns import PATTERNS, pattern
from labkit.errors import DisplayError, PlanError
from labkit.panel.panels import PANELS
from labkit.panel.picture import panel_picture
from labkit.plan import DisplaySettings, Plan
from labkit.target.grid import whole_target
from labkit.target.target import Target

TARGET_CHOICE = "target"
CHOICES = (TARGET_CHOICE, *PATTERNS)

REQUEST_POLL_S = 0.2
"""Interval between checks of `going`."""

RETRY_S = 1.0
"""After a display has failed; most of them have waited long before they say so."""


def serve_target(
    spec: str,
    panels: Sequence[str] = (),
    listen: str = "127.0.0.1:8642",
    *,
    context: DeviceContext | None = None,
    going: Callable[[], bool] = lambda: True,
) -> None:
    """Show a target in a browser, on an iPad or any display, while `going`.

    Parameters
    ----------
    spec : path of a plan, or a target such as "sierpinski:order=5,size_mm=46.8"
    panels : names of the displays' panels; by default the plan's
    listen : HOST:PORT of the page
    context : what drivers are given, for links and warnings
    going : asked again and again; the target is shown until it returns False

    Raises
    ------
    PlanError, TargetError, DisplayError
        of the plan, of a target too large for the panel, of the page

    >>> labkit.serve_target("sierpinski:order=5,size_mm=46.8", ["ipad-9.7-retina"], "0.0.0.0:8642")
    """
    context = context or DeviceContext()
    target = whole_target(spec)
    links: list[tuple[str, str]] = []
    silent = replace(context, show_link=lambda what, url: links.append((what, url)))
    with ExitStack() as stack:
        displays = [
            stack.enter_context(open_display(address, plan, silent))
            for address, plan in panel_plans(spec, panels, listen)
        ]
        # an address is for a page that stays: whatever is refused was refused before
        for display in displays:
            _picture(TARGET_CHOICE, target, display)
        for link in links:
            context.show_link(*link)
        keep_showing(target, displays, context, going)


def keep_showing(
    target: Target,
    displays: Sequence[Display],
    context: DeviceContext,
    going: Callable[[], bool] = lambda: True,
) -> None:
    """Show the target on every display, then each of CHOICES that arrives by context.requests, while `going`.

    Wait without limit for displays to become ready. Raises TargetError for a panel
    too small for the target.
    """
    pictures = {
        name: [_picture(name, target, display) for display in displays] for name in CHOICES
    }
    queues: list[SimpleQueue[Picture]] = [SimpleQueue() for _ in displays]
    ended = threading.Event()

    def serving() -> bool:
        return going() and not ended.is_set()

    for display, queue in zip(displays, queues, strict=True):
        threading.Thread(
            target=_keep_showing, args=(display, queue, context, serving), daemon=True
        ).start()
    observers = observers_of(context, displays)
    picked = TARGET_CHOICE
    try:
        while going():
            for observer in observers:
                observer.noted("serving", choices=CHOICES, picked=picked)
            for queue, picture in zip(queues, pictures[picked], strict=True):
                queue.put(picture)
            picked = _next_request(context, going) or picked
    finally:
        ended.set()  # Ctrl-C: displays are closed next, which is no trouble to warn of


def panel_plans(spec: str, panels: Sequence[str], listen: str) -> list[tuple[str, Plan]]:
    """Return (address, plan) of each display: the named panels on HOST:PORT, or the display of the plan file `spec`.

    These plans hold [display] only. Raises PlanError.
    """
    if not panels and spec.endswith(".toml"):
        settings = Plan.load(Path(spec)).display
        if settings is None:
            raise PlanError(f"plan {spec}: it has no [display]; add one, or give --panel")
        return [(settings.address, Plan.model_construct(display=settings))]
    if not panels:
        raise PlanError(
            f"which panel? Give --panel, one of {', '.join(sorted(PANELS))}; or a plan with [display]"
        )
    plans = []
    for number, panel in enumerate(panels, 1):
        address = f"web://{listen}" + (f"/{number}" if len(panels) > 1 else "")
        plans.append(
            (
                address,
                Plan.model_construct(display=DisplaySettings(address=address, panel=panel)),
            )
        )
    return plans


def _picture(name: str, target: Target, display: Display) -> Picture:
    return (
        panel_picture(target, display.panel).grey
        if name == TARGET_CHOICE
        else pattern(name, display.panel)
    )


def _next_request(context: DeviceContext, going: Callable[[], bool]) -> str | None:
    while going():
        try:
            request = context.requests.get(timeout=REQUEST_POLL_S)
        except Empty:
            continue
        if request in CHOICES:
            return request
    return None


def _keep_showing(
    display: Display,
    queue: SimpleQueue[Picture],
    context: DeviceContext,
    going: Callable[[], bool],
) -> None:
    """Show the queue's latest picture, again and again until success or a later picture."""
    wanted: Picture | None = None
    while going():
        try:
            wanted = queue.get(wanted is None, REQUEST_POLL_S)
            continue
        except Empty:
            pass
        if wanted is None:
            continue
        try:
            display.show(wanted)
            wanted = None
        except DisplayError as error:
            if going():
                context.warn(str(error))
                time.sleep(RETRY_S)
