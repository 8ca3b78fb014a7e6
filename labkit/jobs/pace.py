"""Predict how long some work will still take, from its completed steps.

The predicted time falls steadily and never reaches zero before the end.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

PAUSED = "paused on the operator's page"
"""The name of a step in which nothing is done until somebody lets it."""


EARLIER = "earlier ones took here"
RULE = "most take"
"""Whose time an expected duration is."""


class Pace:
    """Completed and total steps with their times, in seconds of any clock; time on hold does not count."""

    def __init__(self) -> None:
        self.done = self.total = 0
        self._ends: list[tuple[float, int]] = []
        self._held_since_s: float | None = None
        self._held_s = 0.0

    def at(self, done: int, total: int, now_s: float) -> None:
        """Record that `done` of `total` steps are complete.

        Fewer steps than before, zero, or an unknown number begin a new count.
        """
        if done < self.done or not (total and self.total):
            self._ends = []
        if not self._ends or done > self.done:
            self._ends.append((now_s - self._held_s, done))
        self.done = done
        self.total = total

    def hold(self, now_s: float) -> None:
        """Stop the count of time."""
        if self._held_since_s is None:
            self._held_since_s = now_s

    def go_on(self, now_s: float) -> None:
        """Continue the count of time."""
        if self._held_since_s is not None:
            self._held_s += now_s - self._held_since_s
            self._held_since_s = None

    @property
    def on_hold(self) -> bool:
        """Return whether nothing is done."""
        return self._held_since_s is not None

    def left_s(self, now_s: float) -> float | None:
        """Return the seconds left at the mean pace of the later half of the completed steps.

        Return None before the first step, on hold, at the end, and while the last step
        takes longer than predicted. A step is expected to take the mean time. The time left
        of a longer step falls by exp(-t), so that the sum falls all the time.
        """
        first = self._ends[:1]
        latest = self._ends[-1:]
        if self.on_hold or first == latest or self.done >= self.total:
            return None
        ((latest_s, done),) = latest
        half = done - (done - first[0][1] + 1) // 2
        since_s, already = [end for end in self._ends if end[1] <= half][-1]
        mean_s = (latest_s - since_s) / (done - already)
        if mean_s <= 0:
            return 0.0
        now_s -= self._held_s + latest_s
        more = self.total - self.done - 1
        if more == 0 and now_s > mean_s:
            return None
        return mean_s * (more + math.exp(-max(0.0, now_s) / mean_s))


def in_words(seconds: float) -> str:
    """Return a time in words, to a second below ten minutes.

    Lines that appear every ten seconds therefore always differ.
    """
    whole = max(1, math.ceil(seconds))
    if whole < 90:
        return f"{whole} s"
    if whole < 600:
        return f"{whole // 60} min" + (f" {whole % 60} s" if whole % 60 else "")
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


@dataclass(slots=True)
class Work:
    """The progress of some work.

    expected_s: duration by earlier work or by a rule, which counts until steps show a pace;
    None if unknown; expected_by: whose duration that is
    """

    doing: str
    step: str = ""
    pace: Pace = field(default_factory=Pace)
    began_s: float = field(default_factory=lambda: time.monotonic())
    expected_s: float | None = None
    expected_by: str = EARLIER

    def report(self, done: int, total: int, step: str) -> None:
        """Record the start of a step, as a `Progress`."""
        now_s = time.monotonic()
        if step == PAUSED:
            self.pace.hold(now_s)
        else:
            self.pace.go_on(now_s)
        self.pace.at(done, total, now_s)
        self.step = step

    def times(self) -> str:
        """Return the elapsed time and the time left, in words that keep the two apart."""
        now_s = time.monotonic()
        so_far = f"{in_words(now_s - self.began_s)} so far"
        left_s = self.pace.left_s(now_s)
        if left_s is not None:
            return f"{so_far}, about {in_words(left_s)} left"
        if self.pace.on_hold or self.pace.done >= self.pace.total > 0:
            return so_far
        if self.expected_s is None:
            return f"{so_far}, time left not known yet"
        usual = f"the {in_words(self.expected_s)} that {self.expected_by}"
        if (left_s := self.expected_s - (now_s - self.began_s)) > 0:
            return f"{so_far}, about {in_words(left_s)} left of {usual}"
        return f"{so_far}, more than {usual}"
