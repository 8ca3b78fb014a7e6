"""The size and number of tiles within memory."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

from labkit.errors import DataError
from labkit.restoration.job import Job
from labkit.restoration.tiles import memory_bytes

TILE_SIDES_PX = (256, 192, 128, 96, 64)
GB = 1e9
SHARE_OF_FREE, SHARE_OF_ALL = 0.8, 0.5  # of available memory, and of all memory


@dataclass(frozen=True)
class TilePlan:
    """A job's tiles: their side, and the number of processes."""

    job: Job
    tile_px: int
    workers: int = 1

    @property
    def tiles(self) -> int:
        """Their number."""
        return math.prod(math.ceil(side / self.tile_px) for side in self.job.shape)

    @property
    def gigabytes(self) -> float:
        """Memory of the tiles under way, and of a picture of one tile; a larger picture is in a file."""
        job = self.job
        picture = 0.0
        if self.tiles == 1:
            picture = 12.0 * len(job.colours) * math.prod(job.shape) * job.samples**2
        tile = memory_bytes(job, self.tile_px, 2 * job.guard_px)
        return (picture + self.workers * tile) / GB

    @property
    def photographs_gigabytes(self) -> float:
        """Memory of the photographs, which are held whole meanwhile."""
        arrays = [a for p in self.job.photographs for a in (p.counts, p.used, p.light)]
        return sum(array.nbytes for array in arrays) / GB

    def __str__(self) -> str:
        (rows, columns), job = self.job.shape, self.job
        plural = "one tile"
        if self.tiles > 1:
            plural = f"{self.tiles} tiles of {self.tile_px} pixels"
        return (
            f"{rows} x {columns} pixels, {job.samples} samples a pixel ({job.pitch_um / job.samples:.3g} um): {plural}, "
            f"about {self.gigabytes:.2g} GB, besides {self.photographs_gigabytes:.2g} GB of photographs"
        )


def planned_tiles(
    job: Job, tile_px: int | None, memory_gb: float | None, workers: int
) -> TilePlan:
    """Return the largest tiles that memory allows, or those requested, on as many processes as it allows.

    Raises DataError if no tile fits, or the requested one does not.
    """
    free = _free_gigabytes() if memory_gb is None else memory_gb
    largest = max(job.shape)
    whole = [largest] if largest <= TILE_SIDES_PX[0] else []
    sizes = [*whole, *(size for size in TILE_SIDES_PX if size < largest)]
    best = next((s for s in sizes if TilePlan(job, s).gigabytes <= free), None)
    wanted = TilePlan(job, tile_px or best or sizes[-1])
    if wanted.gigabytes > free:
        needed = f"takes {wanted.gigabytes:.2g} GB"
        if best is not None:
            raise DataError(
                f"--tile {tile_px}: that {needed}, and {free:.2g} GB are free: --tile {best} fits"
            )
        raise DataError(
            f"restoring {job.shape[0]} x {job.shape[1]} pixels at {job.samples} samples a pixel {needed} "
            f"even in tiles of {wanted.tile_px} pixels, and {free:.2g} GB are free: take fewer with --samples, or --crop"
        )
    most = min(workers, wanted.tiles)
    plans = (TilePlan(job, wanted.tile_px, n) for n in range(most, 1, -1))
    return next((plan for plan in plans if plan.gigabytes <= free), wanted)


def _free_gigabytes() -> float:
    """Return the memory to use."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            available = next(line for line in file if line.startswith("MemAvailable"))
        return SHARE_OF_FREE * float(available.split()[1]) * 1e3 / GB
    except (OSError, StopIteration):
        return SHARE_OF_ALL * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GB
