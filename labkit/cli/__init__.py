"""The command line: wiring only. Exit status 0 done, 1 failed, 2 wrong usage or bad input, 130 interrupted."""

from labkit.cli import bench, edges, focus, restoring, sessions
from labkit.cli.main import main, run

__all__ = ["bench", "edges", "focus", "main", "restoring", "run", "sessions"]
