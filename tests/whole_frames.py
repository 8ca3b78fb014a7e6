"""Golden sessions pasted into whole frames of a camera: the crop at a place, turned by quarters, in a room.

The pixels of a crop stay as they are: a fit must end with the crop's results. `python -m tests.whole_frames SESSION FOLDER`
writes one to try by hand.
"""

from __future__ import annotations

import csv
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from tests.dng import write_dng

GAIN, READ_NOISE = 0.4, 3.0
"""Of the room's pixels: counts for each electron, counts."""


@dataclass(frozen=True)
class Embedding:
    """How crops are pasted into frames.

    shape: of the frame; place: the crop's first row and column, both even; turns: quarter turns to the left; room: any
    picture, 0 to 1, stretched over the frame, None for a dark room; light: of the room's white, relative to full scale;
    seed: of the room's noise.
    """

    shape: tuple[int, int] = (4000, 6000)
    place: tuple[int, int] = (1800, 2900)
    turns: int = 0
    room: NDArray[Any] | None = None
    light: float = 0.5
    seed: int = 1


def embed_session(source: Path, folder: Path, how: Embedding) -> Path:
    """Write a session of DNG files, its plan and its frames.csv into a new folder, with crops embedded in frames."""
    folder.mkdir(parents=True)
    shutil.copy(source / "plan.toml", folder)
    shutil.copy(source / "frames.csv", folder)
    plan = Plan.load(source / "plan.toml")
    rng = np.random.default_rng(how.seed)
    with (source / "frames.csv").open(encoding="utf-8") as table:
        for row in csv.DictReader(table):
            photograph = read_photograph(source / row["file"], plan.sensor)
            counts, cell = turned(photograph.counts, photograph.pattern, how.turns)
            black, white = float(photograph.black.flat[0]), photograph.white
            lit = row["kind"] in ("target", "flat")
            room = how.room if lit else None
            frame = room_counts(how, room, black, white, rng)
            at = tuple(
                slice(start, start + n)
                for start, n in zip(how.place, counts.shape, strict=True)
            )
            frame[at] = counts
            write_dng(
                folder / row["file"], frame, cfa=cell, black=int(black), white=int(white)
            )
    return folder


def turned(
    counts: NDArray[np.uint16], pattern: tuple[str, ...], turns: int
) -> tuple[NDArray[np.uint16], str]:
    """Return counts turned by quarters to the left, and the cell of their filter array."""
    rows, cols = (n - n % 2 for n in counts.shape)
    cell = np.rot90(np.array([list(row) for row in pattern]), turns)
    return np.rot90(counts[:rows, :cols], turns), "".join(cell.ravel())


def room_counts(
    how: Embedding,
    room: NDArray[Any] | None,
    black: float,
    white: float,
    rng: np.random.Generator,
) -> NDArray[np.uint16]:
    """Return a frame of a room, as counts with noise."""
    noise = rng.standard_normal(how.shape, dtype=np.float32)
    if room is None:
        light = np.zeros(how.shape, np.float32)
    else:
        stretched = cv2.resize(
            room.astype(np.float32), how.shape[::-1], interpolation=cv2.INTER_LINEAR
        )
        light = np.clip(stretched, 0, 1) * np.float32(how.light * (white - black))
    frame = black + light + noise * np.sqrt(GAIN * light + READ_NOISE**2)
    return np.asarray(np.clip(np.rint(frame), 0, white), np.uint16)


if __name__ == "__main__":
    print(embed_session(Path(sys.argv[1]), Path(sys.argv[2]), Embedding()))
