"""What the tab key completes in a shell, and what --help shows."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import typer

from labkit.cli import bench, run, sessions
from labkit.cli.app import app
from labkit.cli.command_line import COMMANDS, load_commands
from labkit.experiments.studies import STUDIES
from labkit.panel.panels import PANELS
from tests.plans import RED_AND_GREEN, SMALL, plan_text

assert bench
assert sessions
NARROW = 80
"""Columns of a terminal that nobody has widened."""


def completed(line: str, folder: Path) -> set[str]:
    """What bash offers at the end of a line."""
    words = line.split(" ")
    shell = {
        "_LABKIT_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    program = [sys.executable, "-c", "from labkit.cli import main; main()"]
    done = subprocess.run(
        program,
        env={**os.environ, **shell},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stderr == ""
    return set(done.stdout.split())


def test_studies_complete(tmp_path: Path) -> None:
    assert completed("labkit study ", tmp_path) == set(STUDIES)


def test_channels_are_those_of_the_session(tmp_path: Path) -> None:
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "plan.toml").write_text(plan_text(SMALL, RED_AND_GREEN))
    assert completed("labkit fit night --channel ", tmp_path) == {"R", "G"}
    assert completed("labkit fit --channel ", tmp_path) == {"R", "G", "B"}


@pytest.mark.parametrize(
    "text",
    [
        670 * ("a." * 63 + f'"{"x" * 257}".') + "a=1",
        2**19 * "#" + '\n[[channel]]\nname = "Z"',
        '[[channel]]\nname = "R"\n[[channel]]\nname = "\\u001b[31mG"',
    ],
    ids=["slow", "long", "control characters"],
)
def test_a_strangers_plan_completes_at_once_and_prints_no_control_character(
    tmp_path: Path, text: str
) -> None:
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "plan.toml").write_text(text)
    assert completed("labkit fit night --channel ", tmp_path) <= {"R", "G", "B"}


def test_panels_complete(tmp_path: Path) -> None:
    assert completed("labkit target serve x --panel ipad-p", tmp_path) == {
        n for n in PANELS if n.startswith("ipad-p")
    }


def test_kinds_of_target_complete_and_plans_beside_them(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").touch()
    kinds = {f"{entry.name}:" for entry in entry_points(group="labkit.targets")}
    assert completed("labkit target render ", tmp_path) == kinds | {"bench.toml"}


def commands(command: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, f"{path} {name}")


load_commands()
EVERY = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("path", list(EVERY)[1:])
def test_every_summary_is_whole(path: str) -> None:
    # 45 is what shells show beside a completion, less than any terminal's list of commands does
    assert "..." not in EVERY[path].get_short_help_str(45)


@pytest.mark.parametrize(
    "path", [path for path, command in EVERY.items() if not hasattr(command, "commands")]
)
def test_every_option_with_a_value_shows_its_default(
    path: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(NARROW))
    run([*path.split(), "--help"])
    shown = " ".join(capfd.readouterr().out.split())
    options = [
        p
        for p in EVERY[path].params
        if p.param_type_name == "option" and not (p.is_flag or p.required)
    ]
    without = []
    for option in options:
        entry = shown.partition(f" {option.opts[0]} ")[2].partition(" --")[0]
        if "[default: " not in entry and option.opts[0] not in (
            "--pixels",
            "--want",
        ):  # which ask for something more
            without.append(option.opts[0])
    assert without == []


def test_each_module_of_commands_is_known_by_its_first_words() -> None:
    load_commands()
    words = {first for words in COMMANDS.values() for first in words}
    groups = {group.name for group in app.registered_groups}
    named = {
        c.name or (c.callback and c.callback.__name__) for c in app.registered_commands
    }
    assert words == groups | named


def test_a_command_loads_no_other_commands() -> None:
    code = (
        "import sys; from labkit.cli.command_line import load_commands; load_commands('fit');"
        "print(*sorted(m for m in sys.modules if m.startswith('labkit.cli.')))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60
    )
    assert "labkit.cli.sessions" in ran.stdout
    assert "labkit.cli.bench" not in ran.stdout
