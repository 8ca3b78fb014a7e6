"""Use simulated controllers on a serial line: to carry a simulated bench's camera, or to serve any program."""

from __future__ import annotations

import time
from collections.abc import Callable

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.controllers.pty_port import PtyPort
from labkit.errors import PlanError
from labkit.plan import Plan, RailSettings


def carrying(context: DeviceContext) -> Callable[[float], None]:
    """Return a function that brings the bench's camera to rest at a position in mm; without a bench it does
    nothing.
    """

    def carry(carriage_mm: float) -> None:
        for bench in context.shared.values():
            if isinstance(bench, Bench):
                bench.turn_screw(carriage_mm)
                bench.stand(carriage_mm)

    return carry


def rail_of(address: str, plan: Plan) -> RailSettings:
    """Return the rail of a plan. Raises PlanError for a plan without a rail."""
    if plan.rail is None:
        raise PlanError(f'rail.address = "{address}": the plan has no [rail]')
    return plan.rail


def serve(port: PtyPort) -> None:
    """Serve other programs until Ctrl-C."""
    print(f"{port.path}, any baud rate; Ctrl-C ends it", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        port.close()
