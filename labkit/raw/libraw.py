"""LibRaw, given a file that Python has opened: it would not find one whose path is no UTF-8."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rawpy


@contextmanager
def opened_raw(path: Path) -> Iterator[rawpy.RawPy]:
    """A raw file, opened. Raises rawpy.LibRawError, OSError."""
    with path.open("rb") as file, rawpy.imread(file) as raw:
        yield raw
