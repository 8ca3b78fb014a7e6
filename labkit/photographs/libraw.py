"""LibRaw, given a file that Python has opened: it would not find one whose path is no UTF-8."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rawpy

from labkit.errors import RawError
from labkit.photographs.captured_stderr import captured_stderr
from labkit.photographs.container import Container
from labkit.photographs.photograph import Mosaic
from labkit.plan.sensor import MONO

DAMAGE = ("data corrupted", "Unexpected end of file")
"""What LibRaw prints of a file that it decodes all the same."""


@contextmanager
def opened_raw(path: Path) -> Iterator[rawpy.RawPy]:
    """A raw file, opened. Raises rawpy.LibRawError, OSError."""
    with path.open("rb") as file, rawpy.imread(file) as raw:
        yield raw


def read_libraw(path: Path, container: Container) -> Mosaic:
    """The mosaic in a camera's raw file. Raises RawError for one that is damaged, or holds no mosaic."""
    with captured_stderr() as chatter:
        try:
            with opened_raw(path) as raw:
                mosaic = _mosaic_of(raw, container)
        except rawpy.LibRawError as error:
            reason = (
                error.args[0].decode()
                if error.args and isinstance(error.args[0], bytes)
                else str(error)
            )
            cause = (
                "is truncated or damaged"
                if isinstance(error, rawpy.LibRawIOError)
                else "is no raw photograph"
            )
            raise RawError(f"{cause} ({reason})") from error
        except NotImplementedError as error:  # rawpy's, of a filter array that cannot be
            raise RawError(f"is no raw photograph ({error})") from error
    if any(words in line for words in DAMAGE for line in chatter):
        raise RawError(f"is damaged ({chatter[0].rpartition(': ')[2].strip()})")
    return mosaic


def _mosaic_of(raw: rawpy.RawPy, container: Container) -> Mosaic:
    if (
        raw.raw_type != rawpy.RawType.Flat
        or raw.raw_image_visible is None
        or raw.raw_image_visible.ndim != 2
    ):
        raise RawError(
            "holds colours already mixed (demosaiced or layered); labkit needs the mosaic itself"
        )
    counts = np.array(raw.raw_image_visible)
    if counts.dtype != np.uint16:
        raise RawError(f"holds {counts.dtype} numbers; labkit needs 8 to 16 bit integers")
    levels = np.asarray(raw.black_level_per_channel, dtype=np.float64)
    pattern: tuple[str, ...]
    if raw.num_colors == 1:
        pattern, black = MONO, np.full((2, 2), levels[0])
    elif raw.raw_pattern is not None and raw.raw_pattern.shape == (2, 2):
        colours = raw.color_desc.decode()
        pattern = tuple("".join(colours[index] for index in row) for row in raw.raw_pattern)
        black = levels[raw.raw_pattern]
    else:
        raise RawError(
            "has a colour filter array that does not repeat every 2x2 pixels; labkit cannot use it yet"
        )
    return Mosaic(
        counts=counts,
        black=black,
        white=float(raw.white_level),
        pattern=pattern,
        camera=container.camera,
        exposure_s=raw.other.shutter_speed or container.exposure_s,
        iso=int(raw.other.iso_speed) or container.iso,
    )
