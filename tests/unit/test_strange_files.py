"""Pipes, devices, folders, links and endless files in the place of each file that labkit reads back: one line, at once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from labkit.analysis.kept_fits import KeptFits
from labkit.cli import run
from labkit.cli.app import channels
from labkit.drivers.simulated.zernike_table import read_table
from labkit.errors import InputError, LabkitError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import read_exif
from labkit.photographs.picture_file import read_picture
from labkit.plan import Plan
from labkit.results import Results
from labkit.results.storage import kept_keys, set_aside_corrupt
from labkit.session.fit_lock import fitted_alone
from labkit.session.import_frames import read_rows
from labkit.session.journal import JOURNAL, is_being_written
from labkit.session.session import Session
from labkit.session.verify import verify
from labkit.storage.files import kept_secret
from labkit.storage.reading import read_text
from tests.plans import PORTRAIT, plan_text
from tests.results_samples import full_results

pytestmark = pytest.mark.timeout(30)  # a pipe that is read takes for ever

KINDS = ("pipe", "device", "folder", "endless", "link")
SPARSE_BYTES = 2**36
"""Of a file without content: 64 GB of zeros, which no disk holds."""


def put(kind: str, path: Path) -> None:
    """Put something strange in the place of a file; what was there lies beside."""
    beside = path.with_name(f"{path.name}.whole")
    if path.exists():
        path.rename(beside)
    else:
        beside.touch()
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "link":
            path.symlink_to(beside)
        case "hard link":
            path.hardlink_to(beside)
        case "endless":
            path.touch()
            os.truncate(path, SPARSE_BYTES)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session of one photograph, with a target's picture and with results over the field."""
    folder = tmp_path / "night"
    (tmp_path / "a.dng").write_bytes(b"photograph")
    (tmp_path / "print.pgm").write_bytes(b"P5 2 2 255\n\x00\xff\xff\x00")
    picture = {"target": {"kind": "image", "order": None, "file": "print.pgm"}}
    with Session.create(folder, plan_text(PORTRAIT, picture), tmp_path) as made:
        made.add_frame(tmp_path / "a.dng", "a.dng", "target", 3000.0)
    full_results().write(folder / "results" / "latest")
    return folder


def first_line(error: LabkitError) -> str:
    words = str(error)
    assert words.isprintable()
    assert len(words) < 600
    return words


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(LabkitError) as caught:
        call()
    return first_line(caught.value)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["results.json", "residuals.npz", "field.npz"])
def test_results_are_files_of_a_sensible_size(session: Path, name: str, kind: str) -> None:
    put(kind, session / "results/latest" / name)
    words = refusal(lambda: Results.load(session))
    assert str(session / "results/latest" / name) in words
    assert "put the file" in words or "fit the session again" in words
    assert kept_keys(session / "results/latest") == set() or name != "results.json"


@pytest.mark.parametrize("kind", KINDS)
def test_a_strange_file_of_results_hangs_no_command(
    session: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    put(kind, session / "results/latest/results.json")
    for command in ("report", "restore", "compare", "edges"):
        again = [str(session)] * (2 if command == "compare" else 1)
        assert run([command, *again]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert run(["list", str(session.parent)]) == 0
    assert "night is left out" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "endless"])
def test_what_lies_in_the_place_of_results_is_set_aside(tmp_path: Path, kind: str) -> None:
    put(kind, tmp_path / "results.json")
    aside = set_aside_corrupt(tmp_path)
    assert aside == tmp_path / "results.json.corrupt"
    assert not os.path.lexists(tmp_path / "results.json")


@pytest.mark.parametrize("kind", KINDS)
def test_a_journal_is_a_file_of_a_sensible_size(session: Path, kind: str) -> None:
    put(kind, session / JOURNAL)
    words = refusal(lambda: Session.open(session))
    assert words.startswith(f"{session / JOURNAL}: ")
    assert str(session) in refusal(lambda: Session.append(session))
    assert not is_being_written(session / JOURNAL)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "endless", "link"])
@pytest.mark.parametrize("name", ["plan.toml", "print.pgm", "frames/a.dng"])
def test_files_with_checksums_are_files_of_a_sensible_size(
    session: Path, name: str, kind: str
) -> None:
    put(kind, session / name)
    (words,) = [line for line in verify(session) if str(session / name) + ":" in line]
    assert words.isprintable()
    assert "missing" not in words


def test_a_lock_and_a_journal_are_written_under_one_name_alone(session: Path) -> None:
    before = (session / JOURNAL).read_bytes()
    put("hard link", session / JOURNAL)
    words = refusal(lambda: Session.append(session))
    assert f"cannot write {session / JOURNAL}: it has a second name" in words
    assert (session / JOURNAL).read_bytes() == before
    (session / "mine").write_text("mine")
    (session / "results/.latest.fitting").hardlink_to(session / "mine")
    with pytest.raises(InputError, match="it has a second name"):
        fitted_alone(session / "results/latest").__enter__()
    assert (session / "mine").read_text() == "mine"


