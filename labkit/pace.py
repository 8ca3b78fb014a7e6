"""How much longer work takes, by the steps that are done: counted down, never to nothing while there is more to do."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

PAUSED = "paused on the operator's page"
"""The name of a step in which nothing is done until somebody lets it."""


class Pace:
    """Steps done of those to do, and when; times in seconds of any clock. Time on hold counts for nothing."""

    def __init__(self) -> None:
        self.done = self.total = 0
        self._ends: list[tuple[float, int]] = []
        self._held_since_s: float | None = None
        self._held_s = 0.0

    def at(self, done: int, total: int, now_s: float) -> None:
        """So many steps are done of so many, now. Fewer than before, none yet, or of an unknown number, begin anew."""
        if done < self.done or not (total and self.total):
            self._ends = []
        if not self._ends or done > self.done:
            self._ends.append((now_s - self._held_s, done))
        self.done, self.total = done, total

    def hold(self, now_s: float) -> None:
        """Nothing is done from now on."""
        if self._held_since_s is None:
            self._held_since_s = now_s

    def go_on(self, now_s: float) -> None:
        """Work goes on."""
        if self._held_since_s is not None:
            self._held_s += now_s - self._held_since_s
            self._held_since_s = None

    @property
    def on_hold(self) -> bool:
        """Whether nothing is done."""
        return self._held_since_s is not None

    def left_s(self, now_s: float) -> float | None:
        """Seconds left at the mean pace of the later half of the steps that are done.

        None before one is, on hold, at the end, and where the last step takes longer than that: nobody knows how much longer.
        A step is expected to take as long as the mean. One that takes longer is about to end for as long as that takes: what is
        left of it falls by exp(-t), so that the sum falls all the time.
        """
        first, latest = self._ends[:1], self._ends[-1:]
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
    """A time as people say it; below ten minutes to a second, so that a line every ten seconds never says the same twice."""
    whole = max(1, math.ceil(seconds))
    if whole < 90:
        return f"{whole} s"
    if whole < 600:
        return f"{whole // 60} min" + (f" {whole % 60} s" if whole % 60 else "")
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


@dataclass(slots=True)
class Work:
    """How far some work is."""

    doing: str
    step: str = ""
    pace: Pace = field(default_factory=Pace)
    began_s: float = field(default_factory=lambda: time.monotonic())

    def report(self, done: int, total: int, step: str) -> None:
        """Take note that a step begins, as a `Progress`."""
        now_s = time.monotonic()
        if step == PAUSED:
            self.pace.hold(now_s)
        else:
            self.pace.go_on(now_s)
        self.pace.at(done, total, now_s)
        self.step = step

    def times(self) -> str:
        """How long it has taken, and how much longer it takes, in words that cannot be taken for each other."""
        now_s = time.monotonic()
        so_far, left_s = f"{in_words(now_s - self.began_s)} so far", self.pace.left_s(now_s)
        if left_s is not None:
            return f"{so_far}, about {in_words(left_s)} left"
        if self.pace.on_hold or self.pace.done >= self.pace.total > 0:
            return so_far
        return f"{so_far}, time left not known yet"
