"""The command line: wiring only. Exit status 0 done, 1 failed, 2 wrong usage or bad input, 130 interrupted."""

from __future__ import annotations

import sys
from collections.abc import Sequence

# Commands are imported when one runs: a Ctrl-C meanwhile is an interrupt as any other, and not a traceback of an import.


def main() -> None:
    """Run the command line and leave with its exit status."""
    try:
        from labkit.cli.command_line import main as run_and_leave

        run_and_leave()
    except KeyboardInterrupt:
        print("labkit: interrupted", file=sys.stderr)
        sys.exit(130)


def run(args: Sequence[str]) -> int:
    """Run a command line; returns the exit status. --debug, --quiet and --json may stand anywhere before a "--"."""
    from labkit.cli.command_line import run as run_line

    return run_line(args)
