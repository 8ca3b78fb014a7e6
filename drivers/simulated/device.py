"""The common base of the simulated camera, rail and display: their bench."""

from __future__ import annotations

from collections.abc import Callable

from labkit.devices.protocols import ClosesItself
from labkit.drivers.simulated.bench import Bench


class SimulatedDevice(ClosesItself):
    """A device on a bench, in the bench's time. release: gives the bench back when the device is closed."""

    def __init__(self, bench: Bench, release: Callable[[], None] = lambda: None) -> None:
        self._bench = bench
        self._release = release

    def wait(self, seconds: float) -> None:
        """Let time pass on the bench; nothing sleeps."""
        self._bench.wait(seconds)

    def close(self) -> None:
        """Release the device; again does nothing."""
        self._release()
