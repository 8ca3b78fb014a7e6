"""A lens that is turned in the middle of a session: photographs of a simulated bench, from files to two results."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import labkit
from benchmarks.random_sessions import Drawn, draw, make
from labkit.cli import run
from labkit.session.session import Session

BEFORE_MM, AFTER_MM = (1334.8, 1366.3, 1399.4), (1434.1, 1470.7, 1509.1)
TURNED_MM = 17.4  # by which best focus is moved: 0.3 waves


def part(drawn: Drawn, ranges_mm: tuple[float, ...], turned_mm: float) -> Drawn:
    """Of a session, with its lens focused elsewhere."""
    lens = drawn.settings.lens
    focus_mm = {colour: mm + turned_mm for colour, mm in lens.best_focus_mm.items()}
    plan = drawn.plan.replace(rail={"ranges_mm": ranges_mm})
    return replace(
        drawn,
        plan=plan,
        settings=replace(drawn.settings, lens=replace(lens, best_focus_mm=focus_mm)),
    )


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, drawn, rows = (
        tmp_path_factory.mktemp("turned"),
        draw(1, 11),
        ["file,kind,range_mm"],
    )
    for name, ranges_mm, turned_mm in (("0", BEFORE_MM, 0.0), ("1", AFTER_MM, TURNED_MM)):
        make(part(drawn, ranges_mm, turned_mm), folder / name)
        for frame in Session.open(folder / name).frames:
            shutil.copy(frame.path, folder / f"{name}_{frame.path.name}")
            range_mm = "" if frame.range_mm is None else f"{frame.range_mm:g}"
            rows.append(f"{name}_{frame.path.name},{frame.kind},{range_mm}")
    (folder / "frames.csv").write_text("\n".join(rows), encoding="utf-8")
    plan = folder / "0" / "plan.toml"
    assert (
        run(["import", str(folder / "frames.csv"), str(plan), str(folder / "session")]) == 0
    )
    return folder / "session"


def test_the_moment_is_named_and_both_halves_are_fitted(session: Path) -> None:
    assert run(["fit", str(session), "--split", "--quiet", "--workers", "1"]) == 0
    whole, before, after = (
        labkit.Results.load(session, f"latest{end}") for end in ("", "-before", "-after")
    )
    (change,) = (
        finding.numbers for finding in whole.findings if finding.code == "lens-changed"
    )
    assert change == {"last_mm": pytest.approx(1399.4), "next_mm": pytest.approx(1434.1)}
    drawn = draw(1, 11)
    true_mm = drawn.settings.lens.best_focus_mm["G"] - drawn.settings.rail.tape_error_mm
    for half, turned_mm in ((before, 0.0), (after, TURNED_MM)):
        assert half.focus is not None
        assert half.lens is not None
        best = half.focus["G"]
        assert best.std < 0.07  # 0.037 and 0.027
        assert abs(best.value - true_mm - turned_mm) < 3 * best.std
        f_number = half.lens.f_number
        assert (
            abs(f_number.value - drawn.settings.lens.f_number) < 3 * f_number.std < 0.2
        )  # 0.031, three times
