"""One carpet at several places of the frame: each place is a tile, by where the carpet is found."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.field_sessions import LENS, MISALIGNED, FieldSession, field_session
from labkit.analysis.observe import observe
from labkit.analysis.target_places import tiles_by_place
from labkit.devices.protocols import ExposureSettings
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.camera import SimulatedCamera
from labkit.errors import LostTasksError, TargetError
from labkit.jobs.execute import Result, Task
from labkit.jobs.sharing import pack, unpacked
from labkit.session.import_frames import import_frames
from labkit.session.session import Session
from labkit.target.target import open_target
from labkit.types import Floats

SQUARE = np.array([[-40.0, -40], [-40, 40], [40, 40], [40, -40]])
PLACES = [(100, 100), (100, 300), (250, 110)]


def at(middle: tuple[float, float]) -> Floats:
    return SQUARE + middle


def test_photographs_of_one_place_have_no_tile() -> None:
    """The aim wanders by a pixel within a range, and by a whole side from range to range."""
    corners = {"a": at((100, 100)), "b": at((101, 99)), "c": at((180, 100))}
    assert tiles_by_place(corners, [["a", "b"], ["c"]]) == {}


def test_places_are_counted_by_rows_and_columns_from_the_upper_left() -> None:
    corners = {f"near{k}": at(place) for k, place in enumerate(PLACES)}
    # farther away the places are nearer to the middle of the frame
    corners |= {f"far{k}": at((0.95 * y, 0.95 * x)) for k, (y, x) in enumerate(PLACES)}
    corners["again"] = at((101, 101))
    ranges = [["near0", "near1", "near2", "again"], ["far0", "far1", "far2"]]
    tiles = tiles_by_place(corners, ranges)
    expected = [(0, 0), (0, 1), (1, 0)]
    assert [tiles[f"near{k}"] for k in range(3)] == expected
    assert [tiles[f"far{k}"] for k in range(3)] == expected
    assert tiles["again"] == (0, 0)


SHARP = replace(LENS, f_number=11.0, field_terms=replace(MISALIGNED, k1_per_mm2=0.0))
"""Its spread is small, and rendered in a moment."""


def moved_carpet() -> FieldSession:
    """A carpet that is moved over the panel: the grid has its places."""
    return field_session((1, 2), (1180.0, 1260.0), SHARP, tile_px=72, order=2)


def photograph(session: FieldSession, folder: Path) -> Bench:
    """Write a session of one carpet that is photographed at each place of a grid in turn."""
    folder.mkdir()
    bench = Bench(session.settings)
    white = np.full(session.settings.panel.pixels, 255, dtype=np.uint8)
    rows: list[tuple[str, str, str]] = []
    with SimulatedCamera(bench) as camera:
        camera.configure(ExposureSettings(0.02, 100))
        for range_mm in session.ranges_mm:
            position_mm = range_mm - session.settings.rail.range_at_zero_mm
            bench.turn_screw(position_mm)
            bench.stand(position_mm)
            pictures = {"flat": white} | {
                f"target{k}": one for k, one in enumerate(one_by_one(session))
            }
            for name, picture in pictures.items():
                camera.see(picture)
                shot = camera.expose(folder / f"{name}_{range_mm:g}").path.name
                rows.append((shot, name.rstrip("01"), f"{range_mm:g}"))
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("file", "kind", "range_mm"), *rows])
    of_grid = ("grid = ", "pitch_mm = ")
    plan = session.plan.to_toml().splitlines()
    one = [line for line in plan if not line.startswith(of_grid)]
    (folder / "plan.toml").write_text("\n".join(one), encoding="utf-8")
    return bench


def one_by_one(session: FieldSession) -> list[NDArray[np.uint8]]:
    """Return the panel's picture with one carpet of the grid at a time."""
    whole = session.picture
    pictures = []
    half = whole.shape[1] // 2
    for shown in (slice(None, half), slice(half, None)):
        one = np.zeros_like(whole)
        one[:, shown] = whole[:, shown]
        pictures.append(one)
    return pictures


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, Bench]:
    folder = tmp_path_factory.mktemp("moved")
    bench = photograph(moved_carpet(), folder / "shots")
    shots = folder / "shots"
    session = import_frames(shots / "frames.csv", shots / "plan.toml", folder / "session")
    return session, bench


def test_a_carpet_that_is_moved_over_the_frame_gives_tiles(
    moved: tuple[Session, Bench],
) -> None:
    session, bench = moved
    plan = session.plan
    observations, findings = observe(session, plan, open_target(plan.target), channel="G")
    keys = {(o.range_mm, o.tile) for o in observations}
    tiles = [(0, 0), (0, 1)]
    assert keys == {(r, tile) for r in (1180.0, 1260.0) for tile in tiles}
    assert [f.code for f in findings].count("target-at-places") == 1
    truth = {
        (visit.range_mm, tile.tile): tile.centre_px
        for visit in bench.truth.visits
        for tile in visit.tiles
        if tile.channel == "G"
    }
    for o in observations:
        assert o.range_mm is not None
        assert o.tile is not None
        centre = np.mean(o.corners_px[0], axis=0)
        # a first guess, which the fit mends: measured 0.6 pixels at most
        assert centre == pytest.approx(truth[o.range_mm, o.tile], abs=1.2)


@dataclass
class OneByOne:
    """Makes tasks that were packed for another process, the last first; the process of one task was killed."""

    killed: int | None = None

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        function, tasks = unpacked(*pack((function, tasks)))
        for index in reversed(range(len(tasks))):
            if index != self.killed:
                yield index, function(tasks[index])
        if self.killed is not None:
            raise LostTasksError([(tasks[self.killed], "killed")])


@pytest.mark.parametrize("killed", [None, 1])
def test_targets_that_other_processes_find_are_those_found_here(
    moved: tuple[Session, Bench], killed: int | None
) -> None:
    session, _ = moved
    target = open_target(session.plan.target)

    def seen(run: OneByOne | None) -> list[Floats]:
        found, _ = observe(session, session.plan, target, channel="G", run=run)
        return [corners for o in found for corners in o.corners_px]

    np.testing.assert_array_equal(seen(OneByOne(killed)), seen(None))


def test_the_first_photograph_without_a_target_is_named_whichever_ends_first(
    moved: tuple[Session, Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    session, _ = moved

    def absent(*_: object, **__: object) -> NoReturn:
        raise TargetError("no target")

    monkeypatch.setattr("labkit.analysis.locate.find_target", absent)
    first = next(frame.file for frame in session.frames if frame.kind == "target")
    target = open_target(session.plan.target)
    for run in (None, OneByOne()):
        with pytest.raises(TargetError, match=f"^{re.escape(first)}: no target, see "):
            observe(session, session.plan, target, channel="G", run=run)
