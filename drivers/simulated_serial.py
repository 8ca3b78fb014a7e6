"""What simulated controllers on a serial line are put to: to carry a simulated bench's camera, or to serve any program."""

from __future__ import annotations

import time
from collections.abc import Callable

from labkit.drivers.bench import Bench
from labkit.drivers.pty_port import PtyPort
from labkit.lab.devices import Room


def carrying(room: Room) -> Callable[[float], None]:
    """Brings the camera of the room's bench to a position in mm, to stand there; does nothing in a room without one."""

    def carry(carriage_mm: float) -> None:
        for bench in room.shared.values():
            if isinstance(bench, Bench):
                bench.turn_screw(carriage_mm)
                bench.stand(carriage_mm)

    return carry


def serve(port: PtyPort) -> None:
    """Let other programs talk to it until Ctrl-C."""
    print(f"{port.path}, any baud rate; Ctrl-C ends it", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        port.close()
