"""Progress of a session's fit in words: fits under way, and the step of each search."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from labkit.jobs.execute import Result, Run, Task
from labkit.types import Progress


@dataclass
class Steps:
    """A `Progress` for steps "DOING: LABEL, LABEL" that adds the last message of each label under way."""

    progress: Progress
    done: int = 0
    total: int = 0
    step: str = ""
    said: dict[str, str] = field(default_factory=dict)

    def __call__(self, done: int, total: int, step: str) -> None:
        """Report progress, see `Progress`, and forget messages of earlier work."""
        if step.partition(": ")[0] != self.step.partition(": ")[0]:
            self.said = {}
        self.done = done
        self.total = total
        self.step = step
        self._report()

    def before(self, done: int, total: int, step: str) -> None:
        """Report steps of another pace than the fits to come: neither their number nor their time is known yet."""
        self(0, 0, f"{step}, {done} of {total} done")

    def counted(self, run: Run) -> Counted:
        """Return a run whose tasks count as steps after those done."""
        return Counted(run, self)

    def heard(self, words: str) -> None:
        """Receive a message "LABEL: STEP" from work under way."""
        label, _, step = words.partition(": ")
        self.said[label] = step
        self._report()

    def _report(self) -> None:
        doing, colon, labels = self.step.partition(": ")
        named = (
            f"{label} ({self.said[label]})" if label in self.said else label
            for label in labels.split(", ")
        )
        self.progress(self.done, self.total, doing + colon + ", ".join(named))


@dataclass(frozen=True)
class Counted:
    """A `Run` that counts tasks of another run as steps."""

    run: Run
    steps: Steps

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Map tasks, see `Run`."""
        for index, result in self.run(function, tasks):
            done = self.steps.done + 1
            self.steps(done, max(self.steps.total, done + 1), self.steps.step)
            yield index, result
