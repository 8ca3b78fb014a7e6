"""A display in any browser: an iPad or a monitor fills its screen with labkit's page.

`web://127.0.0.1:8642` serves this machine alone; `web://0.0.0.0:8642` also serves the lab's
network. Addresses of several simultaneous displays end in names: `web://0.0.0.0:8642/left`
and `web://0.0.0.0:8642/right` share one server.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, closing

from labkit.devices.context import DeviceContext, Glass
from labkit.devices.protocols import ClosesItself, PanelInfo, Picture, Shown
from labkit.devices.test_patterns import pattern
from labkit.drivers.web.address import parse_address, shared_server
from labkit.drivers.web.monitor import Monitor
from labkit.drivers.web.screen import Order, Report, Screen
from labkit.errors import DisplayError, PlanError
from labkit.panel.panels import panel_info
from labkit.plan import Plan

HOLD_S = 600.0
"""Longest pause of a capture for a faulty display; then the capture stops and can be resumed."""

PATIENCE_S = 2.0
"""A display that is right again sooner is not worth a warning."""


def open_display(address: str, plan: Plan, context: DeviceContext) -> WebDisplay:
    """Open the screen of an address; the first screen starts the server.

    Raises PlanError, or DisplayError for a port in use.
    """
    if plan.display is None:
        raise PlanError("a web display needs a plan with [display]")
    host, port, name = parse_address(address)
    panel = panel_info(plan.display)
    with ExitStack() as stack:
        server = stack.enter_context(closing(shared_server(host, port, context))).part
        screen = server.add_screen(name, panel)
        stack.callback(server.remove_screen, name)
        close = stack.pop_all().close
    context.show_link(
        f'Open this on the display "{name}" ({panel.pixels[1]} × {panel.pixels[0]} pixels)',
        screen.url,
    )
    return WebDisplay(screen, server.monitor, close, context.warn, glass=context.glass)


class WebDisplay(ClosesItself):
    """A Display on a web page: a picture counts as shown when its page has read it back.

    hold_s: longest wait for a page that is not ready; glass: receives the picture sent to
    and confirmed by the page. The operator's page of the server is an observer.
    """

    def __init__(
        self,
        screen: Screen,
        monitor: Monitor,
        close: Callable[[], None],
        warn: Callable[[str], None],
        hold_s: float = HOLD_S,
        glass: Glass | None = None,
    ) -> None:
        self._screen = screen
        self._monitor = monitor
        self._close: Callable[[], None] | None = close
        self._warn = warn
        self.hold_s = hold_s
        self._glass = glass or Glass()
        self._shown: tuple[Order, Report] | None = None

    @property
    def observers(self) -> tuple[Monitor, ...]:
        """The operator's page."""
        return (self._monitor,)

    @property
    def panel(self) -> PanelInfo:
        """The panel, as the plan describes it."""
        return self._screen.panel

    @property
    def url(self) -> str:
        """The address to open on the display."""
        return self._screen.url

    def show(self, picture: Picture) -> Shown:
        """Show a picture, and wait for the page's confirmation. Raises DisplayError after hold_s."""
        if isinstance(picture, str):
            picture = pattern(picture, self.panel)
        order = self._screen.want(picture)
        report = self._hold(lambda: self._screen.confirms(order))
        self._shown = order, report
        self._glass.shows(order.picture())
        return Shown((picture.shape[0], picture.shape[1]))

    def undisturbed(self) -> bool:
        """Return whether the picture stayed whole since `show`, by a fresh report, awaited as in `show`."""
        number = self._screen.request_report()
        now = self._hold(lambda: self._screen.problem is None and self._answered(number))
        if self._shown is None:
            return False
        order, then = self._shown
        return self._screen.confirms(order) and (now.page, now.disturbed) == (
            then.page,
            then.disturbed,
        )

    def close(self) -> None:
        """Let the page go; the last screen stops the server."""
        if self._close is not None:
            self._close()
            self._close = None

    def _answered(self, number: int) -> bool:
        report = self._screen.report
        return report is not None and report.asked >= number

    def _hold(self, good: Callable[[], bool]) -> Report:
        """Wait for a good report with warnings meanwhile, and return the report."""
        since = time.monotonic()
        warned = None
        screen = self._screen
        while True:
            with screen.changed:
                report = screen.report
                if report is not None and good():
                    return report
                screen.changed.wait(0.2)
            self._monitor.refuse_abort()
            if self._close is None:
                raise DisplayError(f'display "{screen.name}" was closed')
            waited_s = time.monotonic() - since
            problem = screen.problem or "its page has not confirmed the picture"
            if waited_s > self.hold_s:
                raise DisplayError(
                    f'display "{screen.name}": {problem} (waited {self.hold_s:g} s for {screen.url})'
                )
            if waited_s > PATIENCE_S and problem != warned:
                warned = problem
                self._warn(f'waiting for the display "{screen.name}": {problem}')
