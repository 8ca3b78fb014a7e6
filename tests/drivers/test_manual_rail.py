"""A rail that a person sets."""

from __future__ import annotations

import pytest

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Rail
from labkit.drivers.manual_rail import ManualRail, open_rail
from labkit.errors import PlanError, RailError
from tests.drivers.test_simulated_devices import plan


def answering(*answers: str) -> tuple[ManualRail, list[str]]:
    asked: list[str] = []
    left = iter(answers)

    def ask(question: str) -> str:
        asked.append(question)
        return next(left)

    return ManualRail(ask), asked


@pytest.mark.parametrize("answer", ["150.3", " 150,3 \n", "150.3 mm", "1.503e2"])
def test_the_position_is_what_the_scale_says(answer: str) -> None:
    rail, asked = answering(answer)
    keeps: Rail = rail
    keeps.home()
    assert keeps.move_to(150.0) == pytest.approx(150.3)
    assert asked == [
        "Set the rail to 150.000 mm, coming from 149.000 mm or less, clamp it, and type what its scale says in mm"
    ]


@pytest.mark.parametrize(
    ("slip", "words"), [("", '"" is no number.'), ("x", '"x" is no number.'), ("15", "15 mm is more than 2 mm away."),
                        ("nan", "nan mm is more than 2 mm away.")]
)  # fmt: skip
def test_a_slip_of_the_keyboard_is_asked_again(slip: str, words: str) -> None:
    rail, asked = answering(slip, "150")
    assert rail.move_to(150.0) == 150
    assert asked[1].startswith(words)


@pytest.mark.parametrize("typed", ["3200", "3203.5"])
def test_a_range_that_is_typed_for_the_scale_is_named_as_one(typed: str) -> None:
    asked: list[str] = []
    answers = iter([typed, "250"])

    def ask(question: str) -> str:
        asked.append(question)
        return next(answers)

    rail = ManualRail(ask, range_mm=lambda position_mm: 2950 + position_mm)
    assert rail.move_to(250.0) == 250
    assert asked[1] == (
        f"{typed} mm is the range to the target, no reading of the rail's scale. {asked[0]}"
    )


def test_a_plan_tells_the_rail_its_ranges(monkeypatch: pytest.MonkeyPatch) -> None:
    context, bench = DeviceContext(), plan()
    assert bench.rail is not None
    position_mm = bench.rail.position_mm(2100.0)
    asked: list[str] = []

    def ask(question: str) -> str:
        asked.append(question)
        return "2100" if len(asked) == 1 else f"{position_mm}"

    monkeypatch.setattr(context.operator, "ask", ask)
    with open_rail("manual:", bench, context) as rail:
        assert rail.move_to(position_mm) == position_mm
    assert asked[1].startswith("2100 mm is the range to the target")


def test_nobody_who_answers_to_the_point_ends_it_with_one_line() -> None:
    rail, _ = answering("?", "", "15")
    with pytest.raises(
        RailError,
        match=r"nobody set the manual rail to 150\.000 mm: 15 mm is more than 2 mm away$",
    ):
        rail.move_to(150.0)


def test_the_operator_of_the_room_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    context = DeviceContext()
    monkeypatch.setattr(
        context.operator, "ask", lambda question: "99.5" if "100.000" in question else ""
    )
    with open_rail("manual:", plan(), context) as rail:
        assert rail.move_to(100.0) == 99.5


def test_an_address_that_says_more_is_refused() -> None:
    with pytest.raises(PlanError, match="allowed is manual:"):
        open_rail("manual:/dev/ttyUSB0", plan(), DeviceContext())
