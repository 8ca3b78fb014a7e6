"""Groups of the command line, its global options, and arguments and contexts that several commands share."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from labkit.cli.console import Console, print_line
from labkit.errors import DataError, InputError, PlanError
from labkit.session.journal import journal_in
from labkit.version import __version__

if TYPE_CHECKING:
    from labkit.jobs.execute import Run
    from labkit.plan import Plan


# What a command needs is imported inside it: `labkit --help` and tab completion must not wait for SciPy.

app = typer.Typer(
    help="Measure a camera's optics from photographs of a known target.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
target_app = typer.Typer(help="Targets to print or to show.", no_args_is_help=True)
app.add_typer(target_app, name="target")
camera_app = typer.Typer(help="The camera by itself.", no_args_is_help=True)
app.add_typer(camera_app, name="camera")
rail_app = typer.Typer(help="The rail by itself.", no_args_is_help=True)
app.add_typer(rail_app, name="rail")
catalogue_app = typer.Typer(help="The catalogue of sessions.", no_args_is_help=True)
app.add_typer(catalogue_app, name="catalogue")


class _SessionFirst(TyperGroup):
    """A group that takes a session in place of a command, and then runs its command `show`, if it has one."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        known = not args or args[0] in self.commands
        words = args if known or "show" not in self.commands else ["show", *args]
        return super().resolve_command(ctx, words)


field_app = typer.Typer(
    help="The wavefront over the frame.", no_args_is_help=True, cls=_SessionFirst
)
app.add_typer(field_app, name="field")

CameraPlace = Annotated[
    str,
    typer.Argument(
        metavar="[PLAN.toml | ADDRESS]",
        help="A plan, or a camera's address.",
    ),
]
PlanPath = Annotated[
    Path,
    typer.Argument(
        metavar="PLAN.toml",
        help="The plan: what to do, and with what.",
    ),
]
SessionPath = Annotated[
    Path,
    typer.Argument(metavar="SESSION", help="The session's folder."),
]


def _version(asked: bool) -> None:
    if asked:
        print_line(f"labkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    ctx: typer.Context,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show where in the code an error arose.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print the answer as JSON, nothing else.")
    ] = False,
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Accept the options of every command, which may also follow the command."""
    ctx.obj.debug = debug
    ctx.obj.quiet = quiet
    ctx.obj.json = json


def studies(incomplete: str) -> list[str]:
    """Return the names of studies."""
    from labkit.experiments.studies import STUDIES

    return _begin(incomplete, STUDIES)


def panels(incomplete: str) -> list[str]:
    """Return the names of known panels."""
    from labkit.panel.panels import PANELS

    return _begin(incomplete, PANELS)


def targets(incomplete: str) -> list[str]:
    """Return kinds of target, and plans in the folder."""
    from importlib.metadata import entry_points

    kinds = (f"{entry.name}:" for entry in entry_points(group="labkit.targets"))
    return _begin(incomplete, [*kinds, *map(str, Path().glob("*.toml"))])


def channels(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the channels of the session on the command line; the usual ones without a session."""
    from labkit.plan.text import read_tables, read_text

    session = ctx.params.get("session") or next(
        iter(ctx.args), ""
    )  # a line that is not complete has it left over
    try:
        plan = read_tables(read_text(Path(session) / "plan.toml", follow_link=False))
        names = [str(channel["name"]) for channel in plan["channel"]]
    except (KeyError, TypeError, ValueError, PlanError):
        names = ["R", "G", "B"]
    return _begin(incomplete, names)


def _begin(incomplete: str, words: Iterable[str]) -> list[str]:
    # shells print words as they are, and those of files are anybody's
    return sorted(
        word for word in words if word.startswith(incomplete) and word.isprintable()
    )


NO_SUCH_FILE = os.strerror(errno.ENOENT)


def a_session(path: Path) -> None:
    """Raise SessionError for a path other than a session folder."""
    journal_in(path)


def a_plan(*paths: Path | None) -> None:
    """Raise PlanError for a missing plan; ignore None."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise PlanError(f"plan {path}: {NO_SUCH_FILE}")


def perhaps_a_plan(given: str) -> None:
    """Raise PlanError for a missing plan; ignore arguments that do not end in .toml."""
    if given.endswith(".toml"):
        a_plan(Path(given))


def a_file(*paths: Path | None) -> None:
    """Raise InputError for a missing file; ignore None."""
    for path in filter(None, paths):
        if not _is_there(path):
            raise InputError(f"{path}: {NO_SUCH_FILE}")


def a_file_or_plan(*paths: Path) -> None:
    """Raise InputError for a missing file, PlanError for a missing plan."""
    for path in paths:
        perhaps_a_plan(str(path))
        a_file(path)


def photographs_and_plan(paths: Sequence[Path], command: str) -> tuple[list[Path], Plan]:
    """Return photographs and the plan behind them. Raises InputError, PlanError, or DataError for a single path."""
    a_file_or_plan(*paths)
    from labkit.plan import Plan

    if len(paths) < 2:
        raise DataError(
            f"give one photograph or more, and behind them their plan: labkit {command} IMAGE PLAN.toml"
        )
    *photographs, plan_path = paths
    return photographs, Plan.load(plan_path)


def a_file_or_session(*paths: Path | None) -> None:
    """Raise SessionError for a missing session, InputError for a missing file, whose name has a suffix."""
    for path in filter(None, paths):
        if path.suffix:
            a_file(path)
        elif not _is_there(path):
            a_session(path)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that no file can have: its reader says why
        return True


Channels = Annotated[
    list[str] | None,
    typer.Option(
        "--channel", metavar="NAME", help="Only this; may be repeated.", show_default="all"
    ),
]
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
    from labkit.jobs.cluster import on_dask

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
