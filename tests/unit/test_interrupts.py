"""Signals at moments that matter: while commands are imported, and on the way out after an interrupt."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

AT_IMPORT = """
import signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == {name!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Finder())
from labkit.cli import main
main()
"""

MORE_ON_THE_WAY_OUT = """
import atexit, signal
def more():
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.raise_signal(number)
from labkit.cli import main
atexit.register(more)
main()
"""


@pytest.mark.parametrize("name", ["typer", "labkit.cli.sessions", "labkit.session.verify"])
def test_ctrl_c_while_something_is_imported_is_an_interrupt_as_any_other(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "journal.jsonl").touch()
    done = subprocess.run(
        [sys.executable, "-c", AT_IMPORT.format(name=name), "verify", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (done.returncode, done.stderr) == (130, "labkit: interrupted\n")


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_more_signals_on_the_way_out_change_nothing(
    first: signal.Signals, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", MORE_ON_THE_WAY_OUT, "plan", "--interactive"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as running:
        assert running.stderr is not None
        assert b"yes or no" in os.read(running.stderr.fileno(), 4096)
        running.send_signal(first)
        last = running.stderr.read().splitlines()[-1]
        assert running.wait(100) == 130
    assert last.startswith(b"labkit: interrupted")
    assert last.endswith(b"; nothing was written")
