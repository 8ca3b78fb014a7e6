"""The wheel holds every package and data file, and an editable install leads to them: what is not listed is left out."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MOVED = {"drivers": "labkit/drivers", "targets": "labkit/targets"}
LINKS = ("src/labkit", "labkit/drivers", "labkit/targets")
EDITABLE = "from setuptools.build_meta import build_editable; build_editable({!r})"
BESIDE = """
import site
site.addsitedir({!r})
import labkit
from labkit.drivers.manual_rail import ManualRail
print(labkit.Plan.__name__, ManualRail.__module__)
"""


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder called labkit with the files that git would commit."""
    clone = tmp_path_factory.mktemp("home") / "labkit"
    for path in source_files():
        (clone / path).parent.mkdir(parents=True, exist_ok=True)
        (clone / path).write_bytes((ROOT / path).read_bytes())
    for link in LINKS:
        (clone / link).parent.mkdir(exist_ok=True)
        (clone / link).symlink_to((ROOT / link).readlink())
    return clone


@pytest.fixture(scope="module")
def wheel(clone: Path, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built without the network."""
    out = tmp_path_factory.mktemp("wheel")
    command = ["-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), "."]
    python(*command, folder=clone)
    (path,) = out.glob("*.whl")
    return zipfile.ZipFile(path)


def python(*arguments: str, folder: Path) -> str:
    """Run this Python in a folder; what it prints."""
    ours = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=ours,
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


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


@pytest.fixture(scope="module")
def beside(clone: Path) -> Path:
    """A script beside a clone that was installed editably, in a Python that has no other labkit."""
    site = clone.with_name("site")
    site.mkdir()
    python("-c", EDITABLE.format(str(site)), folder=clone)
    (built,) = site.glob("*.whl")
    zipfile.ZipFile(built).extractall(site)
    needed = Path(pytest.__file__).parents[1]
    script = clone.with_name("script.py")
    script.write_text(
        f"import sys; sys.path.append({str(needed)!r})" + BESIDE.format(str(site))
    )
    return script


def test_a_script_beside_a_clone_imports_all_of_it(beside: Path) -> None:
    said = python("-S", str(beside), folder=beside.parent)
    assert said == "Plan labkit.drivers.manual_rail\n"


def test_a_module_run_beside_a_clone_imports_all_of_it(beside: Path) -> None:
    said = python("-S", "-m", beside.stem, folder=beside.parent)
    assert said == "Plan labkit.drivers.manual_rail\n"
