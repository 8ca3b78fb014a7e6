"""How surely and how soon a target is found in whole frames: `python -m benchmarks.rooms --rooms 100`.

Rooms are parts of sample pictures with windows, lamps and another screen, of 1.5, 6 and 24 million pixels; carpets have
60 pixels to 0.9 of the frame, any direction, up to 20 degrees of tilt, any light. With `--golden FOLDER` the crops of golden
sessions are pasted into rooms of 24 million pixels, and their corners compared with those found in the crop alone.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import cv2
import numpy as np

from labkit.errors import RawError, TargetError
from labkit.finder.find_target import find_target
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.target.target import CellTarget, Target, open_target
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats
from tests.rooms import Pose, as_counts, draw_target, random_poses, random_room
from tests.whole_frames import Embedding, room_counts, turned

SHAPES = ((1000, 1500), (2000, 3000), (4000, 6000))
LARGEST = SHAPES[-1]
CELLS = carpet_cells(5)
CARPET = CellTarget(CELLS, (30.0, 30.0))
PLACES = 20


def searched(photograph: Photograph, target: Target) -> tuple[Floats | None, float, str]:
    """Return the corners that are found, the processor time in seconds, and why none are."""
    began = process_time()
    try:
        return find_target(photograph, target), process_time() - began, ""
    except TargetError as error:
        return None, process_time() - began, str(error)


def away_px(found: Floats | None, true: Floats) -> float:
    """Return the largest distance of corners, whichever of a carpet's eight poses is found; infinite if none is."""
    ways = [np.roll(way, k, axis=0) for way in (true, true[::-1]) for k in range(4)]
    return np.inf if found is None else min(float(np.abs(found - w).max()) for w in ways)


def drawn_rooms(
    count: int, rng: np.random.Generator
) -> Iterator[tuple[Photograph, Pose | None, float]]:
    """Yield rooms, every other one with a carpet: the photograph, the carpet's pose, and its blur in pixels."""
    for number in range(2 * count):
        shape = SHAPES[number // 2 % len(SHAPES)]
        room = np.zeros(shape, np.float32) if number % 10 == 9 else random_room(shape, rng)
        pose, blur_px = None, 0.0
        if number % 2:
            pose = next(random_poses(shape, rng))
            blur_px = float(rng.choice([0.6, 1.0, 0.03 * pose.side_px]))
            white = float(rng.uniform(0.05, 1.0))
            draw_target(room, CELLS, pose, black=0.02 * white, white=white, blur_px=blur_px)
        counts = as_counts(room, rng)
        yield (
            Photograph(counts, np.full((2, 2), 600.0), 16383.0, ("RG", "GB")),
            pose,
            blur_px,
        )


def report_drawn(count: int) -> None:
    """Print how many carpets are found and missed in drawn rooms, and the time that it takes."""
    wrong, missed = 0, 0
    times: dict[tuple[int, bool], list[float]] = {}
    for photograph, pose, blur_px in drawn_rooms(count, np.random.default_rng(1)):
        found, seconds, why = searched(photograph, CARPET)
        times.setdefault((photograph.counts.size, pose is not None), []).append(seconds)
        if pose is None:
            wrong += found is not None
            continue
        away = away_px(found, pose.corners())
        if away > max(0.5, blur_px / 6, pose.side_px / 700):
            missed += 1
            print(f"missed: {pose}, blur {blur_px:.1f} px, {away:.2f} px away {why}")
    print(
        f"{count} rooms without a carpet: {wrong} found; {count} with one: {missed} missed"
    )
    for (size, has), each in sorted(times.items()):
        words = "with" if has else "without"
        print(
            f"{size / 1e6:5.1f} Mpx {words:7s}: {np.median(each):.2f} s, at most {max(each):.2f} s"
        )


def report_golden(folder: Path) -> None:
    """Print how far corners in whole frames are from those in the crop, session by session."""
    rng = np.random.default_rng(3)
    for plan_path in sorted(folder.glob("*/plan.toml")):
        plan = Plan.load(plan_path)
        if plan.target.of_many:
            continue
        with (plan_path.parent / "frames.csv").open(encoding="utf-8") as table:
            files = [
                row["file"] for row in csv.DictReader(table) if row["kind"] == "target"
            ]
        target = open_target(plan.target)
        try:
            away, times = zip(
                *(
                    _embedded(
                        plan_path.parent / str(rng.choice(files)), plan, target, rng, k
                    )
                    for k in range(PLACES)
                ),
                strict=True,
            )
        except RawError as error:
            print(f"{plan_path.parent.name:16s} {error}")
            continue
        print(
            f"{plan_path.parent.name:16s} {PLACES} places: {max(away):.3f} px at most, {np.median(times):.2f} s"
        )


def _embedded(
    path: Path, plan: Plan, target: Target, rng: np.random.Generator, number: int
) -> tuple[float, float]:
    """Return how far the corners in a whole frame are from those in the crop, pixels, and the seconds."""
    crop = read_photograph(path, plan.sensor)
    alone = find_target(crop, target)
    turns = int(rng.integers(4))
    counts, cell = turned(crop.counts, crop.pattern, turns)
    rows, cols = (n - n % 2 for n in crop.counts.shape)
    for _ in range(turns):
        alone = np.column_stack((cols - 1 - alone[:, 1], alone[:, 0]))
        rows, cols = cols, rows
    place = [
        int(rng.integers(0, n - m)) // 2 * 2
        for n, m in zip(LARGEST, counts.shape, strict=True)
    ]
    room = random_room(LARGEST, rng) if number % 3 else None
    black, white = float(crop.black.flat[0]), crop.white
    frame = room_counts(Embedding(light=0.9), room, black, white, rng)
    frame[place[0] : place[0] + counts.shape[0], place[1] : place[1] + counts.shape[1]] = (
        counts
    )
    pattern = (cell[:2], cell[2:]) if len(cell) == 4 else crop.pattern
    found, seconds, _ = searched(Photograph(frame, crop.black, white, pattern), target)
    return away_px(found, alone + place), seconds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=100)
    parser.add_argument("--golden", type=Path)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    if chosen.golden is None:
        report_drawn(chosen.rooms)
    else:
        report_golden(chosen.golden)
