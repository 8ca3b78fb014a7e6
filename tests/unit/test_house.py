"""Limits of the house: sizes and density of its files, words of its docstrings, names of its constants."""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from statistics import mean, median

import pytest

ROOT = Path(__file__).parents[2]
EVERYWHERE = ("labkit", "drivers", "targets", "tests", "benchmarks", "examples", "docs")
MOST_LINES, MEDIAN_LINES, MOST_SHARE_OF_A_ROOM = 900, 200, 0.15
# A file is a subject: a limit that splits a subject is worse than a long file.
MOST_STATEMENTS, MOST_LINES_OF_A_FUNCTION = 34, 80
MEAN_CHARACTERS, MEAN_TOKENS = 41.5, 9.2
FRAGMENTS = ("Of", "As", "By", "That", "Those", "What", "Its")
PRONOUNS = {"it", "that", "those", "one", "what"}
MOST_PRONOUNS = 0.025
MOST_PAIRS = 0.008
"""Assignments of several values at once, for each line of code: peers have one to six in a thousand lines."""
TOKENS: dict[str, int] = {
    "drivers/gphoto2": 8300,
    "drivers/grbl": 2900,
    "drivers/manual_display": 400,
    "drivers/manual_rail": 400,
    "drivers/serial": 1200,
    "drivers/simulated": 40900,
    "drivers/web": 7900,
    "drivers/zaber": 1600,
    "labkit/__init__": 700,
    "labkit/acquisition": 8600,
    "labkit/advice": 5900,
    "labkit/analysis": 26200,
    "labkit/arrays": 400,
    "labkit/calibration": 10100,
    "labkit/catalogue": 6400,
    "labkit/charts": 22200,
    "labkit/cli": 17800,
    "labkit/demo": 1400,
    "labkit/devices": 8900,
    "labkit/edges": 30200,
    "labkit/errors": 400,
    "labkit/estimation": 62600,
    "labkit/experiments": 26200,
    "labkit/field": 26700,
    "labkit/figure_style": 1000,
    "labkit/finder": 20700,
    "labkit/findings": 2300,
    "labkit/imaging": 26300,
    "labkit/jobs": 5600,
    "labkit/key": 400,
    "labkit/noise": 9000,
    "labkit/numerics": 400,
    "labkit/optics": 23200,
    "labkit/panel": 5900,
    "labkit/photographs": 13900,
    "labkit/plan": 10300,
    "labkit/report": 36300,
    "labkit/restoration": 24200,
    "labkit/results": 17300,
    "labkit/session": 11800,
    "labkit/spectra": 1200,
    "labkit/storage": 6700,
    "labkit/target": 4600,
    "labkit/types": 200,
    "labkit/uncertain": 700,
    "labkit/version": 100,
    "targets": 3000,
}
"""Largest number of tokens of each room, without comments and docstrings."""
SLACK = 1.03
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def files(*folders: str) -> list[Path]:
    return sorted(chain.from_iterable((ROOT / folder).rglob("*.py") for folder in folders))


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def functions(path: Path) -> Iterator[tuple[str, int, int]]:
    """Yield the name, the number of lines and the number of statements of each function of a file.

    Decorators and docstrings count as no lines.
    """
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            last = node.end_lineno or node.lineno
            body = node.body[ast.get_docstring(node) is not None :]
            first = body[0].lineno if body else last
            heading = node.body[0].lineno - node.lineno
            statements = sum(isinstance(part, ast.stmt) for part in ast.walk(node)) - 1
            yield f"{name(path)}:{node.name}", heading + last - first + 1, statements


def code_lines(path: Path) -> Iterator[list[str]]:
    """Yield the tokens of each line of a file that holds code; comments and docstrings are none."""
    source = path.read_text(encoding="utf-8")
    described = set[int]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            described |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    found = dict[int, list[str]]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE and token.start[0] not in described:
            found.setdefault(token.start[0], []).append(token.line)
    yield from found.values()


