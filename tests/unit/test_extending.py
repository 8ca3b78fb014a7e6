"""The driver and the target that the documentation shows, installed and used as they stand."""

from __future__ import annotations

import os
import re
import sys
import threading
import tomllib
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from labkit.cli import run
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_rail
from labkit.errors import DeviceTimeoutError, RailError, RailLimitError, TargetError
from labkit.plan import Plan
from labkit.target.target import open_target
from tests.plans import SMALL, plan_text

PAGES = Path(__file__).parents[2] / "docs" / "extend"
PLAN = Plan.parse(plan_text(SMALL))


def install(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a page's files where Python finds them, with the entry points that its pyproject.toml states."""
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    files = dict(
        re.findall(r"```\{code-block\} \w+\n:caption: (\S+)\n(.*?)```", text, re.DOTALL)
    )
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    for name, content in files.items():
        (folder / name).write_text(content)
    about = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Name: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = [
        f"[{group}]\n{k} = {v}\n"
        for group, entries in project["entry-points"].items()
        for k, v in entries.items()
    ]
    (about / "entry_points.txt").write_text("".join(lines))
    monkeypatch.syspath_prepend(folder)
    for name in files:
        monkeypatch.delitem(sys.modules, Path(name).stem, raising=False)


@contextmanager
def controller(refused: str = "") -> Iterator[str]:
    """The port of a controller as the page describes it; it moves at once."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    at = 37.0

    def serve() -> None:
        nonlocal at
        with os.fdopen(ours, "rb", buffering=0) as commands:
            while line := commands.readline().decode().strip():
                word, _, value = line.partition(" ")
                at = float(value) if word == "GO" else 0.0 if word == "HOME" else at
                os.write(
                    ours,
                    f"ERROR {refused}\n".encode() if refused else f"AT {at:.3f}\n".encode(),
                )

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        os.write(theirs, b"\n")
        thread.join(timeout=5)
        os.close(theirs)


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install("driver", tmp_path, monkeypatch)


@pytest.mark.usefixtures("acme")
def test_the_rail_of_the_page_moves_where_it_is_sent() -> None:
    with controller() as port, open_rail(f"acme:{port}", PLAN, DeviceContext()) as rail:
        rail.home()
        assert rail.move_to(12.3456) == 12.346
        with pytest.raises(RailLimitError, match=r"600\.000 mm is outside 0\.\.500 mm"):
            rail.move_to(600.0)


@pytest.mark.usefixtures("acme")
def test_the_rail_of_the_page_reports_a_refusal_and_a_missing_port() -> None:
    with (
        controller(refused="door open") as port,
        open_rail(f"acme:{port}", PLAN, DeviceContext()) as rail,
        pytest.raises(RailError, match="refused HOME: door open"),
    ):
        rail.home()
    with pytest.raises(RailError, match="cannot open /dev/nowhere"):
        open_rail("acme:/dev/nowhere", PLAN, DeviceContext())


@pytest.mark.usefixtures("acme")
def test_the_rail_of_the_page_does_not_wait_for_ever() -> None:
    from acme_rail import AcmeRail  # type: ignore[import-not-found]

    ours, theirs = os.openpty()
    with (
        AcmeRail(os.ttyname(theirs), reply_s=0.05) as rail,
        pytest.raises(DeviceTimeoutError, match="does not answer"),
    ):
        rail.home()
    os.close(ours)
    os.close(theirs)


def test_the_target_of_the_page_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install("target", tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    command, shown = re.findall(
        r"\$ labkit (.*)\n(.*)\n", (PAGES / "target.md").read_text(encoding="utf-8")
    )[0]
    assert run(command.split()) == 0
    assert shown in capsys.readouterr().out
    dots = np.asarray(Image.open("hadamard.png"))[5::10, 5::10] > 127
    signs = np.where(dots, 1, -1)
    assert np.array_equal(signs @ signs.T, 64 * np.eye(64))  # what a Hadamard matrix is
    with pytest.raises(TargetError, match="not 12"):
        open_target("hadamard:cells=12,size_mm=50")
