"""labkit's rail and camera in a real RunEngine, on simulated devices."""

from __future__ import annotations

import ast
import runpy
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rawpy

from labkit.devices.bluesky import ScanRail, Step
from labkit.drivers.grbl.rail import GrblRail
from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL
from labkit.drivers.simulated.controllers.pty_port import LineFault, PtyPort
from labkit.errors import DeviceTimeoutError, RailError

ROOT = Path(__file__).parents[2]

bluesky = pytest.importorskip("bluesky")


@contextmanager
def a_rail(*faults: LineFault, speed: float = 60_000) -> Iterator[tuple[PtyPort, GrblRail]]:
    port = grbl_port(
        GRBL, {24: 60_000, 25: 600_000, 110: speed, 120: 20_000}, faults=faults
    )
    try:
        with GrblRail(port.path, reply_s=0.5) as rail:
            rail.home()
            yield port, rail
    finally:
        port.close()


def test_the_example_scans_through_focus(tmp_path: Path) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "bluesky_scan.py"))
    plan = example["Plan"].parse(example["SIMULATED"], Path())
    found = example["focus_scan"](plan, tmp_path / "scan")
    assert [range_mm for range_mm, _ in found] == pytest.approx(
        [2000, 2025, 2050], abs=0.005
    )
    for _, file in found:
        with rawpy.imread(file) as raw:
            assert raw.raw_image.max() > 700


def test_nothing_of_labkit_imports_bluesky() -> None:
    for path in [
        *ROOT.glob("labkit/**/*.py"),
        *ROOT.glob("drivers/**/*.py"),
        *ROOT.glob("targets/**/*.py"),
    ]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            )
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [
                name for name in names if name.split(".")[0] in ("bluesky", "ophyd")
            ], path


def run_engine(
    plan: Any, hear: Callable[[str, dict[str, Any]], None] = lambda kind, document: None
) -> None:
    bluesky.RunEngine(context_managers=[])(plan, hear)


def test_a_scan_reads_where_the_rail_truly_stands() -> None:
    from bluesky.plans import scan

    documents: list[tuple[str, dict[str, Any]]] = []
    with a_rail() as (_, rail):
        run_engine(
            scan([], ScanRail(rail, settle_s=0.0), -200, -100, 3),
            lambda *said: documents.append(said),
        )
    events = [document["data"] for kind, document in documents if kind == "event"]
    assert [data["rail"] for data in events] == pytest.approx([-200, -150, -100], abs=0.004)
    assert documents[0][0] == "start"
    assert documents[-1][1]["exit_status"] == "success"


def test_a_rail_in_trouble_fails_the_plan_with_its_own_words() -> None:
    from bluesky.plans import scan
    from bluesky.utils import FailedStatus

    with (
        a_rail(LineFault("alarm", r"G53.*", nth=3)) as (_, rail),
        pytest.raises(FailedStatus) as caught,
    ):
        run_engine(scan([], ScanRail(rail, settle_s=0.0), -200, -100, 3))
    assert isinstance(caught.value.__cause__, RailError)
    assert "limit switch" in str(caught.value.__cause__)


def test_a_plan_that_is_aborted_stops_the_rail() -> None:
    import bluesky.plan_stubs as stubs
    from bluesky.preprocessors import run_wrapper

    wrapped: Any = run_wrapper

    with a_rail(speed=1200) as (port, rail):
        scanned = ScanRail(rail, settle_s=0.0)

        def plan() -> Iterator[Any]:
            yield from stubs.abs_set(scanned, -20.0, group="way")
            yield from stubs.sleep(0.3)
            raise RuntimeError("enough")

        with pytest.raises(RuntimeError, match="enough"):
            run_engine(wrapped(plan()))
        with port.lock:
            controller: Any = port.controller
            assert controller.machine.motion is None
            assert controller.machine.carriage_mm(controller.now_s) < -21.0


def test_a_step_tells_its_end_to_all_who_ask() -> None:
    gate, heard = threading.Event(), threading.Event()
    told: list[Step] = []

    def wait() -> None:
        gate.wait(5)

    def hear(over: Step) -> None:
        told.append(over)
        heard.set()

    step = Step(wait, "step")
    step.add_callback(hear)
    assert not step.done
    assert not step.success
    with pytest.raises(DeviceTimeoutError, match="still under way after"):
        step.exception(timeout=0.01)
    gate.set()
    assert step.exception(timeout=5) is None
    step.add_callback(told.append)
    assert step.done
    assert step.success
    assert heard.wait(5)  # told by the step's own thread
    assert told == [step, step]


def test_a_step_that_failed_says_why() -> None:
    def fail() -> None:
        raise RailError("no")

    step = Step(fail, "step")
    assert str(step.exception(timeout=5)) == "no"
    assert not step.success
