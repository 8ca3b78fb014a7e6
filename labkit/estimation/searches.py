"""Searches of a session's observations as tasks of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from labkit.errors import FitError, LostTasksError
from labkit.estimation.local import Found, Guesses, Views, find_optima
from labkit.estimation.observation import Observation
from labkit.estimation.stray_pixels import without_pixels
from labkit.imaging.optics import Optics
from labkit.jobs.execute import Run
from labkit.jobs.processes import say
from labkit.jobs.sharing import Shared, share
from labkit.target.target import Target
from labkit.types import Progress


@dataclass(frozen=True)
class Task:
    """One search as a task. Target and frames are shared, so a task is small."""

    label: str
    optics: Optics
    target: Shared[Target]
    views: Shared[Views]
    guesses: Guesses


def fit_task(task: Task) -> Found:
    """Run one search. Raises FitError whatever fails: the other searches go on."""
    try:
        return find_optima(
            task.optics,
            task.target.value,
            task.views.value,
            task.guesses,
            progress=lambda step: say(f"{task.label}: {step}"),
        )
    except MemoryError:
        raise
    except Exception as error:
        raise FitError(f"{type(error).__name__}: {error}") from error


@dataclass
class Searches:
    """Runs searches of a session's observations, and counts them.

    Attributes
    ----------
    observations : observations of the session, in order; stray pixels that searches find are left out of them
    targets : the target as shown to each channel
    run : maps tasks
    progress : called with the searches under way
    fitted : places of observations that have a fit
    lost : by label, the reason why a search was lost
    made : number of completed searches
    later : number of steps known to follow the session's first fits; None if that depends on the searches
    """

    observations: list[Observation]
    targets: Mapping[str, Target]
    run: Run
    progress: Progress
    fitted: set[int] = field(default_factory=set)
    lost: dict[str, str] = field(default_factory=dict)
    made: int = 0
    later: int | None = None

    def __post_init__(self) -> None:
        self.shown = {channel: share(target) for channel, target in self.targets.items()}
        self.views = [share(Views(o.frames, o.poses, o.noise)) for o in self.observations]

    def __call__(
        self, wanted: Mapping[int, tuple[Optics, Guesses]], doing: str
    ) -> dict[int, Found]:
        """Search for the optima of observations, by place. Return those found, in the order of the observations.

        Parameters
        ----------
        wanted : by place, optics to start from and guesses
        doing : kind of search, for the progress
        """
        places = sorted(wanted)
        every = self.each([(k, *wanted[k]) for k in places], doing)
        return {k: found for k, found in zip(places, every, strict=True) if found}

    def each(
        self, wanted: Sequence[tuple[int, Optics, Guesses]], doing: str
    ) -> list[Found | None]:
        """Make some searches, of an observation several perhaps. Return what each found; None if it was lost.

        Searches at the shortest wavelength start first, for their pictures are the finest and take longest. Reasons for lost
        searches are recorded in `lost`.

        Parameters
        ----------
        wanted : place of the observation, optics to start from and guesses
        doing : kind of search, for the progress
        """
        if not wanted:
            return []
        results: list[Found | None] = [None] * len(wanted)
        order = sorted(range(len(wanted)), key=lambda i: wanted[i][1].wavelength_um)
        tasks = [self._task(*wanted[i]) for i in order]
        under_way = {i: task.label for i, task in zip(order, tasks, strict=True)}
        left = max(len(self.observations) - len(self.fitted), len(tasks))
        total = 0 if self.later is None else self.made + left + self.later
        try:
            self.progress(self.made, total, _named(doing, under_way))
            for index, found in self.run(fit_task, tasks):
                self.made += 1
                del under_way[order[index]]
                self.progress(self.made, total, _named(doing, under_way))
                results[order[index]] = found
                self._leave_out(wanted[order[index]][0], found)
        except LostTasksError as error:
            self.lost |= {task.label: why for task, why in error.lost}
        self.fitted |= {k for (k, *_), found in zip(wanted, results, strict=True) if found}
        return results

    @property
    def ranges_mm(self) -> list[float]:
        """Ranges of the observations that have one."""
        ranges = (one.measured_range_mm for one in self.observations)
        return [each for each in ranges if each is not None]

    def conclude(self, later: int) -> None:
        """Report that the searches are made, and the number of steps that follow."""
        doing = "what the fits make of the lens, and its images of points"
        self.progress(self.made, self.made + later, doing)

    @property
    def left_out(self) -> list[str]:
        """Lines about the observations without a fit."""
        fitted = {self.observations[k].key.label for k in self.fitted}
        return [
            f"{label} is left out: {why}"
            for label, why in self.lost.items()
            if label not in fitted
        ]

    def _leave_out(self, k: int, found: Found) -> None:
        """Leave the pixels that a search found to be stray out of an observation."""
        if found.strays:
            of = self.observations[k]
            frames = without_pixels(of.frames, found.strays)
            self.observations[k] = of = replace(of, frames=frames)
            self.views[k] = share(Views(of.frames, of.poses, of.noise))

    def _task(self, k: int, optics: Optics, guesses: Guesses) -> Task:
        observation = self.observations[k]
        return Task(
            observation.key.label,
            optics,
            self.shown[observation.channel],
            self.views[k],
            guesses,
        )


def _named(doing: str, under_way: Mapping[int, str]) -> str:
    """Describe the kind of search and the first three searches under way."""
    labels = list(dict.fromkeys(under_way.values()))
    first, more = labels[:3], len(labels) - 3
    if not first:
        return doing
    return f"{doing}: {', '.join(first)}" + (f" and {more} more" if more > 0 else "")
