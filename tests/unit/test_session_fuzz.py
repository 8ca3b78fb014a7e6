"""Sessions damaged at random: `verify` names every damage, in whole lines and without a traceback."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from labkit.errors import SessionError
from labkit.session.session import Session
from labkit.session.verify import remarks, verify
from tests.plans import PORTRAIT, plan_text

MUTATIONS = 300


def make_session(folder: Path) -> Path:
    """A session with a target's picture, photographs of every kind and other events; it ends with a photograph."""
    (folder / "print.pgm").write_bytes(b"P5 2 2 255\n\x00\xff\xff\x00")
    text = plan_text(
        PORTRAIT, {"target": {"kind": "image", "order": None, "file": "print.pgm"}}
    )
    with Session.create(folder / "whole", text, folder) as session:
        for number, kind in enumerate(("dark", "bias", "flat", "target", "target")):
            session.log("moved", range_mm=2000.0 + number, words="µm")
            photo = folder / f"{kind}_{number}.dng"
            photo.write_bytes(np.random.default_rng(number).bytes(200))
            range_mm = 2000.0 + number if kind in ("flat", "target") else None
            session.add_frame(photo, photo.name, kind, range_mm, exposure_s=0.02)  # type: ignore[arg-type]
    return folder / "whole"


def damage_bytes(path: Path, rng: np.random.Generator) -> str:
    """Alter, insert, remove or cut off bytes of a file."""
    content, at = path.read_bytes(), int(rng.integers(path.stat().st_size))
    how = str(rng.choice(["altered", "inserted", "removed", "cut"]))
    new = {
        "altered": content[:at]
        + bytes([content[at] ^ int(rng.integers(1, 256))])
        + content[at + 1 :],
        "inserted": content[:at] + rng.bytes(int(rng.integers(1, 9))) + content[at:],
        "removed": content[:at] + content[at + int(rng.integers(1, 9)) :],
        "cut": content[:at],
    }[how]
    path.write_bytes(new)
    return f"bytes {how}"


def damage_lines(journal: Path, rng: np.random.Generator) -> str:
    """Drop, double or swap whole lines."""
    lines = journal.read_bytes().splitlines(keepends=True)
    first, second = (int(place) for place in rng.choice(len(lines), 2, replace=False))
    how = str(rng.choice(["dropped", "doubled", "swapped", "moved"]))
    if how == "dropped":
        del lines[first]
    elif how == "doubled":
        lines.insert(int(rng.integers(len(lines) + 1)), lines[first])
    elif how == "swapped":
        lines[first], lines[second] = lines[second], lines[first]
    else:
        lines.insert(second, lines.pop(first))
    journal.write_bytes(b"".join(lines))
    return f"line {how}"


def damage_files(folder: Path, rng: np.random.Generator) -> str:
    """Lose, rename, swap or add photographs."""
    first, second = (
        Path(path)
        for path in rng.choice(sorted((folder / "frames").iterdir()), 2, replace=False)
    )
    how = str(rng.choice(["lost", "renamed", "swapped", "added", "made a folder"]))
    if how == "lost":
        first.unlink()
    elif how == "renamed":
        first.rename(first.with_name(f"other_{first.name}"))
    elif how == "added":
        shutil.copy(first, first.with_name("stray.dng"))
    elif how == "swapped":
        content = first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(content)
    else:
        first.unlink()
        first.mkdir()
    return f"photograph {how}"


def damage(folder: Path, rng: np.random.Generator) -> str:
    """One damage of a session; in words."""
    match str(
        rng.choice(["journal", "lines", "photographs", "photograph", "plan", "picture"])
    ):
        case "journal":
            return "journal: " + damage_bytes(folder / "journal.jsonl", rng)
        case "lines":
            return "journal: " + damage_lines(folder / "journal.jsonl", rng)
        case "photographs":
            return damage_files(folder, rng)
        case "photograph":
            return "photograph: " + damage_bytes(
                Path(rng.choice(sorted((folder / "frames").iterdir()))), rng
            )
        case name:
            return f"{name}: " + damage_bytes(
                folder / {"plan": "plan.toml"}.get(name, "print.pgm"), rng
            )


def findings(folder: Path) -> Iterator[str]:
    """All that labkit reports of a session, a line each; whether its plan can be used as well."""
    try:
        session = Session.open(folder)
        yield from (*session.warnings, *verify(session), *remarks(session))
        assert session.plan.target.size_mm == 15.6
    except SessionError as error:
        yield str(error)


def damage_and_look(whole: Path, folder: Path, seed: int) -> tuple[str, list[str]]:
    """What was done to a copy of a session, unless it made no difference, and what labkit reports of it."""
    rng = np.random.default_rng([20, seed])
    what, same = "", True
    while same:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        what = damage(folder, rng)
        same = _content(folder) == _content(whole)
    return what, list(findings(folder))


def _content(folder: Path) -> dict[Path, bytes | None]:
    paths = folder.rglob("*")
    return {
        path.relative_to(folder): path.read_bytes() if path.is_file() else None
        for path in paths
    }


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return make_session(tmp_path)


def test_a_session_that_is_whole_gives_no_cause(whole: Path) -> None:
    assert list(findings(whole)) == []


def test_every_damage_is_named(whole: Path, tmp_path: Path) -> None:
    unnoticed: Counter[str] = Counter()
    for seed in range(MUTATIONS):
        what, lines = damage_and_look(whole, tmp_path / "damaged", seed)
        unnoticed[what] += not lines
        assert not any("\n" in line for line in lines)
    assert +unnoticed == Counter()
