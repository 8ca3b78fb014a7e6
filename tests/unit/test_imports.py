"""Data flows one way through six layers: a room imports only from itself and from rooms above it. Imports are read, not run."""

import ast
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

LAYERS = {
    "base": [
        *("types", "errors", "key", "arrays", "uncertain", "version", "numerics"),
        *("figure_style", "findings", "storage", "jobs", "spectra", "plan", "target"),
    ],
    "model": ["optics", "panel", "imaging"],
    "material": [
        *("photographs", "results", "finder", "session", "calibration"),
        *("devices", "acquisition"),
    ],
    "estimation": ["estimation"],
    "subjects": [
        *("field", "analysis", "advice", "restoration", "edges", "catalogue"),
        *("experiments", "noise", "charts"),
    ],
    "faces": ["report", "demo", "cli"],
}
"""Six layers from top to bottom, and their rooms: each imports from rooms before it, those of its own layer included."""

ORDER = [room for rooms in LAYERS.values() for room in rooms]

NO_ARROW = {
    "analysis": {"devices", "acquisition"},
    "report": {"estimation", "analysis", "calibration", "finder", "devices"},
    "field": {"estimation", "analysis", "calibration", "finder", "devices"},
    "results": {"imaging", "panel"},
}
"""Rooms that a room must not import though they come before it."""

MATHEMATICS = (
    *(
        "labkit/optics",
        "labkit/imaging",
        "labkit/estimation",
    ),
    "labkit/experiments/methods",
)

ARRAYS = {
    "labkit/edges": [
        "defocus_sides",
        "edge_fit",
        "esfr",
        "first_fits",
        "found_edges",
        "ranges",
        "region",
        "response",
        "spread",
    ],
    "labkit/restoration": [
        "blind",
        "colours",
        "errors",
        "evidence",
        "grid",
        "job",
        "kriging",
        "noise",
        "registration",
        "roughness",
        "solve",
        "strength",
        "tiles",
        "views",
    ],
}
"""Modules of other rooms that know arrays alone."""

FILES_AND_DEVICES = {
    "csv",
    "json",
    "pathlib",
    "rawpy",
    "serial",
    "shutil",
    "tifffile",
    "usb",
}


