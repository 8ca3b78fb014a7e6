"""Results are read and reported by results and optics alone: what estimates and photographs need stays unloaded."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from labkit.session.session import Session
from tests.results_samples import PLAN, some_results

HEAVY = {"numba", "rawpy", "cv2", "serial", "usb", "starlette"}
ESTIMATE = {
    "labkit.analysis",
    "labkit.calibration",
    "labkit.estimation",
    "labkit.finder",
}
FORWARD_MODEL = {"labkit.imaging.model", "labkit.imaging.blur", "labkit.imaging.scene"}
"""Of imaging a report needs what camera parts are called, and no pictures."""

MOST_OF_A_REPORT = 96
"""Number of labkit's modules that a report of results loads without a photograph at hand: 96, four of them rooms."""

SEARCH = {
    "labkit.estimation.local",
    "labkit.estimation.session",
    "labkit.estimation.small_problem",
    "labkit.estimation.starts",
}

PROGRAM = """
import json, sys
{statements}
print()
print(json.dumps(sorted(sys.modules)))
"""


def loaded_by(statements: str) -> set[str]:
    """Names of all modules that a Python loads that runs these statements alone."""
    program = PROGRAM.format(statements=statements)
    ran = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return set(json.loads(ran.stdout.splitlines()[-1]))


def unneeded(modules: set[str]) -> set[str]:
    rooms = {".".join(name.split(".")[:2]) for name in modules}
    return rooms & (HEAVY | ESTIMATE) | modules & FORWARD_MODEL


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session without photographs, with results."""
    folder = tmp_path / "night"
    Session.create(folder, PLAN.to_toml(), tmp_path).close()
    some_results().write(folder / "results" / "latest")
    return folder


@pytest.mark.parametrize(
    "module",
    [
        "labkit.report.html",
        "labkit.results",
        "labkit.session.session",
        "labkit.photographs.decoding",
    ],
)
def test_an_import_loads_no_device_no_decoder_and_no_estimate(module: str) -> None:
    modules = loaded_by(f"import {module}")
    assert module in modules
    assert unneeded(modules) == set()


def test_results_are_loaded_by_results_and_optics(session: Path) -> None:
    modules = loaded_by(
        f"import labkit; labkit.Results.load({str(session)!r})[3000, 'R'].strehl"
    )
    assert "labkit.optics.strehl" in modules
    assert unneeded(modules) == set()


def test_advice_takes_information_and_no_search() -> None:
    modules = loaded_by("import labkit; labkit.advise")
    assert "labkit.estimation.identifiability" in modules
    assert modules & (SEARCH | {"rawpy", "labkit.calibration", "labkit.finder"}) == set()


@pytest.mark.slow
def test_a_report_is_written_by_results_and_optics(session: Path) -> None:
    run = f"from labkit.cli import run; assert run(['report', {str(session)!r}]) == 0"
    modules = loaded_by(run)
    assert unneeded(modules) == set()
    assert (session / "results" / "latest" / "report.html").exists()
    ours = {name for name in modules if name.partition(".")[0] == "labkit"}
    assert len(ours) <= MOST_OF_A_REPORT, sorted(ours)


MISTYPED = [
    ["fit", "nosuch"],
    ["fit", ".", "--plan", "nosuch.toml"],
    ["report", "nosuch"],
    ["verify", "nosuch"],
    ["import", "nosuch.csv", "nosuch.toml", "new"],
    ["plan", "nosuch.jpg"],
    ["advise", "nosuch.toml"],
    ["capture", "nosuch.toml", "new"],
    ["edges", "nosuch.dng", "nosuch.toml"],
    ["restore", "nosuch"],
    ["restore", "nosuch.dng", "--psf", "nosuch"],
    ["camera", "test", "nosuch.toml"],
    ["camera", "focus", "nosuch.toml"],
    ["camera", "tone", "nosuch.jpg"],
    ["rail", "calibrate", "nosuch.toml"],
    ["target", "render", "nosuch.toml", "a.png"],
    ["target", "serve", "nosuch.toml"],
]
SLOW_TO_LOAD = {
    "cv2",
    "matplotlib",
    "numba",
    "numpy",
    "rawpy",
    "rich",
    "scipy",
    "segno",
}


@pytest.mark.parametrize("command", MISTYPED, ids=" ".join)
def test_a_mistyped_path_is_named_before_anything_slow_is_loaded(
    command: list[str],
) -> None:
    modules = loaded_by(f"from labkit.cli import run; assert run({command}) == 2")
    assert "labkit.cli.command_line" in modules
    assert {name.partition(".")[0] for name in modules} & SLOW_TO_LOAD == set()
