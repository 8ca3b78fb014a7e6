"""What a fit of a session is doing, in words: which fits are under way, and where each search is."""

from __future__ import annotations

from dataclasses import dataclass, field

from labkit.types import Progress


@dataclass
class Steps:
    """A `Progress` whose step names what is under way, "DOING: LABEL, LABEL", and says of each what was heard of it last."""

    progress: Progress
    done: int = 0
    total: int = 0
    step: str = ""
    said: dict[str, str] = field(default_factory=dict)

    def __call__(self, done: int, total: int, step: str) -> None:
        """As `Progress`. What was heard of earlier work is forgotten."""
        if step.partition(": ")[0] != self.step.partition(": ")[0]:
            self.said = {}
        self.done, self.total, self.step = done, total, step
        self._report()

    def heard(self, words: str) -> None:
        """Something of work under way, "LABEL: STEP"."""
        label, _, step = words.partition(": ")
        self.said[label] = step
        self._report()

    def _report(self) -> None:
        doing, colon, labels = self.step.partition(": ")
        named = (f"{label} ({self.said[label]})" if label in self.said else label for label in labels.split(", "))
        self.progress(self.done, self.total, doing + colon + ", ".join(named))
