"""The wheel holds every package and data file: one that is not listed is silently left out."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MOVED = {"drivers": "labkit/drivers", "targets": "labkit/targets"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built from the files that git would commit, without the network."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for path in source_files():
        (source / path).parent.mkdir(parents=True, exist_ok=True)
        (source / path).write_bytes((ROOT / path).read_bytes())
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(out),
        str(source),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = out.glob("*.whl")
    return zipfile.ZipFile(path)


def source_files() -> list[Path]:
    """Everything that belongs into the wheel, and what it takes to build it."""
    code = [
        path
        for folder in ("labkit", "drivers", "targets")
        for path in (ROOT / folder).rglob("*")
    ]
    found = [path for path in code if path.is_file() and "__pycache__" not in path.parts]
    return [
        path.relative_to(ROOT)
        for path in [*found, ROOT / "pyproject.toml", ROOT / "README.md"]
    ]


def installed_as(path: Path) -> str:
    top = path.parts[0]
    return "/".join([MOVED.get(top, top), *path.parts[1:]])


def test_every_file_of_the_packages_is_in_the_wheel(wheel: zipfile.ZipFile) -> None:
    wanted = {installed_as(path) for path in source_files() if len(path.parts) > 1}
    assert wanted - set(wheel.namelist()) == set()


def test_nothing_else_is_in_the_wheel(wheel: zipfile.ZipFile) -> None:
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert tops == {"labkit", next(top for top in tops if top.endswith(".dist-info"))}


def test_every_entry_point_leads_to_something(wheel: zipfile.ZipFile) -> None:
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]["entry-points"]
    names = set(wheel.namelist())
    for entries in groups.values():
        for entry in entries.values():
            module, _, function = entry.partition(":")
            file = module.replace(".", "/") + ".py"
            assert file in names
            assert f"def {function}(" in wheel.read(file).decode()
