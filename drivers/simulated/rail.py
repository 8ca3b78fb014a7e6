"""The rail of the simulated bench, with an encoder on its carriage."""

from __future__ import annotations

from collections.abc import Callable

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Travel
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.device import SimulatedDevice
from labkit.drivers.simulated.setup import shared_bench
from labkit.errors import DeviceTimeoutError, RailError, RailLimitError
from labkit.plan import Plan

RUN_UP_MM = 1.0
"""Each stop is approached upward over at least this distance, to remove backlash."""

LOST_STEPS_MM = 0.2
"""A carriage farther than this from where it should be has lost steps."""


def open_rail(address: str, plan: Plan, context: DeviceContext) -> SimulatedRail:
    """Open the rail of the context's bench. Raises PlanError."""
    bench = shared_bench(context, address, plan)
    return SimulatedRail(bench.part, release=bench.close)


class SimulatedRail(SimulatedDevice):
    """A Rail, which like a real rail must be homed before it moves, and again after trouble."""

    def __init__(
        self,
        bench: Bench,
        timeout_s: float = 60.0,
        release: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(bench, release)
        self._timeout_s = timeout_s
        self._homed = False

    @property
    def travel_mm(self) -> Travel:
        """Positions that the rail can reach."""
        rail = self._bench.settings.rail
        return Travel(rail.low_mm, rail.high_mm)

    def home(self) -> None:
        """Drive to the lower end and find the zero again."""
        self._bench.turn_screw(self._bench.settings.rail.low_mm)
        self._bench.trip_home_switch()
        self._homed = True

    def move_to(self, position_mm: float) -> float:
        """Approach a position from below, and return the encoder's reading.

        Raises RailLimitError outside the travel, RailError before homing or after lost
        steps, DeviceTimeoutError.
        """
        travel = self.travel_mm
        if not travel.low_mm <= position_mm <= travel.high_mm:
            raise RailLimitError(
                f"{position_mm:.3f} mm is outside {travel.low_mm:g}..{travel.high_mm:g} mm"
            )
        if not self._homed:
            raise RailError("the simulated rail does not know where it is; home it first")
        trouble = self._bench.trouble("rail")
        if trouble in ("stall", "limit"):
            self._fail(trouble)
        self._bench.turn_screw(max(position_mm - RUN_UP_MM, travel.low_mm))
        self._bench.turn_screw(
            position_mm, lost_mm=RUN_UP_MM / 2 if trouble == "lost_steps" else 0.0
        )
        self._bench.stand(position_mm)
        return self._measure(position_mm)

    def stop(self) -> None:
        """Do nothing: moves end at once."""

    def close(self) -> None:
        """Release the rail; again does nothing."""
        self._homed = False
        super().close()

    def _measure(self, position_mm: float) -> float:
        step_mm = self._bench.settings.rail.encoder_step_mm
        measured_mm = round(self._bench.counted_mm / step_mm) * step_mm
        if abs(measured_mm - position_mm) > LOST_STEPS_MM:
            self._homed = False
            raise RailError(
                f"the simulated rail was sent to {position_mm:.3f} mm and its encoder reads {measured_mm:.3f} mm: "
                f"it lost steps; home it"
            )
        return measured_mm

    def _fail(self, trouble: str) -> None:
        self._homed = False
        if trouble == "limit":
            raise RailError("the simulated rail ran onto a limit switch; home it")
        self._bench.wait(self._timeout_s)
        raise DeviceTimeoutError(
            f"the simulated rail was still not there after {self._timeout_s:g} s; home it"
        )
