"""The display of the simulated bench."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import PanelInfo, Picture, Shown
from labkit.devices.test_patterns import pattern
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import shared_bench
from labkit.errors import DisplayError
from labkit.plan import Plan


def open_display(address: str, plan: Plan, context: DeviceContext) -> SimulatedDisplay:
    """The display of the context's bench. Raises PlanError."""
    return SimulatedDisplay(shared_bench(context, address, plan))


class SimulatedDisplay:
    """A Display whose pixels are squares of one grey each."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    @property
    def panel(self) -> PanelInfo:
        """The glass, as its maker describes it."""
        panel = self._bench.settings.panel
        return PanelInfo(panel.pixels, panel.pitch_mm, subpixels="none")

    def show(self, picture: Picture) -> Shown:
        """Show it. Raises DisplayError if it is too large or the display has gone to sleep."""
        if self._bench.trouble("display") == "sleep":
            raise DisplayError("the simulated display went to sleep; wake it, and set Auto-Lock to never")
        try:
            if isinstance(picture, str):
                picture = pattern(picture, self.panel)
            self._bench.light(picture)
        except ValueError as error:
            raise DisplayError(str(error)) from error
        return Shown((picture.shape[0], picture.shape[1]))

    def close(self) -> None:
        """Let it go."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
