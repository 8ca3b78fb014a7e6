"""Many sessions as one job: `python -m benchmarks.many_sessions SESSION`, a session that is copied some times.

Two workers are timed against one. The fits' own time is the time by the clock of all searches, in the processes that make
them: `seconds` of each wavefront in the results. Beyond it are the start of the program, raw files, calibration, the search
for the target, signs and errors of the session, PSFs, files, tasks on their way, and workers that wait. Other programs must
not be at work on the machine.

Then the job is killed at random moments and resumed (`--kills`), and workers of a local Dask cluster are killed while it goes
on (`--worker-kills`): the results must be those of the undisturbed job.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

from labkit.results import Results

PROGRAM = (sys.executable, "-c", "from labkit.cli import main; main()")
SCHEDULER = "tcp://127.0.0.1:18786"
LONGEST_S = 1800

KILLED_EVERY_S = 8.0
"""Mean time between kills: a worker that was killed starts again within a few seconds."""


def copies(session: Path, folder: Path, count: int) -> list[Path]:
    """Copy plan, journal and links to the photographs, without results."""
    made = [folder / f"session-{number:02d}" for number in range(count)]
    for copy in made:
        shutil.copytree(
            session, copy, copy_function=os.link, ignore=shutil.ignore_patterns("results")
        )
        for name in ("plan.toml", "journal.jsonl"):  # links would be written through
            (copy / name).unlink()
            shutil.copyfile(session / name, copy / name)
    return made


def command(sessions: Sequence[Path], *options: str) -> list[str]:
    """Return the command line of a job."""
    return [*PROGRAM, "reprocess", *map(str, sessions), *options]


def undisturbed(sessions: Sequence[Path], *options: str) -> float:
    """Fit all sessions; return the seconds by the clock."""
    began = perf_counter()
    subprocess.run(
        command(sessions, *options), check=True, capture_output=True, timeout=LONGEST_S
    )
    return perf_counter() - began


def clear(sessions: Sequence[Path]) -> None:
    """Remove all results, and the fits that are kept of a job under way."""
    for session in sessions:
        shutil.rmtree(session / "results", ignore_errors=True)


def numbers(sessions: Sequence[Path]) -> list[np.ndarray]:
    """Return the wavefronts of each session, waves RMS (fits, modes)."""
    return [
        np.array([wavefront.waves for wavefront in Results.load(session)])
        for session in sessions
    ]


def fitting_s(sessions: Sequence[Path]) -> tuple[int, float]:
    """Return the number of fits and the seconds that they took themselves."""
    seconds = [one.seconds for session in sessions for one in Results.load(session)]
    return len(seconds), sum(seconds)


def compared(sessions: Sequence[Path], right: Sequence[np.ndarray]) -> str:
    """Say how far wavefronts are from the right ones, and what `labkit verify` says."""
    now = numbers(sessions)
    away = max(float(np.abs(one - of).max()) for one, of in zip(now, right, strict=True))
    clean = [
        subprocess.run([*PROGRAM, "verify", str(one)], capture_output=True).returncode == 0
        for one in sessions
    ]
    kept = [path for one in sessions for path in one.rglob("*.part")]
    return f"largest difference {away:.1e} waves, {sum(clean)} of {len(clean)} verified, {len(kept)} unfinished files"


def killed(sessions: Sequence[Path], kills: int, usual_s: float) -> None:
    """Kill the job and all its processes at random moments; each time it goes on where it ended."""
    rng = np.random.default_rng(1)
    done = 0
    while done < kills:
        job = subprocess.Popen(
            command(sessions),
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            job.wait(rng.uniform(0, usual_s / 2))
        except subprocess.TimeoutExpired:
            os.killpg(job.pid, signal.SIGKILL)
            job.wait()
            done += 1
        else:
            clear(sessions)


@contextmanager
def dask(workers: int) -> Iterator[None]:
    """Start a scheduler and workers on this machine as a user would, and end them."""
    program = str(Path(sys.executable).parent / "dask")
    port = SCHEDULER.rpartition(":")[2]
    commands = (
        f"scheduler --host 127.0.0.1 --port {port} --no-dashboard",
        f"worker {SCHEDULER} --nworkers {workers} --nthreads 1 --no-dashboard",
    )
    processes = [
        subprocess.Popen(
            [program, *one.split()],
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for one in commands
    ]
    try:
        sleep(15)
        yield
    finally:
        for process in reversed(processes):
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def worker_processes() -> list[int]:
    """Return the processes that the cluster's nannies started."""
    found = subprocess.run(
        ["pgrep", "-f", "multiprocessing.spawn.*--multiprocessing-fork"],
        capture_output=True,
        text=True,
    )
    return [int(one) for one in found.stdout.split()]


def with_workers_killed(sessions: Sequence[Path], kills: int) -> None:
    """Kill a random worker at random moments while the job runs on the cluster; a job that ended begins again."""
    rng = np.random.default_rng(2)
    done = ended = left_out = 0
    while done < kills:
        job = subprocess.Popen(
            command(sessions, "--dask", SCHEDULER),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        while done < kills and job.poll() is None:
            sleep(rng.uniform(0, 2 * KILLED_EVERY_S))
            if (workers := worker_processes()) and job.poll() is None:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                done += 1
        left_out += job.wait(LONGEST_S) != 0
        ended += 1
        if done < kills:
            clear(sessions)
    print(f"{kills} workers killed in {ended} jobs, of which {left_out} left out fits")


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--copies", type=int, default=5)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--worker-kills", type=int, default=20)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=asked.session.absolute().parent) as base:
        sessions = copies(asked.session.absolute(), Path(base), asked.copies)
        times = {}
        for workers in (1, 2):
            clear(sessions)
            times[workers] = undisturbed(sessions, "--workers", str(workers))
            fits, own_s = fitting_s(sessions)
            beyond = workers * times[workers] / own_s - 1
            print(
                f"{workers} workers: {fits} fits in {times[workers]:.1f} s, "
                f"{100 * beyond:.0f} % beyond the fits' own {own_s:.1f} s",
                flush=True,
            )
        right = numbers(sessions)
        faster = times[1] / times[2]
        print(
            f"two workers are {faster:.2f} times as fast: "
            f"processes and tasks cost {100 * (2 / faster - 1):.0f} %",
            flush=True,
        )
        clear(sessions)
        killed(sessions, asked.kills, times[2])
        undisturbed(sessions)
        print(f"{asked.kills} times killed: {compared(sessions, right)}", flush=True)
        clear(sessions)
        with dask(2):
            with_workers_killed(sessions, asked.worker_kills)
            undisturbed(sessions, "--dask", SCHEDULER)
            print(f"on Dask: {compared(sessions, right)}", flush=True)


if __name__ == "__main__":
    main()
