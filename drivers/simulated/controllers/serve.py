"""What simulated controllers on a serial line are put to: to carry a simulated bench's camera, or to serve any program."""

from __future__ import annotations

import time
from collections.abc import Callable

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.controllers.pty_port import PtyPort
from labkit.errors import PlanError
from labkit.plan import Plan, RailSettings


def carrying(context: DeviceContext) -> Callable[[float], None]:
    """Brings the camera of the context's bench to a position in mm, to stand there; does nothing in a context without one."""

    def carry(carriage_mm: float) -> None:
        for bench in context.shared.values():
            if isinstance(bench, Bench):
                bench.turn_screw(carriage_mm)
                bench.stand(carriage_mm)

    return carry


def rail_of(address: str, plan: Plan) -> RailSettings:
    """The rail that a plan wants carried. Raises PlanError for a plan without one."""
    if plan.rail is None:
        raise PlanError(f'rail.address = "{address}": the plan has no [rail]')
    return plan.rail


def serve(port: PtyPort) -> None:
    """Let other programs talk to it until Ctrl-C."""
    print(f"{port.path}, any baud rate; Ctrl-C ends it", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        port.close()
