"""The display of the simulated bench."""

from __future__ import annotations

from typing import Literal

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import PanelInfo, Picture, Shown
from labkit.devices.test_patterns import pattern
from labkit.drivers.simulated.device import SimulatedDevice
from labkit.drivers.simulated.setup import shared_bench
from labkit.errors import DisplayError
from labkit.plan import Plan


def open_display(address: str, plan: Plan, context: DeviceContext) -> SimulatedDisplay:
    """Open the display of the context's bench. Raises PlanError."""
    bench = shared_bench(context, address, plan)
    return SimulatedDisplay(bench.part, release=bench.close)


class SimulatedDisplay(SimulatedDevice):
    """A Display whose pixels are squares of one grey each, or of three stripes."""

    @property
    def panel(self) -> PanelInfo:
        """The panel, as its maker describes it."""
        panel = self._bench.settings.panel
        stripes: Literal["rgb", "none"] = "none" if panel.layout == "none" else "rgb"
        return PanelInfo(panel.pixels, panel.pitch_mm, subpixels=stripes)

    def show(self, picture: Picture) -> Shown:
        """Show a picture. Raises DisplayError if it is too large or the display sleeps."""
        if self._bench.trouble("display") == "sleep":
            raise DisplayError(
                "the simulated display went to sleep; wake it, and set Auto-Lock to never"
            )
        try:
            if isinstance(picture, str):
                picture = pattern(picture, self.panel)
            self._bench.light(picture)
        except ValueError as error:
            raise DisplayError(str(error)) from error
        return Shown((picture.shape[0], picture.shape[1]))