def modules(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def mathematics() -> list[Path]:
    arrays = [ROOT / f / f"{name}.py" for f, names in ARRAYS.items() for name in names]
    return modules(*MATHEMATICS) + arrays


@cache
def imported(path: Path) -> tuple[str, ...]:
    """Dotted names of everything a module imports, wherever in it; relative ones are made absolute."""
    return tuple(read_imports(path))


def read_imports(path: Path) -> Iterator[str]:
    """Yield the same from the module's source."""
    package = path.relative_to(ROOT).parent.parts
    if package and package[0] in ("drivers", "targets"):
        package = ("labkit", *package)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            where = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{where}.{alias.name}" for alias in node.names)


def room(dotted: str) -> str | None:
    """The room that a dotted name belongs to, if it is labkit's."""
    parts = dotted.split(".")
    known = parts[0] == "labkit" and len(parts) > 1 and parts[1] != "__version__"
    return parts[1] if known else None


def dotted_name(path: Path) -> str:
    """What a module is imported as: drivers/ and targets/ are packages of labkit."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "labkit" else ("labkit", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def wrong(paths: list[Path], is_wrong: Callable[[Path, str], bool]) -> list[str]:
    """Imports of modules that are wrong, each with its module."""
    assert paths
    return [
        f"{name(path)} imports {dotted}"
        for path in paths
        for dotted in imported(path)
        if is_wrong(path, dotted)
    ]


def test_a_room_imports_only_from_rooms_above_it() -> None:
    def is_below(path: Path, dotted: str) -> bool:
        own = path.relative_to(ROOT / "labkit").parts[0].removesuffix(".py")
        other = room(dotted)
        if other in (None, own):
            return False
        return ORDER.index(str(other)) >= ORDER.index(own)

    paths = modules("labkit")
    paths.remove(ROOT / "labkit" / "__init__.py")
    assert wrong(paths, is_below) == []


def test_every_room_is_in_one_of_six_layers() -> None:
    rooms = {path.stem for path in (ROOT / "labkit").glob("*.py")}
    rooms |= {path.parent.name for path in (ROOT / "labkit").glob("*/__init__.py")}
    assert rooms - {"__init__", "drivers", "targets"} == set(ORDER)
    assert len(LAYERS) == 6


@pytest.mark.parametrize(("own", "others"), NO_ARROW.items())
def test_no_arrow_goes_where_none_is_needed(own: str, others: set[str]) -> None:
    for path in modules(f"labkit/{own}"):
        reach = {room(dotted) for dotted in reached(path)}
        assert reach & others == set(), name(path)


def test_the_core_imports_no_driver_and_no_target() -> None:
    def is_family(_: Path, dotted: str) -> bool:
        return room(dotted) in ("drivers", "targets")

    assert wrong(modules("labkit"), is_family) == []


def test_nobody_imports_drivers_or_targets_by_their_bare_names() -> None:
    # that would give a second copy of every class in them
    def is_bare(_: Path, dotted: str) -> bool:
        return dotted.split(".")[0] in ("drivers", "targets")

    beside = modules("tests", "benchmarks", "examples", "docs")
    assert wrong(modules("labkit", "drivers", "targets") + beside, is_bare) == []


def test_the_mathematics_knows_no_file_and_no_device() -> None:
    def is_outside(_: Path, dotted: str) -> bool:
        return dotted.split(".")[0] in FILES_AND_DEVICES

    assert wrong(mathematics(), is_outside) == []


def test_a_target_needs_only_the_plan_and_the_target_protocol() -> None:
    needed = {
        None,
        "arrays",
        "errors",
        "photographs",
        "plan",
        "target",
        "targets",
        "types",
    }
    assert wrong(modules("targets"), lambda _, name: room(name) not in needed) == []


def test_a_driver_knows_nothing_of_the_model_that_it_tests() -> None:
    # the simulated bench would agree with any mistake that it shared
    forbidden = {
        "optics",
        "imaging",
        "estimation",
        "calibration",
        "analysis",
        "results",
        "report",
    }
    assert wrong(modules("drivers"), lambda _, name: room(name) in forbidden) == []


DOTTED = {dotted_name(path): path for path in modules("labkit", "drivers", "targets")}


def reached(start: Path) -> set[str]:
    """Dotted names of everything that a module imports, by whatever way."""
    found: set[str] = set()
    todo = [start]
    while todo:
        for dotted in imported(todo.pop()):
            # "labkit.photographs.photograph.Photograph" is a name in the module labkit.photographs.photograph
            module = next(
                (m for m in (dotted, dotted.rpartition(".")[0]) if m in DOTTED), dotted
            )
            if module not in found:
                found.add(module)
                todo += [DOTTED[module]] if module in DOTTED else []
    return found


def test_devices_reach_no_raw_decoding() -> None:
    for path in modules("labkit/devices"):
        assert {
            "rawpy",
            "labkit.photographs.decoding",
            "labkit.photographs.container",
        } & reached(path) == set(), name(path)


def test_no_driver_reaches_a_simulator() -> None:
    for path in modules("drivers"):
        if "simulated" not in path.parts:
            assert {
                m for m in reached(path) if m.startswith("labkit.drivers.simulated")
            } == set(), name(path)


def test_the_mathematics_reaches_no_session_and_no_device() -> None:
    for path in mathematics():
        below = {
            "session",
            "photographs",
            "devices",
            "acquisition",
            "drivers",
            "analysis",
            "report",
        }
        assert {m for m in reached(path) if room(m) in below} == set(), name(path)
