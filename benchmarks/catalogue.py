"""How fast the catalogue is: `python -m benchmarks.catalogue SESSION`, a fitted session, copied a thousand times."""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

SESSIONS = 1000
PROGRAM = "from labkit.cli import main; main()"


def copies(session: Path, folder: Path) -> None:
    """Make the copies: journal, plan, results, and links to the photographs."""
    for number in range(SESSIONS):
        copy = folder / f"session-{number:04d}"
        (copy / "results" / "latest").mkdir(parents=True)
        for name in ("plan.toml", "journal.jsonl", "results/latest/results.json"):
            shutil.copyfile(session / name, copy / name)
        if (session / "frames").is_dir():
            (copy / "frames").mkdir()
            for frame in (session / "frames").iterdir():
                os.link(frame, copy / "frames" / frame.name)


def timed(*words: str) -> None:
    """Run a command; print its time by the clock and of the processor."""
    began = perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", PROGRAM, *words, "--json"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    print(
        f"{' '.join(words[:2]):40s} {perf_counter() - began:6.2f} s, processor {processor:6.2f} s",
        flush=True,
    )


def main() -> None:
    """Print the time of each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", type=Path)
    session = parser.parse_args().session.absolute()
    with tempfile.TemporaryDirectory(dir=session.parent) as base:
        folder = Path(base)
        copies(session, folder)
        os.chdir(folder)
        timed("catalogue", "rebuild")
        timed("list")
        timed("history", "--lens", "Apo", "--channel", "G")
        timed("compare", "session-0000", "session-0001")
        timed("compare", "session-0000", "session-0001", "--out", "maps")


if __name__ == "__main__":
    main()
