"""Tasks on an existing Dask cluster, through distributed's own executor: the only module that knows Dask."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from labkit.errors import InputError, WorkersError, shown
from labkit.jobs.execute import Executed
from labkit.numerics import SAME_VERSIONS, other_versions, versions

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10
"""For which a scheduler may leave a call without an answer."""

VERSIONS = "__import__('labkit.numerics', fromlist=['versions']).versions()"
"""What a worker is asked in Python's own words, for a function of this labkit may be none of the worker's."""

NO_WORKERS_S = 30
"""For which a cluster may be without workers, as while it starts them."""


@contextmanager
def on_dask(address: str) -> Iterator[Executed]:
    """Yield a run over the workers of a Dask cluster.

    A worker that is lost costs only its tasks, which the scheduler gives to others. While
    tasks are under way, a lost scheduler is reported within seconds, and a cluster without
    workers within half a minute.

    Parameters
    ----------
    address : of the scheduler, such as ``tcp://10.0.0.5:8786``

    Raises
    ------
    InputError : `address` is none, or the package distributed is not installed
    WorkersError : no scheduler answers, it has no workers, or a worker has other versions than this process

    >>> with on_dask("tcp://10.0.0.5:8786") as run:
    ...     results = labkit.fit("night-3", run=run)
    """
    if not re.fullmatch(r"[a-z]+://\S+", address):
        raise InputError(f"--dask {address}: give an address such as tcp://10.0.0.5:8786")
    try:
        import dask
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise InputError(
            "--dask needs the package distributed: pip install 'labkit[cluster]'"
        ) from error
    _silence()
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"}):
        try:
            client = Client(  # type: ignore[no-untyped-call]
                address, timeout=CONNECT_S, set_as_default=False
            )
        except (OSError, TypeError, ValueError) as error:
            raise WorkersError(
                f"no Dask scheduler answers at {address} within {CONNECT_S} s: start one with dask scheduler, "
                "or correct the address, such as tcp://10.0.0.5:8786"
            ) from error
        try:
            cluster = Cluster(client, address)
            cluster.refuse_other_versions()
            executor = client.get_executor(pure=False)  # type: ignore[no-untyped-call]
            yield Executed(executor, cluster.threads, cluster.watch, (KilledWorker,))
        finally:
            client.close(timeout=CONNECT_S)  # type: ignore[no-untyped-call]


def _silence() -> None:
    """Silence the loggers of distributed and of its futures: labkit reports their faults in one line.

    Some have levels of their own, so each is named. A future cancelled after its
    scheduler was lost logs a traceback.
    """
    for name in ("distributed", "distributed.client", "concurrent.futures"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@dataclass
class Cluster:
    """The scheduler and workers of a cluster, as last seen."""

    client: Client
    address: str
    last_workers_s: float = field(default_factory=time.monotonic)

    def threads(self) -> int:
        """Return the number of tasks that the workers run at once; 0 if the scheduler is lost."""
        workers = self.client.scheduler_info(n_workers=-1).get("workers", {})
        return sum(int(worker["nthreads"]) for worker in workers.values())

    def refuse_other_versions(self) -> None:
        """Raise WorkersError if a worker differs in a version: one of another labkit may not even read its tasks, and end."""
        answers: dict[str, Any] = self.client.run(eval, VERSIONS, on_error="return")
        for worker, held in answers.items():
            others = (
                other_versions(held, versions())
                if isinstance(held, dict)
                else f"no labkit that can be asked ({shown(str(held))})"
            )
            if others:
                raise WorkersError(
                    f"the Dask worker {worker} has {others}: {SAME_VERSIONS}"
                )

    def watch(self) -> None:
        """Raise WorkersError if the scheduler is lost, or has been without workers for too long."""
        if self.client.status != "running":
            raise WorkersError(
                f"the Dask scheduler at {self.address} is gone; start it and fit again: that goes on where this one ended"
            )
        now = time.monotonic()
        if self.threads():
            self.last_workers_s = now
        elif now - self.last_workers_s > NO_WORKERS_S:
            raise WorkersError(
                f"the Dask scheduler at {self.address} has been without workers for {NO_WORKERS_S} s: start some with "
                "dask worker, of the same versions as here, and fit again: that goes on where this one ended"
            )
