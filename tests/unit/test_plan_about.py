"""What a plan says of a measurement for the report: short lines of text, all of them optional."""

from __future__ import annotations

import pytest

from labkit.errors import PlanError
from labkit.plan import About, Plan
from tests.plans import PORTRAIT, plan_text

LEAST = plan_text(PORTRAIT)


def parse(text: str) -> Plan:
    return Plan.parse(text, "/nowhere")


def refusal(more: str) -> str:
    """The message for a plan with something more in it."""
    with pytest.raises(PlanError) as caught:
        parse(LEAST + more)
    return str(caught.value)


def test_what_the_report_says_of_a_measurement_is_optional() -> None:
    about = parse(LEAST + '[about]\ntitle = "Repair 17"\noperator = "A"\n').about
    assert (about.title, about.operator) == ("Repair 17", "A")
    assert parse(LEAST).about == About()
    assert set(About().model_dump().values()) == {None}


def test_a_plan_names_lens_and_body() -> None:
    plan = parse(LEAST + '[camera]\nbody = "Z 8"\n').replace(lens={"serial": "0042"})
    assert plan.lens.serial == "0042"
    assert plan.camera is not None
    assert plan.camera.body == "Z 8"
    assert plan.capture_camera is None


def test_a_camera_without_an_address_names_its_body_alone() -> None:
    words = (
        "camera.address is missing: allowed is body alone, or both of address, exposure_s"
    )
    assert words in refusal('[camera]\nbody = "Z 8"\niso = 100\n')
    assert words in refusal("[camera]\n")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (f'title = "{"x" * 81}"', "about.title = 'xxx"),
        (f'note = "{"x" * 201}"', "printable text of 1 to 200 characters"),
        ('title = ""', "about.title = '': allowed is printable text of 1 to 80 characters"),
        ('operator = " "', "about.operator = ' '"),
        ('note = "a\\nb"', "on one line"),
        ("operator = 42", "about.operator = 42"),
        ('name = "x"', "about.name is no known key"),
    ],
)
def test_what_the_report_says_is_short_and_printable(given: str, words: str) -> None:
    assert words in refusal(f"[about]\n{given}\n")
