"""Time and memory of a field's fit: `python -m benchmarks.field_time FOLDER [--grid 3 4]`, tiles of 64 × 64 pixels in green.

A session of a lens that changes little over its frame is made in FOLDER, at two ranges, where it is missing, and is fitted in
this process. Processor time is counted, because other programs do not change it much: of each search, and of the whole.
With `--pair` the session is fitted once more by one worker and by two, and the clock decides: on an idle machine only.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from scipy.stats import kstest

import labkit
from benchmarks.field_sessions import LENS, FieldSession, field_session, make
from labkit.drivers.simulated.field import FieldTerms
from labkit.estimation.searches import Task as Search
from labkit.jobs.execute import Result, Task, pin_threads
from labkit.session.import_frames import import_frames

SMOOTH = FieldTerms(
    field_curvature_per_mm=-0.0012,
    sensor_tilt_um_per_mm=(0.6, -0.4),
    coma_waves=(0.03, -0.02),
    coma_per_mm=0.005,
    astigmatism_per_mm=(0.0015, -0.0025),
    astigmatism_per_mm2=0.001,
    k1_per_mm2=0.00005,
)
RANGES_MM = (1180.0, 1260.0)
TILE_PX = 128
"""Of the raw image; green has half of its pixels."""


@dataclass
class Timed:
    """Makes tasks in this process, and keeps the processor time of each search, s."""

    seconds: list[float] = field(default_factory=list)

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Yield the index and the result of each task."""
        for index, task in enumerate(tasks):
            began = process_time()
            result = function(task)
            if isinstance(task, Search):
                self.seconds.append(process_time() - began)
            yield index, result


def session_of(grid: tuple[int, int]) -> FieldSession:
    """Return a session of a grid of carpets of third order."""
    lens = replace(LENS, field_terms=SMOOTH)
    return field_session(grid, RANGES_MM, lens, seed=5, tile_px=TILE_PX, order=3)


def fit_timed(kept: Path) -> None:
    """Fit green in this process, and print processor times and memory."""
    timed, began = Timed(), process_time()
    results = labkit.fit(kept, channels="G", run=timed)
    whole, count = process_time() - began, len(results.wavefronts)
    accepted = sum(one.accepted for one in results.wavefronts)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{accepted} of {count} fits accepted, {len(timed.seconds)} searches")
    print(f"a search: {np.median(timed.seconds):.2f} s in the median")
    print(f"all: {whole:.1f} s, {whole / count:.2f} s a fit, {most:.2f} GB")
    held_out = [one.pulls for one in results.wavefronts if one.pulls is not None]
    pulls = np.concatenate(held_out)
    chance = kstest(pulls, "norm").pvalue
    print(f"{pulls.size} pulls of tiles held out: std {pulls.std():.3f}, p = {chance:.2f}")


def fit_by_pairs(kept: Path) -> None:
    """Fit green by one worker and by two, and print what the clock says."""
    seconds = list[float]()
    for workers in (1, 2):
        began = perf_counter()
        labkit.fit(kept, channels="G", workers=workers)
        seconds.append(perf_counter() - began)
    one, two = seconds
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    print(f"one worker {one:.1f} s, two {two:.1f} s: {one / two:.2f} times as fast")
    print(f"a worker of two: {most:.2f} GB")


def main() -> None:
    """Make the session, fit it, and print times and memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--grid", type=int, nargs=2, default=(3, 4))
    parser.add_argument("--pair", action="store_true")
    asked = parser.parse_args()
    photographs, kept = asked.folder / "photographs", asked.folder / "session"
    if not photographs.exists():
        make(session_of(tuple(asked.grid)), photographs)
    if not kept.exists():
        import_frames(photographs / "frames.csv", photographs / "plan.toml", kept)
    fit_timed(kept)
    if asked.pair:
        fit_by_pairs(kept)


if __name__ == "__main__":
    pin_threads()
    main()
