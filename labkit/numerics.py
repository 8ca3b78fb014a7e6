"""Versions that fits depend on: the source of labkit's numerics, and the libraries below them."""

from __future__ import annotations

import hashlib
import os
import platform
import socket
from functools import cache
from importlib import metadata
from pathlib import Path

from labkit.errors import WorkersError
from labkit.version import __version__

LIBRARIES = {
    "NumPy": "numpy",
    "SciPy": "scipy",
    "OpenCV": "opencv-contrib-python-headless",
    "numba": "numba",
}
"""By name, their packages."""

NO_NUMERICS = {
    *("acquisition", "advice", "catalogue", "charts", "cli", "devices", "drivers"),
    *("edges", "experiments", "field", "noise", "report", "restoration"),
    *("demo.py", "jobs"),
}
"""Rooms whose source no fit depends on."""


SAME_VERSIONS = "install the same versions there as here"
"""Advice where a worker differs."""


@cache
def source_digest() -> str:
    """Return the SHA-256 of the source that fits depend on."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for room in sorted(root.iterdir()):  # some rooms are links, which rglob does not follow
        if room.name not in NO_NUMERICS:
            for path in [room, *sorted(room.rglob("*.py"))]:
                digest.update(path.read_bytes() if path.suffix == ".py" else b"")
    return digest.hexdigest()


@cache
def versions() -> dict[str, str]:
    """Return the versions that the numbers of a fit depend on, by name."""
    return {
        "labkit": f"{__version__} of source {source_digest()[:12]}",
        **{name: metadata.version(package) for name, package in LIBRARIES.items()},
        "Python": ".".join(platform.python_version_tuple()[:2]),
    }


def refuse_other_versions(wanted: dict[str, str]) -> None:
    """Raise WorkersError if this process, a worker, differs in a version from the process that sends its tasks."""
    if others := other_versions(versions(), wanted):
        raise WorkersError(
            f"worker {os.getpid()} on {socket.gethostname()} has {others}: {SAME_VERSIONS}"
        )


def other_versions(held: dict[str, str], wanted: dict[str, str]) -> str:
    """Return in words which versions of a worker differ from the wanted ones; empty if none does."""
    return "; ".join(
        f"{name} {held.get(name, 'missing')}, not {version}"
        for name, version in wanted.items()
        if held.get(name) != version
    )
