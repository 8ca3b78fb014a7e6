"""How large the house's files, functions and rooms may be."""

import ast
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parents[2]
EVERYWHERE = ("labkit", "drivers", "targets", "tests", "benchmarks", "examples", "docs")
MOST_LINES, MEDIAN_LINES, MOST_LINES_OF_A_FUNCTION, MOST_SHARE_OF_A_ROOM = 500, 200, 40, 0.15


def files(*folders: str) -> list[Path]:
    return sorted(chain.from_iterable((ROOT / folder).rglob("*.py") for folder in folders))


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Each function of a file and how many lines it has, its docstring and its decorators not counted."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            documented = ast.get_docstring(node) is not None
            first = node.body[0]
            described = (first.end_lineno or first.lineno) - first.lineno + 1 if documented else 0
            yield f"{name(path)}:{node.name}", (node.end_lineno or node.lineno) - node.lineno + 1 - described


def rooms() -> dict[str, int]:
    """Lines of each room: packages and single modules of labkit, drivers' families, targets."""
    found: dict[str, int] = {}
    for path in files("labkit", "drivers", "targets"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        room = "/".join(parts[:1] if parts[0] == "targets" else parts[:2])
        found[room] = found.get(room, 0) + lines(path)
    return found


def test_no_file_is_longer_than_five_hundred_lines() -> None:
    assert {name(path) for path in files(*EVERYWHERE) if lines(path) > MOST_LINES} == set()


def test_no_function_is_longer_than_forty_lines() -> None:
    every = chain.from_iterable(functions(path) for path in files(*EVERYWHERE))
    assert {where for where, length in every if length > MOST_LINES_OF_A_FUNCTION} == set()


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_the_median_file_has_two_hundred_lines_at_most(folder: str) -> None:
    assert median(lines(path) for path in files(folder)) <= MEDIAN_LINES


def test_no_room_holds_more_than_its_share_of_the_lines() -> None:
    found = rooms()
    share = {room: count / sum(found.values()) for room, count in found.items()}
    assert {room: f"{part:.1%}" for room, part in share.items() if part > MOST_SHARE_OF_A_ROOM} == {}
