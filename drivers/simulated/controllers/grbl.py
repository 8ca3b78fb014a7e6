"""A GRBL 1.1 or grblHAL controller without hardware, behind a real pseudo-terminal.

As rail.address = "grbl:simulated" it replaces a rail; `python -m
labkit.drivers.simulated.controllers.grbl` serves any program that speaks GRBL.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, GRBL_HAL, Firmware
from labkit.drivers.simulated.controllers.pty_port import LineFault, PtyPort
from labkit.drivers.simulated.controllers.serve import carrying, rail_of, serve
from labkit.plan import Plan

LEADSCREW = {
    1: 255, 10: 3, 20: 1, 21: 1, 22: 1, 23: 7, 24: 300, 25: 3000, 27: 2,
    110: 3000, 111: 3000, 112: 3000, 120: 500, 121: 500, 122: 500, 130: 295, 131: 295, 132: 295,
}  # fmt: skip
"""Settings of a rail of 295 mm that homes at its low end, 50 mm/s."""


def grbl_port(
    firmware: Firmware = GRBL,
    settings: Mapping[int, float] | None = None,
    options: str = "V",
    faults: Sequence[LineFault] = (),
) -> PtyPort:
    """Return a controller for LEADSCREW, except for the given settings, behind its own port."""
    known = {
        number: value for number, value in LEADSCREW.items() if number in firmware.defaults
    }
    return PtyPort(GrblController(firmware, known | dict(settings or {}), options), faults)


def simulated_port(address: str, plan: Plan, context: DeviceContext) -> PtyPort:
    """Return a controller whose travel covers the plan's stations; it moves the context's simulated bench, if
    any.
    """
    rail = rail_of(address, plan)
    stations_mm = [rail.position_mm(range_mm) for range_mm in rail.ranges_mm]
    zero_at_home = min(stations_mm) >= 0
    reach_mm = max(abs(mm) for mm in stations_mm) + 10.0 + rail.run_up_mm
    port = grbl_port(
        settings={130: reach_mm, 131: reach_mm, 132: reach_mm},
        options="VZ" if zero_at_home else "V",
    )
    controller = port.controller
    assert isinstance(controller, GrblController)
    controller.moved = carrying(context)
    return port


def main() -> None:
    """Serve a controller until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hal", action="store_true", help="grblHAL instead of GRBL 1.1h")
    serve(grbl_port(GRBL_HAL if parser.parse_args().hal else GRBL))


if __name__ == "__main__":
    main()
