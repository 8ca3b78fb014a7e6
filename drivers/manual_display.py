"""A target on paper: `manual:` asks the operator to put the target, or a white sheet, before the camera."""

from __future__ import annotations

from collections.abc import Callable

from labkit.devices.context import DeviceContext, Glass
from labkit.devices.protocols import ClosesItself, PanelInfo, Picture, Shown
from labkit.errors import PlanError
from labkit.panel.panels import paper_panel
from labkit.plan import Plan
from labkit.target.grid import whole_target

SHEET = "Put a white sheet in place of the target, flat, large enough to fill the frame, under the same light"
TARGET_REQUEST = "Put the target before the camera, flat, wholly in the frame"


def open_display(address: str, plan: Plan, context: DeviceContext) -> ManualDisplay:
    """Open the display of manual:. Raises PlanError."""
    if address != "manual:":
        raise PlanError(f'display.address = "{address}": allowed is manual:')
    panel = paper_panel(whole_target(plan.target))
    return ManualDisplay(
        lambda text: context.operator.ask(text, wants="done"), panel, context.glass
    )


class ManualDisplay(ClosesItself):
    """A Display that is a person with two sheets.

    ask: makes a request and returns when done; panel: paper as a simulated camera sees it;
    glass: reports the picture to such a camera.
    """

    on_paper = True

    def __init__(
        self, ask: Callable[[str], object], panel: PanelInfo, glass: Glass
    ) -> None:
        self._ask = ask
        self._panel = panel
        self._glass = glass
        self._there: str | None = None

    @property
    def panel(self) -> PanelInfo:
        """The paper."""
        return self._panel

    def show(self, picture: Picture) -> Shown:
        """Ask for the white sheet, or for the target with any other picture, unless it is there.

        Black needs no request, because dark frames are taken with the cap on. Raises the
        errors of `ask`.
        """
        if not isinstance(picture, str) or picture == "white":
            wanted = SHEET if isinstance(picture, str) else TARGET_REQUEST
            if wanted != self._there:
                self._there = None
                self._ask(wanted)
                self._there = wanted
        self._glass.shows(picture)
        return Shown(
            self._panel.pixels
            if isinstance(picture, str)
            else (picture.shape[0], picture.shape[1])
        )

    def close(self) -> None:
        """Do nothing."""
