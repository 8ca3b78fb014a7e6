"""Plans that nobody writes by hand: refused at once, in one line."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from labkit.errors import PlanError
from labkit.plan import Plan
from tests.plans import PORTRAIT, plan_text

TEXT = plan_text(PORTRAIT)


def refusal(first_line: str) -> str:
    with pytest.raises(PlanError) as caught:
        Plan.parse(f"{first_line}\n{TEXT}")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("a" + 20000 * '."!"', "too deep in one another"),
        ("a" + 20000 * " . '\\'", "too deep in one another"),
        ("a" + 20000 * r'."\""', "too deep in one another"),
        ("a" + 2000 * f'."{"a" * 300}"', "no plan is as long"),
        (670 * ("a." * 63 + f'"{"x" * 257}".') + "a", "too deep in one another"),
        ("a" + 20000 * " . a", "too deep in one another"),
        ("a" + 20000 * '."""."', "too deep in one another"),
        ("x = {" + 20000 * "a." + "a", "too deep in one another"),
        ("x = [1.5, 2.5, {" + 20000 * "a." + "a", "too deep in one another"),
    ],
    ids=lambda value: value[:30],
)
def test_a_dotted_key_of_thousands_of_parts_is_refused_at_once(
    key: str, words: str
) -> None:
    message = refusal(f"{key} = 1")
    assert words in message
    assert len(message) < 300


def test_of_many_unknown_keys_only_some_are_named() -> None:
    message = refusal("\n".join(f"k{n} = 1" for n in range(5000)))
    assert message.endswith("; and 4980 more problems")
    assert len(message) < 6000  # 20 times the known keys


def test_a_plan_longer_than_any_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(TEXT + "#" * 2**18)
    with pytest.raises(PlanError, match="no plan is as long"):
        Plan.load(tmp_path / "plan.toml")


MOST = 250_000
"""Characters, about as many as a plan may have."""


def repeated(part: str) -> str:
    return part * (MOST // len(part))


@pytest.mark.parametrize(
    "text",
    [
        "[" + 15 * "h." + "h]\n" + "".join(f"k{n}{15 * '.a'} = 1\n" for n in range(6000)),
        "".join(f"[{15 * 'a.'}b{n}]\n" for n in range(6000)),
        "x = {" + ",".join(f"k{n}{15 * '.a'} = 1" for n in range(6000)) + "}",
        "x = [" + repeated("[" * 200 + "]" * 200 + ",") + "]",
        "x = [" + repeated("{},") + "]",
        repeated("[[channel]]\n"),
        repeated("[[a]]\n"),
        "".join(f'[[channel]]\nname = "G{n}"\nwavelength_nm = 5\n' for n in range(5000)),
        "x = 0x" + repeated("f"),
        "x = " + repeated("1_") + "1",
        "x = 0." + repeated("1"),
        'x = "' + repeated("\\n\\U0001F600") + '"',
        'x = """' + repeated("\\\n ") + '"""',
        "x = [" + repeated("#\n") + "]",
        repeated("'"),
        repeated('"\n'),
        repeated('"""\n'),
        repeated('\\"'),
        TEXT + "[rail]\nranges_mm = [" + repeated("1,") + "]",
        TEXT + "[mount]\nscrews_mm = [" + repeated("[[1,2]],") + "]",
        plan_text(PORTRAIT, {"target": {"kind": "image", "file": repeated("R")}}),
        plan_text(PORTRAIT, {"channel": [{"name": repeated("R"), "wavelength_nm": 500}]}),
    ],
    ids=lambda value: value[:20],
)
def test_a_plan_that_is_much_work_is_refused_in_seconds_and_in_one_line(text: str) -> None:
    before_s = time.process_time()
    with pytest.raises(PlanError) as caught:
        Plan.parse(text)
    assert time.process_time() - before_s < 7  # 3.7 s at most, of lists in screws_mm
    assert len(str(caught.value)) < 6000
    assert "\n" not in str(caught.value)


def test_dots_in_texts_comments_and_numbers_are_no_keys() -> None:
    words = plan_text(PORTRAIT, {"about": {"note": "a.b" * 30}})
    lists = "[noise]\nexposures_s = [0.1, 0.2, 0.4, 0.8, 1.6] # " + "1.2" * 30
    plan = Plan.parse(f"{words}\n{lists}\n# it's {30 * 'a.'}\n")
    assert plan.about.note == "a.b" * 30