@pytest.mark.parametrize("kind", KINDS)
def test_a_lock_is_a_file(tmp_path: Path, kind: str) -> None:
    if kind == "endless":
        pytest.skip("a lock is emptied, whatever its size")
    put(kind, tmp_path / ".latest.fitting")
    words = refusal(lambda: fitted_alone(tmp_path / "latest").__enter__())
    assert f"cannot write {tmp_path / '.latest.fitting'}: " in words


def named(task: str) -> str:
    return task


def in_turn(function: Callable[[str], str], tasks: list[str]) -> Iterator[tuple[int, str]]:
    yield from enumerate(map(function, tasks))


@pytest.mark.parametrize("kind", KINDS)
def test_a_kept_fit_is_a_file_of_a_sensible_size(tmp_path: Path, kind: str) -> None:
    list(KeptFits(in_turn, tmp_path / "f")(named, ["a"]))  # type: ignore[arg-type]
    (file,) = (tmp_path / "f").iterdir()
    put(kind, file)
    kept = KeptFits(in_turn, tmp_path / "f")  # type: ignore[arg-type]
    assert list(kept(named, ["a"])) == [(0, "a")]
    assert [finding.code for finding in kept.findings] == ["kept-fits-refused"]


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_a_targets_picture_is_named_as_what_it_is(tmp_path: Path, kind: str) -> None:
    put(kind, tmp_path / "print.pgm")
    picture = {"target": {"kind": "image", "order": None, "file": "print.pgm"}}
    words = refusal(lambda: Plan.parse(plan_text(PORTRAIT, picture), tmp_path))
    assert "a folder, a pipe or a device" in words


@pytest.mark.parametrize("kind", KINDS)
def test_a_secret_is_a_file_of_a_sensible_size(tmp_path: Path, kind: str) -> None:
    put(kind, tmp_path / "secret")
    assert len(kept_secret(tmp_path / "secret")) > 20


PLAN = Plan.parse(plan_text(PORTRAIT))
GIVEN: dict[str, Callable[[Path], object]] = {
    "plan": Plan.load,
    "list": lambda path: read_rows(path, PLAN),
    "photograph": lambda path: read_photograph(path, PLAN.sensor),
    "headerless": lambda path: read_photograph(
        path, PLAN.sensor.model_copy(update={"headerless_px": (2, 2)})
    ),
    "picture": read_picture,
    "exif": read_exif,
    "frame": lambda path: add(path),
}


def add(path: Path) -> None:
    with Session.create(path.parent / "new", plan_text(PORTRAIT), path.parent) as made:
        made.add_frame(path, "a.dng", "target", 3000.0)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "endless"])
@pytest.mark.parametrize("name", GIVEN)
def test_a_file_that_the_user_names_is_a_file_of_a_sensible_size(
    tmp_path: Path, name: str, kind: str
) -> None:
    put(kind, tmp_path / "given")
    with pytest.raises((LabkitError, OSError)) as caught:
        GIVEN[name](tmp_path / "given")
    words = str(caught.value)
    assert "file is needed" in words or "at most" in words or "is a folder" in words


def test_a_file_that_the_user_names_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(plan_text(PORTRAIT))
    np.arange(4, dtype="<u2").tofile(tmp_path / "mine.raw")
    for name in ("mine.toml", "mine.raw"):
        (tmp_path / f"link-{name}").symlink_to(tmp_path / name)
    assert Plan.load(tmp_path / "link-mine.toml") == PLAN
    assert read_text(tmp_path / "link-mine.toml", 2**20, follow_link=True)
    add(tmp_path / "link-mine.raw")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "endless"])
def test_a_table_of_modes_is_a_file_of_a_sensible_size(tmp_path: Path, kind: str) -> None:
    put(kind, tmp_path / "table.csv")
    with pytest.raises(ValueError, match=r"cannot be read: (\d+ bytes long|a )"):
        read_table(str(tmp_path / "table.csv"))


@pytest.mark.parametrize("kind", KINDS)
def test_the_tab_key_waits_for_no_strange_plan(session: Path, kind: str) -> None:
    put(kind, session / "plan.toml")

    given = SimpleNamespace(params={"session": str(session)})
    assert channels(given, "") == ["B", "G", "R"]  # type: ignore[arg-type]


def test_a_note_of_a_lock_that_somebody_made_is_no_message(tmp_path: Path) -> None:
    lock = tmp_path / ".latest.fitting"
    for strange in ("[" * 60_000, json.dumps({"process": "x", "machine": 1, "since": []})):
        with fitted_alone(tmp_path / "latest"):
            lock.write_text(strange)
            words = refusal(lambda: fitted_alone(tmp_path / "latest").__enter__())
        assert "is being fitted by another process: wait for it" in words
