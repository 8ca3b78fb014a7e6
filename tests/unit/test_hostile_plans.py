"""Plans that nobody writes by hand: refused at once, in one line."""

from __future__ import annotations

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
    ],
    ids=["quotes", "apostrophes", "escapes", "long"],
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
