"""LibRaw with files opened by Python: LibRaw cannot open paths outside UTF-8."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rawpy

from labkit.errors import RawError
from labkit.photographs.container import Container
from labkit.photographs.exif import positive_number, whole_number
from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import MONO
from labkit.storage.reading import opened_photograph

DAMAGE = ("data corrupted", "Unexpected end of file")
"""LibRaw's messages about damaged files decoded nevertheless."""


@contextmanager
def opened_raw(path: Path) -> Iterator[rawpy.RawPy]:
    """Open a raw file. Raises rawpy.LibRawError, OSError."""
    with opened_photograph(path) as file, rawpy.imread(file) as raw:
        yield raw


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Collect lines written to file descriptor 2 into the list, which is filled at the end.

    LibRaw reports damaged data only there. This holds for the whole process: keep it short.
    """
    lines: list[str] = []
    kept = os.dup(2)
    # in memory where the system has that: TMPDIR may be full
    with (
        open(os.memfd_create("stderr"), "w+b")
        if hasattr(os, "memfd_create")
        else tempfile.TemporaryFile() as sink
    ):
        os.dup2(sink.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            sink.seek(0)
            lines += sink.read().decode(errors="replace").splitlines()


def read_libraw(path: Path, container: Container) -> Photograph:
    """Decode a camera's raw file. Raises RawError for a damaged file or one without a mosaic of cells of 2 x 2."""
    if container.staggered:
        raise RawError(
            "has a colour filter array of staggered rows or columns; labkit cannot use it yet"
        )
    if container.cfa_px is not None:
        _refuse_other_cells(container.cfa_px)
    with captured_stderr() as printed:
        try:
            with opened_raw(path) as raw:
                photograph = _decoded(raw, container)
        except rawpy.LibRawError as error:
            reason = error.args[0] if error.args else ""
            words = reason.decode() if isinstance(reason, bytes) else str(error)
            damaged = isinstance(error, rawpy.LibRawIOError)
            cause = "is truncated or damaged" if damaged else "is no raw photograph"
            raise RawError(f"{cause} ({words})") from error
        except NotImplementedError as error:  # rawpy's, of an impossible filter array
            raise RawError(f"is no raw photograph ({error})") from error
    if any(words in line for words in DAMAGE for line in printed):
        raise RawError(f"is damaged ({printed[0].rpartition(': ')[2].strip()})")
    return photograph


def _decoded(raw: rawpy.RawPy, container: Container) -> Photograph:
    image = raw.raw_image_visible
    if raw.raw_type != rawpy.RawType.Flat or image is None or image.ndim != 2:
        raise RawError(
            "holds colours already mixed (demosaiced or layered); labkit needs the mosaic itself"
        )
    if image.dtype != np.uint16:
        raise RawError(f"holds {image.dtype} numbers; labkit needs 8 to 16 bit integers")
    levels = np.asarray(raw.black_level_per_channel, dtype=np.float64)
    pattern: tuple[str, ...] = MONO
    black = np.full((2, 2), levels[0])
    if raw.num_colors != 1:
        if (cell := raw.raw_pattern) is None:
            raise RawError("has a colour filter array that LibRaw does not know")
        _refuse_other_cells(cell.shape)
        colours = raw.color_desc.decode()
        pattern = tuple("".join(colours[index] for index in row) for row in cell)
        black = levels[cell]
    return Photograph(
        np.array(image),
        black,
        float(raw.white_level),
        pattern,
        container.camera,
        positive_number(raw.other.shutter_speed) or container.exposure_s,
        whole_number(raw.other.iso_speed) or container.iso,
    )


def _refuse_other_cells(cell_px: tuple[int, ...]) -> None:
    """Raise RawError for a filter array whose cell is not 2 x 2."""
    if cell_px != (2, 2):
        raise RawError(
            f"has a colour filter array that repeats every {'x'.join(map(str, cell_px))} pixels, and not every 2x2; "
            "labkit cannot use it yet"
        )
