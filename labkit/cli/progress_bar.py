"""A bar on a terminal, with the time so far and the time left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console as Terminal
from rich.console import RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
)
from rich.table import Column
from rich.text import Text

from labkit.errors import printable
from labkit.jobs.pace import Work


def terminal() -> Terminal | None:
    """Return the terminal of stderr; None where there is none."""
    stderr = Terminal(stderr=True)
    return stderr if stderr.is_terminal else None


@contextmanager
def bar_of(work: Work, shown_on: Terminal) -> Iterator[Bar]:
    """Move a progress bar until the end of the block."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        _Times(work),
    )
    with Bar(work, *columns, console=shown_on, transient=True) as bar:
        yield bar


class Bar(Progress):
    """A bar with the current step below, shortened to the width of the terminal."""

    def __init__(
        self, work: Work, *columns: ProgressColumn, console: Terminal, transient: bool
    ) -> None:
        self._work = work
        super().__init__(*columns, console=console, transient=transient)
        self._task = self.add_task(work.doing, total=None)

    def report(self, done: int, total: int, step: str) -> None:
        """Move to a step, as a `Progress`."""
        self._work.report(done, total, step)
        self.update(self._task, completed=done, total=total or None)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield Text(f"  {printable(self._work.step)}", no_wrap=True, overflow="ellipsis")


class _Times(ProgressColumn):
    """Time so far, and time left."""

    max_refresh = 0.5

    def __init__(self, work: Work) -> None:
        super().__init__(Column(no_wrap=True))
        self._work = work

    def render(self, task: Task) -> Text:
        return Text(self._work.times())
