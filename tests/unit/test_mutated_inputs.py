"""Damaged files of every kind that is read: each is taken, or refused in one short printable line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from labkit.errors import InputError
from labkit.plan import Plan
from labkit.session.import_frames import Row, read_rows
from tests.mutations import NASTY, mutated
from tests.plans import PORTRAIT, RED_AND_GREEN, plan_text, simulated

PLAN = plan_text(PORTRAIT, RED_AND_GREEN, simulated([3000, 3200.5], 2950.0))
ROWS = (
    'file,kind,range_mm,lens\ntarget.dng,target,3000,"70, wide"\nflat 1.dng,flat,3000.5,\na/dark.dng,dark,,\n'
    "b/bias.dng;bias;;\n"
)
TOML = (*NASTY, b"=", b"[", b"[[", b".a" * 50, b"{", b"'''", b"0x" + b"f" * 5000, b"f/2.8", b"[lens]\n", b"channel")
CSV = (*NASTY, b",", b";", b"'", b"a" * 140_000, b"file", b"kind", b"/", b"target", b"1_0")


def refusals(damaged: Iterable[bytes], read: Callable[[bytes], object]) -> list[str]:
    """What is said of the inputs that are refused; whatever else goes wrong with one is raised."""
    messages = []
    for content in damaged:
        try:
            read(content)
        except InputError as error:
            messages.append(str(error))
    return messages


def read_plan(content: bytes) -> None:
    """A plan that is taken reads back the same."""
    plan = Plan.parse(content.decode("utf-8", errors="replace"))
    assert Plan.parse(plan.to_toml()) == plan


def rows_in(folder: Path) -> Callable[[bytes], object]:
    """Reads the rows of a CSV in that folder."""
    plan = Plan.parse(PLAN)

    def read(content: bytes) -> list[Row]:
        (folder / "frames.csv").write_bytes(content)
        return read_rows(folder / "frames.csv", plan)

    return read


def check(messages: list[str], inputs: int) -> None:
    """Damage is mostly found, not always: some of it makes another good file."""
    assert inputs / 2 < len(messages) < inputs
    assert [message for message in messages if not message.isprintable() or len(message) > 4000] == []


def test_damaged_plans_are_taken_or_refused_in_one_line() -> None:
    check(refusals(mutated(PLAN.encode(), 400, tokens=TOML, seed=1), read_plan), 400)


def test_damaged_csvs_are_taken_or_refused_in_one_line(tmp_path: Path) -> None:
    check(refusals(mutated(ROWS.encode(), 400, tokens=CSV, seed=2), rows_in(tmp_path)), 400)
