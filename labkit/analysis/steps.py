"""Progress of a session's fit in words: fits under way, and the step of each search."""

from __future__ import annotations

from dataclasses import dataclass, field

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
        self.done, self.total, self.step = done, total, step
        self._report()

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