def rooms(size: Callable[[Path], int]) -> dict[str, int]:
    """Sizes of each room: packages and single modules of labkit, drivers' families, targets."""
    found: dict[str, int] = {}
    for path in files("labkit", "drivers", "targets"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        room = "/".join(parts[:1] if parts[0] == "targets" else parts[:2])
        found[room] = found.get(room, 0) + size(path)
    return found


def tokens(path: Path) -> int:
    return sum(map(len, code_lines(path)))


def test_no_file_is_longer_than_nine_hundred_lines() -> None:
    assert {name(path) for path in files(*EVERYWHERE) if lines(path) > MOST_LINES} == set()


def test_no_function_does_more_than_a_reader_can_hold() -> None:
    """Statements are the measure: a table of eighty lines is one thought, forty dense lines are none."""
    every = list(chain.from_iterable(functions(path) for path in files(*EVERYWHERE)))
    assert {
        where for where, _, statements in every if statements > MOST_STATEMENTS
    } == set()
    assert {
        where for where, length, _ in every if length > MOST_LINES_OF_A_FUNCTION
    } == set()


@pytest.mark.parametrize("folder", ["labkit", "drivers"])
def test_code_is_not_squeezed(folder: str) -> None:
    every = list(chain.from_iterable(code_lines(path) for path in files(folder)))
    assert mean(len(line[0].rstrip()) for line in every) <= MEAN_CHARACTERS
    assert mean(len(line) for line in every) <= MEAN_TOKENS


def test_a_line_assigns_one_value() -> None:
    """Values that are a tuple by nature, such as rows and columns, are the exception."""
    together = sum(
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
        for path in PRODUCT
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    )
    every = sum(1 for path in PRODUCT for _ in code_lines(path))
    assert together / every <= MOST_PAIRS


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_the_median_file_has_two_hundred_lines_at_most(folder: str) -> None:
    assert median(lines(path) for path in files(folder)) <= MEDIAN_LINES


def test_a_room_keeps_its_budget_of_tokens() -> None:
    """Budgets fall with the code: whoever makes a room smaller lowers its number, and a room that must grow says why in the
    commit that raises it."""
    found = {room: size for room, size in rooms(tokens).items() if size}
    assert {room: size for room, size in found.items() if size > TOKENS.get(room, 0)} == {}
    generous = {
        room: most for room, most in TOKENS.items() if most > SLACK * found[room] + 100
    }
    assert generous == {}, "write the smaller numbers down"


def test_ten_modules_lie_beside_the_rooms() -> None:
    assert len(list((ROOT / "labkit").glob("*.py"))) <= 10


def test_no_room_holds_more_than_its_share_of_the_lines() -> None:
    found = rooms(lines)
    share = {room: count / sum(found.values()) for room, count in found.items()}
    assert {
        room: f"{part:.1%}" for room, part in share.items() if part > MOST_SHARE_OF_A_ROOM
    } == {}


def docstrings(path: Path) -> Iterator[str]:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, documented) and (text := ast.get_docstring(node)):
            yield text


def descriptions(path: Path) -> Iterator[str]:
    """Yield docstrings, and the texts below constants and fields."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        text = node.value if isinstance(node, ast.Expr) else None
        if isinstance(text, ast.Constant) and isinstance(text.value, str):
            yield text.value


def constants(path: Path) -> Iterator[str]:
    """Yield the names of a module's own constants."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for part in chain.from_iterable(map(ast.walk, targets)):
                if isinstance(part, ast.Name) and part.id.isupper():
                    yield part.id


PRODUCT = [
    path
    for path in files("labkit", "drivers", "targets")
    if name(path).startswith("drivers/") or "drivers" not in name(path)
]


def test_docstrings_have_a_subject_and_a_verb() -> None:
    texts = [(name(path), text) for path in PRODUCT for text in docstrings(path)]
    found = Counter(where for where, text in texts if text.split()[0] in FRAGMENTS)
    assert found == {}


def test_docstrings_name_things_rather_than_point_at_them() -> None:
    """Peers' docstrings have 1 to 2 % pronouns of this kind."""
    words = [
        word
        for path in PRODUCT
        for text in descriptions(path)
        for word in re.findall(r"[a-z']+", text.lower())
    ]
    assert sum(word in PRONOUNS for word in words) / len(words) <= MOST_PRONOUNS


def test_a_constants_name_has_one_meaning() -> None:
    """No two modules define the same name."""
    found = Counter(constant for path in PRODUCT for constant in set(constants(path)))
    assert {constant for constant, count in found.items() if count > 1} == set()
