"""Memory that ends is called so, whichever library meets its end."""

from __future__ import annotations

import errno
import os
import resource

import cv2
import pytest

from labkit.cli.command_line import _words
from labkit.cli.console import Console
from labkit.errors import out_of_memory
from labkit.jobs.execute import NO_MEMORY, Lost, _outcome

NAMED_CAUSE = OSError("Could not find/load shared object file 'libllvmlite.so'")
NAMED_CAUSE.__cause__ = OSError("libllvmlite.so: failed to map segment from shared object")


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("can't start new thread"),
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
        ImportError("a.so: cannot allocate memory in static TLS block"),
        cv2.error(
            "(-4:Insufficient memory) Failed to allocate 99 bytes in OutOfMemoryError"
        ),
        NAMED_CAUSE,
    ],
    ids=str,
)
def test_each_librarys_refusal_of_memory_is_one_line(error: Exception) -> None:
    assert out_of_memory(error)
    words, status = _words(error, Console())
    assert words == "there is not enough memory; close other programs"
    assert status == 1

    def failing(task: int) -> int:
        raise error

    assert _outcome(failing, 1) == Lost(NO_MEMORY, again=True)


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "full"), RuntimeError("no"), KeyError(1)]
)
def test_other_errors_are_no_lack_of_memory(error: Exception) -> None:
    assert not out_of_memory(error)


def test_a_shell_that_limits_memory_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = (900_000 * 1024, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda what: limits)
    words, _ = _words(MemoryError(), Console())
    assert words.endswith(
        "not enough memory; this shell allows 878 MiB (ulimit -v): allow more"
    )
