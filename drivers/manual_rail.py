"""A rail without a motor: `manual:` asks the operator to set the rail, and to type the reading of its scale."""

from __future__ import annotations

from collections.abc import Callable

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import ClosesItself, Travel
from labkit.errors import PlanError, RailError, RailLimitError
from labkit.plan import Plan

READING_TRIES = 3
NEAR_MM = 2.0
"""A reading farther than this from the position ordered is a slip of the hand, or of the keyboard."""

MOST_TAPE_ERROR_MM = 10.0
"""A range measured by hand errs by less."""

SCALE = Travel(-1e6, 1e6)


def open_rail(address: str, plan: Plan, context: DeviceContext) -> ManualRail:
    """Open the rail of manual:. Raises PlanError."""
    if plan.rail is None or address != "manual:":
        raise PlanError(f'rail.address = "{address}": allowed is manual:')
    return ManualRail(context.operator.ask, plan.rail.run_up_mm, plan.rail.range_mm)


class ManualRail(ClosesItself):
    """A Rail, moved by a person. Positions are readings of its scale, in mm.

    ask: puts a question and returns the answer. run_up_mm: each stop is approached upward over this distance, to remove
    backlash. range_mm: the range at a position, which is no reading of the scale.
    """

    def __init__(
        self,
        ask: Callable[[str], str],
        run_up_mm: float = 1.0,
        range_mm: Callable[[float], float] | None = None,
    ) -> None:
        self._ask = ask
        self._run_up_mm = run_up_mm
        self._range_mm = range_mm

    @property
    def travel_mm(self) -> Travel:
        """Unlimited travel: the person sees where the rail ends."""
        return SCALE

    def home(self) -> None:
        """Do nothing: a scale has no zero to find."""

    def move_to(self, position_mm: float) -> float:
        """Ask the operator to set the rail, and return the scale's reading, in mm.

        Raises RailLimitError outside the travel, RailError without a usable answer, and the
        errors of `ask`.
        """
        if not SCALE.low_mm <= position_mm <= SCALE.high_mm:
            raise RailLimitError(
                f"{position_mm:.3f} mm is outside {SCALE.low_mm:g}..{SCALE.high_mm:g} mm"
            )
        below_mm = position_mm - self._run_up_mm
        request = (
            f"Set the rail to {position_mm:.3f} mm, coming from {below_mm:.3f} mm or less, clamp it, "
            f"and type what its scale says in mm"
        )
        question = request
        for _ in range(READING_TRIES):
            answer = (
                self._ask(question).strip().removesuffix("mm").strip().replace(",", ".")
            )
            try:
                at_mm = float(answer)
            except ValueError:
                question = f'"{answer}" is no number. {request}'
                continue
            if abs(at_mm - position_mm) <= NEAR_MM:
                return at_mm
            question = f"{self._slip(at_mm, position_mm)}. {request}"
        raise RailError(
            f"nobody set the manual rail to {position_mm:.3f} mm: {question.partition('. ')[0]}"
        )

    def _slip(self, at_mm: float, position_mm: float) -> str:
        """Describe the fault of a reading."""
        if self._range_mm is not None:
            range_mm = self._range_mm(position_mm)
            if abs(at_mm - range_mm) <= MOST_TAPE_ERROR_MM:
                return f"{at_mm:g} mm is the range to the target, no reading of the rail's scale"
        return f"{at_mm:g} mm is more than {NEAR_MM:g} mm away"

    def stop(self) -> None:
        """Do nothing: a person stops by themselves."""

    def close(self) -> None:
        """Do nothing."""
