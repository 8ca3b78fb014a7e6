"""Options and contexts of commands that run many tasks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from labkit.cli.console import Console
from labkit.errors import InputError

if TYPE_CHECKING:
    from labkit.execute import Run

Workers = Annotated[
    int | None,
    typer.Option(
        min=1, metavar="N", help="Processes at once.", show_default="one for each core"
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Fit on the workers of a Dask cluster: its scheduler's address, such as tcp://10.0.0.5:8786.",
        show_default="this machine",
    ),
]
AcceptFailed = Annotated[
    bool,
    typer.Option(
        "--accept-failed", help="Accept results without the fits that failed as done."
    ),
]


@contextmanager
def cluster_or_none(address: str | None, workers: int | None) -> Iterator[Run | None]:
    """Yield a run over the workers of a Dask cluster; None without an address. Raises InputError with --workers."""
    if address is None:
        yield None
        return
    if workers is not None:
        raise InputError(
            "--workers with --dask: the cluster has its own workers; leave out --workers"
        )
    from labkit.cluster import on_dask

    with on_dask(address) as run:
        yield run


@contextmanager
def kept_if_interrupted(console: Console) -> Iterator[None]:
    """State after an interrupt that completed fits are kept."""
    try:
        yield
    except KeyboardInterrupt:
        console.hint = (
            "; fits that are done are kept, and the same command goes on from there"
        )
        raise
