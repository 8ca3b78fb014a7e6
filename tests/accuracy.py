"""The lane of `make accuracy`: whole sessions and pixels against truths, run again only where what they depend on changed.

A plugin of pytest (`-p tests.accuracy`). What passed stands in accuracy.json beside this file, with the digest of the code
that it passed with; a test that passed with today's digest is left out. The record is committed: a clone need not run it."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from labkit.numerics import LIBRARIES, NO_NUMERICS, versions
from labkit.storage.files import write_atomically

ROOT = Path(__file__).parents[1]
RECORD = Path(__file__).with_suffix(".json")

ROOMS = (NO_NUMERICS | {"drivers"}) - {"field"}
"""Rooms that no session and no field depends on."""


def _sources() -> Iterator[Path]:
    """Yield the files that every accuracy depends on: of the product, its simulator, and of the tests."""
    package = ROOT / "labkit"
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] not in ROOMS:
            yield path
    for folder, deep in {
        "targets": "*.py",
        "drivers/simulated": "**/*.py",
        "tests": "*.py",
        "tests/golden": "*.py",
        "benchmarks": "*.py",
    }.items():
        yield from sorted((ROOT / folder).glob(deep))


def _meaning(path: Path) -> bytes:
    """Return what a file says to the interpreter: comments and docstrings say nothing."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                part
                for part in body
                if not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant))
            ]
    return ast.dump(tree).encode()


@cache
def digest(test_file: Path) -> str:
    """Return the SHA-256 of what the tests of a file depend on: the product's source, libraries, the file itself."""
    found = hashlib.sha256(_product())
    found.update(_meaning(test_file))
    return found.hexdigest()


@cache
def _product() -> bytes:
    found = hashlib.sha256()
    for path in _sources():
        found.update(_meaning(path))
    found.update(
        json.dumps({name: versions()[name] for name in sorted(LIBRARIES)}).encode()
    )
    return found.digest()


def passed() -> dict[str, str]:
    """Return the digests that tests passed with, by test."""
    found: dict[str, str] = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
    return found


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    recorded = passed()
    done = [item for item in items if recorded.get(item.nodeid) == digest(item.path)]
    if done:
        config.hook.pytest_deselected(items=done)
        items[:] = [item for item in items if item not in done]


class Recorder:
    """Record of what passes; an interrupted run keeps what passed until then."""

    def __init__(self) -> None:
        self._recorded = passed()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._recorded.pop(report.nodeid, None)
        elif report.when == "call" and report.passed:
            file = ROOT / report.nodeid.partition("::")[0]
            self._recorded[report.nodeid] = digest(file)

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        if self._recorded != passed():
            text = json.dumps(self._recorded, indent=0, sort_keys=True)
            write_atomically(RECORD, f"{text}\n".encode())
        if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and self._recorded:
            session.exitstatus = pytest.ExitCode.OK  # all of them passed before


def pytest_configure(config: pytest.Config) -> None:
    """The process that hears the reports of all others writes the record."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Recorder())
