"""For every test: Ctrl-C that works wherever the tests were started, and raw files of cameras labkit has never met."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

from tests import dng

# on a loaded machine an example may take any time; pytest's own limit ends what hangs
settings.register_profile("labkit", deadline=None)
settings.load_profile("labkit")

WriteDng = Callable[..., Path]


def pytest_configure() -> None:
    """What a shell starts in the background ignores SIGINT and SIGQUIT, what nohup starts SIGHUP: so would every program that
    a test starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGQUIT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


LONGEST = "tests/system/test_golden.py"
"""The file whose tests begin first. Each of its sessions may go to another process: nothing else is shared there."""

TWO_WORKERS = ("tests/system/test_plain_session.py", "tests/system/test_refit.py")
"""Files with fits in two processes; one process of the tests runs them, one after the other."""


class Scheduling(LoadFileScheduling):  # type: ignore[misc]
    """A file stays with one process, but for the exceptions above."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if file in TWO_WORKERS:
            return "two workers"
        return file + nodeid.partition("[")[2] if file == LONGEST else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Scheduling | None:
    return Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


ACCURACY = {
    f"tests/system/test_{name}.py"
    for name in (
        *("golden", "golden_field", "golden_small", "vignetted_field", "strong_session"),
        *("weak_modes", "dim_session", "split_session", "panel_session", "lone_range"),
        *("processed_session", "real_disks", "large_target", "whole_frames"),
    )
}
"""Files of whole sessions and of pixels whose optimum is known. `make accuracy` runs them where the numerics changed."""

ALWAYS = "golden_bench"
"""The one session of these that every run of the tests fits."""

SOAK = {f"tests/system/test_{name}.py" for name in ("soak", "studies")}
"""Files that run long to find what only time shows, and the thesis's studies."""


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        file = item.nodeid.partition("::")[0]
        if file in ACCURACY and ALWAYS not in item.nodeid:
            item.add_marker("accuracy")
        elif file in SOAK:
            item.add_marker("soak")
    items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))


@pytest.fixture(scope="session", autouse=True)
def own_state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Nothing is kept in the home of whoever runs the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk() -> Iterator[None]:
    """Files are written whole, and wait for no disk: no test cuts the power, and a killed process loses nothing of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)
        yield


@pytest.fixture(autouse=True)
def no_lines_of_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a loaded machine a command may take longer than ten seconds: what it says on stderr is the same all the same."""
    monkeypatch.setattr("labkit.cli.console.EVERY_S", 3600.0)


@pytest.fixture
def write_dng() -> WriteDng:
    """Writes counts (rows, cols) as a DNG with any filter phase, levels and orientation flag."""
    return dng.write_dng
