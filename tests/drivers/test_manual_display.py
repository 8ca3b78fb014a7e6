"""A target on paper: whoever is at the bench is asked for the sheet that is wanted, once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import shown_picture
from labkit.devices.context import DeviceContext, Glass
from labkit.devices.operator import Operator, Wants
from labkit.devices.protocols import PanelInfo, Picture
from labkit.devices.registry import open_devices, open_display
from labkit.drivers.manual_display import SHEET, TARGET_REQUEST, ManualDisplay
from labkit.errors import DeviceError, PlanError
from labkit.panel.panels import paper_panel
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.target.target import open_target
from tests.plans import SMALL, plan_text, simulated


def test_each_sheet_is_asked_for_once_and_black_for_none() -> None:
    asked: list[str] = []
    seen: list[Picture] = []
    glass, target = Glass(), np.zeros((4, 4), np.uint8)
    glass.watched_by(seen.append)
    display = ManualDisplay(asked.append, PanelInfo((8, 8), 0.1), glass)
    for picture in ("black", "white", "white", target, target, "white"):
        display.show(picture)
    assert asked == [SHEET, TARGET_REQUEST, SHEET]
    assert [p if isinstance(p, str) else "target" for p in seen] == [
        "black",
        "white",
        "white",
        "target",
        "target",
        "white",
    ]


def test_a_request_that_nobody_answers_is_put_again() -> None:
    answers = iter([DeviceError("nobody"), None])

    def ask(text: str) -> None:
        if (error := next(answers)) is not None:
            raise error

    display = ManualDisplay(ask, PanelInfo((8, 8), 0.1), Glass())
    with pytest.raises(DeviceError):
        display.show("white")
    display.show("white")
    assert next(answers, "none left") == "none left"


@pytest.mark.parametrize(
    "target",
    [
        {"kind": "sierpinski", "order": 4, "size_mm": 15.61},
        {"kind": "slanted_edge", "size_mm": 33.3},
    ],
)
def test_a_target_on_paper_has_the_size_that_the_plan_states(
    target: dict[str, object],
) -> None:
    plan = Plan.parse(plan_text({**SMALL, "target": target}), Path())
    display = open_display("manual:", plan, DeviceContext())
    assert shown_picture(plan, display).size_mm == open_target(plan.target).size_mm
    panel = paper_panel(open_target(plan.target))
    assert min(panel.size_mm) >= 3 * plan.target.size_mm * 0.999


def test_an_address_with_more_in_it_is_refused() -> None:
    with pytest.raises(
        PlanError, match=r'display.address = "manual:here": allowed is manual:'
    ):
        open_display("manual:here", Plan.parse(plan_text(SMALL), Path()), DeviceContext())


class Hand(Operator):
    """Does at once what is asked, and notes it."""

    present = True

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[str] = []

    def ask(self, text: str, wants: Wants = "number") -> str:
        self.asked.append(text)
        return ""


@pytest.mark.parametrize(
    "display", [None, {"address": "manual:", "pixel_pitch_mm": None, "pixels": None}]
)
def test_a_paper_target_is_captured_before_a_simulated_camera(
    display: dict[str, object] | None, tmp_path: Path
) -> None:
    tables = dict(simulated([2000], 1950.0, "simulated:seed=7"))
    few = {"camera": {"frames_per_range": 1, "flats_per_range": 1, "darks": 0}}
    text = plan_text(
        SMALL, tables, few, *([] if display is None else [{"display": display}])
    )
    (tmp_path / "plan.toml").write_text(text if display else text.partition("[display]")[0])
    hand = Hand()
    plan = Plan.load(tmp_path / "plan.toml")
    context = DeviceContext(operator=hand)
    with (
        begin(plan, tmp_path / "s", resume=False) as session,
        open_devices(plan, context=context) as devices,
    ):
        run_plan(session, devices)
    # the preflight wants both, and finds the target; then the flat, and the target
    assert hand.asked == [SHEET, TARGET_REQUEST, SHEET, TARGET_REQUEST]
    assert [frame.kind for frame in Session.open(tmp_path / "s").frames] == [
        "flat",
        "target",
    ]
