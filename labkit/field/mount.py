"""Screws that tilt the sensor: how far to turn each, and which way, by one known move.

Heights are distances of the sensor from the lens at a screw, um: positive away from the
lens, where the sensor is then more behind the image. Places of screws are (x, y) mm from the
middle of the frame, x right and y down as in the photographs. Tilt alone is corrected: a
curved focal surface stays curved, whatever the screws do.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from labkit.field.pair import Pair
from labkit.types import Floats
from labkit.uncertain import Uncertain

Way = Literal["away", "towards"]
"""What a clockwise turn of a screw does to the sensor there: away from the lens, or towards it."""

WRONG_WAY_P = 0.01
"""Largest probability of the other way for a way that is proven."""

OTHER_MOVE_P = 0.01
"""Smallest probability of a change of tilt across the expected one that is chance."""

LEAST_STATED_P = 1e-6
"""Probabilities below, which rest on the far tails of the errors, are stated as less than this."""

TELLING_ERRORS = 3.0
"""Size, in standard errors, of a move that proves its way nearly always."""


@dataclass(frozen=True)
class Screws:
    """Three or four screws about the sensor.

    Parameters
    ----------
    places_mm : (x, y) of each, from the middle of the frame
    pitch_mm : of the thread, mm a turn; None: shims alone
    clockwise : what a clockwise turn does; None until one known move proved it

    Raises
    ------
    ValueError : fewer than three screws, screws on one line, or a pitch that is not above 0
    """

    places_mm: tuple[tuple[float, float], ...]
    pitch_mm: float | None = None
    clockwise: Way | None = None

    def __post_init__(self) -> None:
        if np.linalg.matrix_rank(self._plane) < 3:
            raise ValueError(
                f"screws at {list(self.places_mm)} mm: three or four that are not on one line are needed"
            )
        if self.pitch_mm is not None and not self.pitch_mm > 0:
            raise ValueError(f"pitch {self.pitch_mm:g} mm: a length above 0 is needed")

    @property
    def down_right_mm(self) -> Floats:
        """(n, 2) places, down and right."""
        return np.array(self.places_mm, float)[:, ::-1]

    @property
    def slopes(self) -> Floats:
        """(2, n) slope of the sensor's plane, um/mm down and right, by the heights of the screws, um.

        The plane of more than three heights is that of least squares.
        """
        return np.asarray(np.linalg.pinv(self._plane)[:2])

    @property
    def _plane(self) -> Floats:
        """(n, 3) heights of the screws by the slopes and the height in the middle of the frame."""
        return np.column_stack([self.down_right_mm, np.ones(len(self.places_mm))])


@dataclass(frozen=True)
class ScrewMove:
    """The move of one screw.

    Parameters
    ----------
    number : of the screw, from 1
    height_um : change that levels the focal surface, with the middle of the frame where it is
    shim_um : the same with the screw that goes nearest to the lens at 0: thickness to add
    turn_deg : of the screw, positive away from the lens; None without a pitch
    words : the move, in words
    """

    number: int
    height_um: Uncertain
    shim_um: Uncertain
    turn_deg: Uncertain | None
    words: str

    def as_json(self) -> dict[str, Any]:
        """Return the numbers with their errors."""
        turn = self.turn_deg
        return {
            "screw": self.number,
            "height_um": self.height_um.as_json(),
            "shim_um": self.shim_um.as_json(),
            "turn_deg": None if turn is None else turn.as_json(),
            "words": self.words,
        }


def level(tilt: Pair, screws: Screws) -> tuple[ScrewMove, ...]:
    """Return what to do at each screw for a sensor without tilt.

    tilt : slope of the sensor's focus error, um/mm, positive where the sensor is behind the image
    """
    rows = -screws.down_right_mm
    heights = rows @ tilt.value
    nearest = int(np.argmin(heights))
    return tuple(
        _move(k, _number(row, tilt), _number(row - rows[nearest], tilt), screws)
        for k, row in enumerate(rows)
    )


def _number(row: Floats, tilt: Pair) -> Uncertain:
    """Return the height of a plane at a place, um."""
    number = tilt.along(row)
    return Uncertain(number.value, number.std, "µm")


def _move(at: int, height: Uncertain, shim: Uncertain, screws: Screws) -> ScrewMove:
    """Return the move of a screw."""
    if screws.pitch_mm is None:
        words = _way(height)
        if screws.clockwise is None:
            words += ", which a known move has to prove"
        return ScrewMove(at + 1, height, shim, None, words)
    factor = 360 / (1e3 * screws.pitch_mm)
    turn = Uncertain(factor * height.value, factor * height.std, "deg")
    amount = Uncertain(abs(turn.value), turn.std, "°")
    if screws.clockwise is None:
        words = f"{amount} {_way(height)}, which a known move has to prove"
        return ScrewMove(at + 1, height, shim, turn, words)
    clockwise = (turn.value > 0) == (screws.clockwise == "away")
    words = f"{amount} {'clockwise' if clockwise else 'anticlockwise'}"
    return ScrewMove(at + 1, height, shim, turn, words)


def _way(height: Uncertain) -> str:
    """Describe the direction of a move."""
    return "away from the lens" if height.value > 0 else "towards the lens"


@dataclass(frozen=True, eq=False)
class KnownMove:
    """A screw turned by a known angle, and the change of tilt that followed.

    Parameters
    ----------
    screw : number, from 1
    turn_deg : clockwise
    measured : change of the slope, um/mm
    predicted : (2,) the same for screws whose clockwise turn moves the sensor away from the lens
    """

    screw: int
    turn_deg: float
    measured: Pair
    predicted: Floats

    @property
    def factor(self) -> Uncertain:
        """Measured over predicted change along the prediction: 1 for away, -1 for towards."""
        square = self._between(self.predicted, self.predicted)
        along = self._between(self.predicted, self.measured.value)
        return Uncertain(along / square, 1 / sqrt(square))

    @property
    def p_away(self) -> float:
        """Probability of a change as far from the prediction if clockwise is away from the lens."""
        return self._p_value(self.measured.value - self.predicted, 2)

    @property
    def p_towards(self) -> float:
        """Probability of a change as far from the prediction if clockwise is towards the lens."""
        return self._p_value(self.measured.value + self.predicted, 2)

    @property
    def p_wrong(self) -> float:
        """Probability of the less likely of both ways, even before the move."""
        along = self._between(self.predicted, self.measured.value)
        return 1 / (1 + exp(min(2 * abs(along), 700.0)))

    @property
    def p_still(self) -> float:
        """Probability of as large a change along the prediction if nothing moved."""
        factor = self.factor
        return float(chi2.sf((factor.value / factor.std) ** 2, 1))

    @property
    def p_across(self) -> float:
        """Probability of as large a change across the predicted one by chance."""
        left = self.measured.value - self.factor.value * self.predicted
        return self._p_value(left, 1)

    @property
    def clockwise(self) -> Way | None:
        """Direction of a clockwise turn; None where the move does not prove any."""
        unproven = max(self.p_wrong, self.p_still) >= WRONG_WAY_P
        if unproven or self.p_across < OTHER_MOVE_P:
            return None
        return "away" if self.factor.value > 0 else "towards"

    @property
    def telling_turn_deg(self) -> float:
        """Turn that would prove the way nearly always, with errors as they are."""
        square = self._between(self.predicted, self.predicted)
        return abs(self.turn_deg) * TELLING_ERRORS / sqrt(square)

    @property
    def words(self) -> str:
        """The outcome in a sentence."""
        if self.p_across < OTHER_MOVE_P:
            return (
                f"the tilt changed by {self._change()} µm/mm, which no turn of screw {self.screw} does "
                f"(p = {self.p_across:.1g}): was another screw turned, or the target or the lens moved?"
            )
        way = self.clockwise
        if way is None:
            return f"the way is not proven: {self._unproven()}"
        proven = (
            f"proven: clockwise moves the sensor {way}{' from' if way == 'away' else ''} the lens "
            f"(probability of the other way {_chance(self.p_wrong)})"
        )
        expected = self.p_away if way == "away" else self.p_towards
        if expected >= OTHER_MOVE_P:
            return f"{proven}; the change is as the pitch predicts (p = {expected:.2g})"
        return (
            f"{proven}, but by {self._size()} of what the pitch predicts (p = {expected:.1g}): check the pitch, "
            "the screws' places, and play"
        )

    def _unproven(self) -> str:
        """Describe why a move proves no way, and what would."""
        if self.telling_turn_deg > abs(self.turn_deg):
            return (
                f"the change of {self._change()} µm/mm is within its errors; turn screw {self.screw} by "
                f"{self.telling_turn_deg:.0f}° or more, or take more photographs"
            )
        return f"the tilt changed by {self._size()} of what the pitch predicts; does screw {self.screw} move the sensor?"

    def _size(self) -> Uncertain:
        return Uncertain(abs(self.factor.value), self.factor.std)

    def as_json(self) -> dict[str, Any]:
        """Return the outcome with its probabilities."""
        return {
            "schema": 1,
            "screw": self.screw,
            "turn_deg": self.turn_deg,
            "measured_um_per_mm": self.measured.as_json(),
            "predicted_um_per_mm": self.predicted.tolist(),
            "factor": self.factor.as_json(),
            "clockwise": self.clockwise,
            "p_away": self.p_away,
            "p_towards": self.p_towards,
            "p_wrong": self.p_wrong,
            "p_still": self.p_still,
            "p_across": self.p_across,
        }

    def _change(self) -> str:
        parts = (self.measured.down, self.measured.right)
        return "({})".format(", ".join(str(Uncertain(p.value, p.std)) for p in parts))

    def _between(self, one: Floats, other: Floats) -> float:
        """Return the product of two slopes in the metric of the errors."""
        return float(one @ np.linalg.solve(self.measured.covariance, other))

    def _p_value(self, left: Floats, free: int) -> float:
        return float(chi2.sf(self._between(left, left), free))


def _chance(probability: float) -> str:
    """Return a probability in words that promise no more than errors can."""
    least = f"{LEAST_STATED_P:g}"
    return f"< {least}" if probability < LEAST_STATED_P else f"{probability:.1g}"


def check_move(
    before: Pair, after: Pair, screws: Screws, screw: int, turn_deg: float
) -> KnownMove:
    """Compare the change of tilt between two sessions with that of one screw turned by a known angle.

    Parameters
    ----------
    before, after : slopes of the sensor's focus error, um/mm
    screws : with their pitch
    screw : number of the turned screw, from 1
    turn_deg : clockwise; negative for anticlockwise

    Raises
    ------
    ValueError : no such screw, no pitch, or no turn
    """
    count = len(screws.places_mm)
    if not 1 <= screw <= count:
        raise ValueError(f"screw {screw}: allowed is 1 to {count}")
    if screws.pitch_mm is None:
        raise ValueError("a known move needs mount.screw_pitch_mm in the plan")
    if not (np.isfinite(turn_deg) and turn_deg):
        raise ValueError(f"turn {turn_deg:g}°: an angle other than 0 is needed")
    heights = np.zeros(count)
    heights[screw - 1] = 1e3 * screws.pitch_mm * turn_deg / 360
    measured = Pair(
        after.value - before.value, after.covariance + before.covariance, "µm/mm"
    )
    return KnownMove(screw, turn_deg, measured, screws.slopes @ heights)
