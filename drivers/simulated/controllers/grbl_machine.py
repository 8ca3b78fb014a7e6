"""The machine behind a simulated GRBL: three axes, planned moves, and the true carriage behind the counted
steps.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from labkit.drivers.grbl.protocol import (
    ACCELERATION,
    HOMING_DIRECTION,
    LOCATE_RATE,
    MAX_RATE,
    MAX_TRAVEL,
    PULL_OFF,
    SEEK_RATE,
    SOFT_LIMITS,
)
from labkit.drivers.simulated.controllers.motion import Braking, Move, Point

STEP_MM = 0.004
SWITCH_MM = 0.005
"""How far before the end of its travel the carriage trips the limit switch."""


@dataclass(frozen=True, slots=True)
class Planned:
    """A waiting move; speed in mm/s."""

    target: Point
    speed: float


class Machine:
    """Positions in mm, times in s. `position` is the firmware's own count, in machine coordinates.

    The carriage is truly `slip_mm` beyond the count along X. A correct homing makes the
    slip zero, and interrupted motion adds `lost_mm`.
    """

    def __init__(
        self,
        settings: Mapping[int, float],
        zero_at_home: bool,
        carriage_mm: float,
        switch_works: bool,
        is_hal: bool,
    ) -> None:
        self._settings = settings
        self.switch_works = switch_works
        self._only_when_homed = is_hal
        self._is_homed = False
        self.lost_mm = 0.4
        self._zero_at_home = zero_at_home
        self.position: Point = (0.0, 0.0, 0.0)
        self.slip_mm = carriage_mm
        self.planned: deque[Planned] = deque()
        self.motion: Move | Braking | None = None

    def place(self, now_s: float) -> Point:
        """Return the place that the firmware counts."""
        if self.motion is None:
            return self.position
        if isinstance(self.motion, Braking):
            return self.motion.position(now_s)
        return self.motion.at(self.motion.along(now_s)[0])

    def carriage_mm(self, now_s: float) -> float:
        """Return the true place of the carriage along X."""
        return self.place(now_s)[0] + self.slip_mm

    def end(self) -> Point:
        """Return the place after all planned moves."""
        return self.planned[-1].target if self.planned else self.position

    def start(self, now_s: float) -> None:
        """Set out on the next planned move."""
        following = self.planned[0]
        self.motion = Move(
            self.position,
            following.target,
            now_s,
            following.speed,
            self._settings[ACCELERATION],
        )

    def arrive(self, now_s: float) -> None:
        """End the present motion; a braked move keeps the rest of its way."""
        braked = isinstance(self.motion, Braking)
        self.position = self.place(now_s)
        self.motion = None
        if not braked:
            self.planned.popleft()

    def brake(self, now_s: float) -> None:
        """Begin to slow down any motion."""
        if isinstance(self.motion, Move):
            self.motion = Braking(self.motion, now_s)

    def cut_off(self, now_s: float) -> None:
        """Stop dead: the firmware forgets its plan, and the carriage runs on by some steps."""
        if self.motion is not None:
            way = self.planned[0].target[0] - self.position[0]
            self.position = self.place(now_s)
            self.motion = None
            self.slip_mm += self.lost_mm if way > 0 else -self.lost_mm
        self.planned.clear()

    def forget(self, now_s: float) -> None:
        """Restart the count at zero after a power cut, wherever the carriage is."""
        true_mm = self.carriage_mm(now_s)
        self.planned.clear()
        self.position = (0.0, 0.0, 0.0)
        self.motion = None
        self.slip_mm = true_mm
        self._is_homed = False

    def outside(self, target: Point) -> bool:
        """Return whether soft limits, if they are on, forbid a target."""
        if not self._settings[SOFT_LIMITS] or (
            self._only_when_homed and not self._is_homed
        ):
            return False
        for axis, mm in enumerate(target):
            travel_mm = self._settings[MAX_TRAVEL + axis]
            if self._zero_at_home and self._homes_low(axis):
                low_mm = 0.0
                high_mm = travel_mm
            else:
                low_mm = -travel_mm
                high_mm = 0.0
            if not low_mm <= mm <= high_mm:
                return True
        return False

    def on_switch(self, now_s: float) -> bool:
        """Return whether X's limit switch is pressed."""
        return self._has_low_switch and self.carriage_mm(now_s) <= self._switch_mm

    def trips_s(self) -> float | None:
        """Return the time when the present move presses or releases the limit switch; None if never."""
        if not isinstance(self.motion, Move) or not self._has_low_switch:
            return None
        move = self.motion
        begin = move.origin[0] + self.slip_mm
        end = move.target[0] + self.slip_mm
        if (begin <= self._switch_mm) == (end <= self._switch_mm):
            return None
        wanted_mm = (
            abs(self._switch_mm - begin) * move.length_mm / abs(end - begin) + STEP_MM
        )
        low_s = move.begin_s
        high_s = move.end_s
        for _ in range(50):
            middle_s = (low_s + high_s) / 2
            low_s, high_s = (
                (middle_s, high_s)
                if move.along(middle_s)[0] < wanted_mm
                else (low_s, middle_s)
            )
        return high_s

    def homing_s(self) -> float:
        """Return the duration of homing X: search, way back, second approach and way back."""
        search_mm = (
            abs(self.slip_mm + self.position[0] - self._home_mm(0))
            + self._settings[PULL_OFF]
        )
        seek = self._settings[SEEK_RATE] / 60
        locate = self._settings[LOCATE_RATE] / 60
        return (search_mm + self._settings[PULL_OFF]) / seek + 2 * self._settings[
            PULL_OFF
        ] / locate

    def search_s(self) -> float:
        """Return the longest duration of a search for the switch."""
        return 1.5 * self._settings[MAX_TRAVEL] / (self._settings[SEEK_RATE] / 60)

    def homed(self, axes: int) -> None:
        """End homing: counted and true position agree."""
        homes = [self._home_mm(axis) for axis in range(axes)]
        self.position = (*homes, *self.position[axes:])
        self.slip_mm = 0.0
        self._is_homed = True

    def homing_cut_off(self, since_s: float) -> None:
        """Interrupt homing: the carriage went part of the way, uncounted."""
        way_mm = min(
            since_s * self._settings[SEEK_RATE] / 60,
            abs(self.carriage_mm(0.0) - self._home_mm(0)),
        )
        self.slip_mm += -way_mm if self._homes_low(0) else way_mm

    def speed(self, feed: float | None) -> float:
        """Return the speed in mm/s of a feed in mm/min, at most the machine's own; None is rapid."""
        fastest = self._settings[MAX_RATE]
        return (fastest if feed is None else min(feed, fastest)) / 60

    @property
    def _switch_mm(self) -> float:
        return self._home_mm(0) - self._settings[PULL_OFF] + SWITCH_MM

    @property
    def _has_low_switch(self) -> bool:
        return self.switch_works and self._homes_low(0)

    def _homes_low(self, axis: int) -> bool:
        return bool(int(self._settings[HOMING_DIRECTION]) >> axis & 1)

    def _home_mm(self, axis: int) -> float:
        if self._zero_at_home:
            return 0.0
        pull_off_mm = self._settings[PULL_OFF]
        return (
            pull_off_mm - self._settings[MAX_TRAVEL + axis]
            if self._homes_low(axis)
            else -pull_off_mm
        )
