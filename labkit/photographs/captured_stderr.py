"""What C libraries print to standard error behind Python's back."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Collect the lines written to file descriptor 2 meanwhile, into the list given, filled on leaving.

    LibRaw reports damaged data only there, and decodes on. Holds for the whole process: keep it short.
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
