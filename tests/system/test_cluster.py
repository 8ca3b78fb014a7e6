"""Tasks on a Dask cluster of this machine, started as a user would; workers and scheduler are killed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from math import factorial
from pathlib import Path

import pytest

from labkit.cli import run
from labkit.errors import InputError, WorkersError
from labkit.jobs import cluster
from labkit.jobs.cluster import on_dask

pytestmark = pytest.mark.slow


class Cluster:
    """A scheduler, and workers with one thread each."""

    def __init__(self, running: ExitStack, folder: Path, path: Path | None = None) -> None:
        """path: where Python finds labkit first."""
        self._running = running
        self._folder = folder
        self._path = path or Path(__file__).parents[2]
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        place = ["--host", "127.0.0.1", "--port", str(port)]
        self.scheduler = self._started("dask_scheduler", *place)
        self.workers = [self.with_worker() for _ in range(2)]

    def with_worker(self) -> subprocess.Popen[bytes]:
        local = ["--no-nanny", "--nthreads", "1", "--local-directory", str(self._folder)]
        return self._started("dask_worker", self.address, *local)

    def _started(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        words = [sys.executable, "-m", f"distributed.cli.{command}", *arguments]
        started = subprocess.Popen(
            [*words, "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self._folder,
            env={**os.environ, "PYTHONPATH": str(self._path)},
        )
        self._running.callback(started.wait, 60)
        self._running.callback(started.kill)
        return started


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Cluster]:
    with ExitStack() as running:
        yield Cluster(running, tmp_path)


def kill_at_first(task: tuple[Path, int]) -> int:
    """The worker is killed at number 3, the first time."""
    tried, number = task
    if number == 3 and not tried.exists():
        tried.touch()
        os._exit(1)
    return number


def connect_until_refused(address: str) -> None:
    """Connect again and again, for the first times before the workers are there."""
    while True:
        with on_dask(address):
            time.sleep(0.5)


def always_kill(number: int) -> int:
    """Every worker is killed that gets number 1."""
    if number == 1:
        os._exit(1)
    return number


def test_a_killed_worker_costs_its_tasks_and_a_lost_scheduler_ends_all(
    dask: Cluster, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with on_dask(dask.address) as mapped:
        assert sorted(mapped(factorial, range(5))) == [(k, factorial(k)) for k in range(5)]
        tasks = [(tmp_path / "tried", k) for k in range(8)]
        assert sorted(mapped(kill_at_first, tasks)) == [(k, k) for k in range(8)]
        results = mapped(time.sleep, [0, 3600])
        assert next(results)[0] == 0
        dask.scheduler.kill()
        began = time.monotonic()
        with pytest.raises(WorkersError, match="is gone; start it and fit again"):
            next(results)
        assert time.monotonic() - began < cluster.CONNECT_S
        while mapped.at_once > 1:  # until the client gives the scheduler up
            assert time.monotonic() - began < 10 * cluster.CONNECT_S
            time.sleep(0.1)
        with pytest.raises(WorkersError, match="is gone; start it and fit again"):
            next(mapped(factorial, range(5)))
    assert "distributed" not in capfd.readouterr().err


def test_a_cluster_without_workers_is_named_after_a_while(
    dask: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "NO_WORKERS_S", 1)
    with on_dask(dask.address) as mapped:
        results = mapped(time.sleep, [0, 3600])
        assert next(results)[0] == 0
        for worker in dask.workers:
            worker.kill()
        with pytest.raises(WorkersError, match="has been without workers for 1 s"):
            next(results)


def test_no_scheduler_or_address_is_named_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        assert run(["reprocess", str(tmp_path), "--dask", address]) == 1
    assert capsys.readouterr().err.startswith(
        f"labkit: no Dask scheduler answers at {address} within 1 s: start one"
    )
    with (
        pytest.raises(InputError, match=r"--dask here: give an address such as tcp://"),
        on_dask("here"),
    ):
        pass


@pytest.mark.parametrize(
    ("numerics", "words"),
    [
        ("def versions(): return {'labkit': '0.0.1'}", "has labkit 0.0.1, not "),
        ("", "has no labkit that can be asked .*: install the same versions"),
    ],
    ids=["other", "none"],
)
def test_a_worker_of_another_labkit_is_named_in_labkits_line_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], numerics: str, words: str
) -> None:
    """A task that such a worker cannot read ends the worker, which looked like a cluster without workers."""
    (tmp_path / "labkit").mkdir()
    (tmp_path / "labkit" / "__init__.py").touch()
    (tmp_path / "labkit" / "numerics.py").write_text(numerics)
    with ExitStack() as running:
        dask = Cluster(running, tmp_path, path=tmp_path)
        with pytest.raises(WorkersError, match=words):
            connect_until_refused(dask.address)
    assert capfd.readouterr().err == ""
