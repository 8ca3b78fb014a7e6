"""The tutorials, run as they stand: their files are written, their commands are run, their output is compared."""

from __future__ import annotations

import re
import runpy
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labkit.cli import run
from labkit.drivers.simulated import setup
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.simulated.world import BenchSettings
from labkit.plan import Plan
from labkit.results import Results
from labkit.session.session import Session

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")
pytestmark = pytest.mark.slow


def tutorial(name: str) -> str:
    return (ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")


def files(text: str) -> dict[str, str]:
    """Contents by caption."""
    return dict(
        re.findall(r"```\{code-block\} \w+\n:caption: (\S+)\n(.*?)```", text, re.DOTALL)
    )


def sessions(text: str) -> list[tuple[str, list[str]]]:
    """Each command and the lines that are shown below it."""
    blocks = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    shown = [
        part.splitlines()
        for block in blocks
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]
    ]
    return [(lines[0], lines[1:]) for lines in shown]


def masked(line: str) -> str:
    """Without what differs from machine to machine: digits, and the widths of columns that they make."""
    return " ".join(NUMBER.sub("#", line).split())


def run_all(text: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Run each labkit command; what the tutorial shows of its output is what comes, but for digits."""
    for command, shown in sessions(text):
        program, *args = shlex.split(command)
        assert program == "labkit"
        capfd.readouterr()
        assert run(args) == 0, command
        streams = capfd.readouterr()
        printed = {masked(line) for line in (streams.out + streams.err).splitlines()}
        assert [
            line for line in shown if line != "…" and masked(line) not in printed
        ] == [], command


def draft_lines(text: str) -> set[str]:
    """What a draft states without asking, but for the tables of colours."""
    head, _, target = text.partition("[[channel]]")
    lines = [
        line.split("#")[0].strip()
        for line in [*head.splitlines(), *target.partition("[target]")[2].splitlines()]
    ]
    return set(filter(None, lines))


def nearer_bench(plan: Plan, seed: int) -> BenchSettings:
    """Diffraction is followed as far as photon noise lets it be seen: that takes a fifth of the time."""
    return replace(settings_for(plan, seed), halo_um=350.0)


def test_a_folder_of_photographs_becomes_a_report_by_the_tutorial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    practice = runpy.run_path(str(ROOT / "examples" / "practice_photographs.py"))
    practice["photograph"](Path("photographs"))
    text = tutorial("files")
    drafting, _, rest = text.partition("## 3.")
    run_all(drafting, capfd)
    given = files(text)
    assert draft_lines(Path("plan.toml").read_text()) <= draft_lines(
        given["plan.toml"]
    )  # nothing but what is filled in
    for name, content in given.items():
        Path(name).write_text(content)
    run_all(rest, capfd)
    assert Path("lens/results/latest/report.html").stat().st_size > 10_000
    focus = Results.load("lens").focus
    assert focus is not None
    guide = (ROOT / "docs" / "guides" / "python.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", guide, re.DOTALL)[:3]:
        exec(code, names)  # the guide's files are the tutorial's
    printed = capfd.readouterr().out
    report = Path("lens/results/latest/report.html").read_text(encoding="utf-8")
    strehl = str(Results.load("lens").nearest_focus("G").best.strehl)
    assert f"{strehl} " in printed
    assert strehl.replace(" ", "\N{NO-BREAK SPACE}") in report
    # four standard errors: the bench's rail scatters by less than one of them
    assert focus["G"].value == pytest.approx(
        practice["bench"]().truth.best_focus_mm["G"], abs=4 * focus["G"].std
    )


def test_the_plan_of_one_photograph_is_that_of_the_real_one(tmp_path: Path) -> None:
    # which tests/system/test_real_photograph.py measures, where it is at hand
    for name in ("pattern.pgm", "pattern_noise.pgm"):
        (tmp_path / name).touch()
    (shown,) = re.findall(r"```toml\n(.*?)```", tutorial("files"), re.DOTALL)
    real = runpy.run_path(str(ROOT / "examples" / "real_photograph.py"))
    used = Plan.parse(real["PLAN"], tmp_path).replace(
        target={"file": str(tmp_path / "pattern.pgm")}
    )
    assert Plan.parse(shown, tmp_path) == used
    assert real["CORNERS"] in tutorial("files")


def test_a_session_is_captured_by_the_tutorial_with_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(setup, "settings_for", nearer_bench)
    text = tutorial("devices")
    for name, content in files(text).items():
        Path(name).write_text(content)
    run_all(text, capfd)
    exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0], {})
    assert capfd.readouterr().out == "8 frames\n"
    kinds = [frame.kind for frame in Session.open("trial").frames]
    assert {kind: kinds.count(kind) for kind in kinds} == {
        "target": 2,
        "flat": 4,
        "dark": 2,
    }
