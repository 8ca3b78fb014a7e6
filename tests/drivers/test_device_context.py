"""Opening and closing devices changes nothing of the context that their caller made."""

from __future__ import annotations

import time
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import pytest

from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices, open_monitor
from labkit.plan import Plan
from tests.plans import SMALL, plan_text, simulated

WEB = "web://127.0.0.1:0"


def plan(rail: str = "simulated:", display: str = "simulated:") -> Plan:
    places: dict[str, Any] = {
        "rail": {"address": rail, "microstep_um": 0.5},
        "display": {"address": display},
    }
    return Plan.parse(plan_text(SMALL, simulated([2000, 2050], 1950.0), places), Path())


def held(context: DeviceContext) -> tuple[Any, ...]:
    """Everything that a context holds, by value where it can be held twice."""
    values = {field.name: getattr(context, field.name) for field in fields(context)}
    return (
        values,
        context.shared.items(),
        context.operator.present,
        context.operator.question,
        context.requests.qsize(),
    )


@pytest.fixture(autouse=True)
def token_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.mark.parametrize(
    "rail", ["simulated:", "grbl:simulated", "zaber:simulated", "manual:"]
)
@pytest.mark.parametrize("display", ["simulated:", WEB])
def test_opening_and_closing_devices_leaves_the_context_as_it_was(
    rail: str, display: str
) -> None:
    context = DeviceContext()
    before = held(context)
    with open_devices(plan(rail, display), context=context):
        assert held(context)[0] == before[0]
        assert len(context.shared.values()) == (2 if display == WEB else 1)
    assert held(context) == before


def test_a_monitor_leaves_the_context_as_it_was() -> None:
    context = DeviceContext()
    before = held(context)
    with (
        open_monitor(WEB, plan(), context) as page,
        open_devices(plan(), context=replace(context, observers=(page,))) as bench,
    ):
        assert list(bench.observers) == [page]
        assert context.observers == ()
    assert held(context) == before


def test_a_context_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        DeviceContext().warn = print  # type: ignore[misc]


def test_a_monitor_and_a_web_display_of_one_address_are_one_observer() -> None:
    context = DeviceContext()
    with open_monitor(WEB, plan(display=WEB), context) as page:
        with open_devices(
            plan(display=WEB), context=replace(context, observers=(page,))
        ) as bench:
            assert list(bench.observers) == [page]
        assert context.operator.present  # the monitor's page is still there
    assert not context.operator.present


def test_a_bench_with_a_simulated_device_waits_in_its_time() -> None:
    with open_devices(plan(rail="manual:")) as bench:
        began_s = time.monotonic()
        bench.wait(3600.0)
        assert time.monotonic() - began_s < 60
