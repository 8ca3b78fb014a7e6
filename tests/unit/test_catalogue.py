"""The catalogue follows the folders, survives damage, and finds a lens's sessions again."""

from __future__ import annotations

import json
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from labkit.catalogue import entry as entry_module
from labkit.catalogue import store
from labkit.catalogue.compare import Difference
from labkit.catalogue.history import history_of
from labkit.catalogue.pictures import history_picture
from labkit.catalogue.sessions import compare_sessions, lens_history, list_sessions
from labkit.catalogue.store import catalogue_file
from labkit.cli import run
from labkit.cli.catalogue import _difference_row
from labkit.errors import DataError, InputError
from labkit.photographs.exif import Exif
from labkit.session.session import Session
from labkit.uncertain import Uncertain
from tests.results_samples import PLAN, some_results

APO = {"name": "Apo 70", "serial": "0042"}


def a_session(folder: Path, name: str, lens: dict[str, str] = APO, **changed: Any) -> Path:
    """A session with results and one file in the place of a photograph."""
    plan = PLAN.replace(lens=lens)
    photograph = folder / "any.dng"
    photograph.write_bytes(b"no photograph")
    with Session.create(folder / name, plan.to_toml(), folder) as session:
        session.add_frame(photograph, "a.dng", "target", 3000.0)
    some_results(plan=plan, **changed).write(folder / name / "results" / "latest")
    return folder / name


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    a_session(tmp_path, "night-1")
    a_session(tmp_path, "night-2")
    return tmp_path


def names(folder: Path) -> list[str]:
    return [entry.folder for entry in list_sessions(folder).entries]


def forbid_reading(patch: pytest.MonkeyPatch) -> None:
    def read(session: Path, name: str) -> None:
        raise AssertionError(f"{session} was read again")

    patch.setattr(store, "read_entry", read)


def test_an_entry_holds_what_the_session_measured(folder: Path) -> None:
    entry = list_sessions(folder).entries[0]
    assert (entry.folder, entry.name, entry.lens_label) == (
        "night-1",
        "latest",
        "Apo 70 0042",
    )
    assert str(entry.numbers["best_focus_mm", "R"]) == "2986.84 ± 0.42 mm"
    assert str(entry.numbers["waves.8", "B"]) == "-0.0400 ± 0.0013 waves"
    assert entry.numbers["f_number", ""].value == 2.874
    assert entry.taken
    assert entry.problem == ""


def test_what_the_plan_leaves_out_is_taken_from_the_photograph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exif = Exif(camera="Z 8", camera_serial="7", lens="Nikkor", taken="2026:11:22 09:08:07")
    monkeypatch.setattr("labkit.photographs.exif.read_exif", lambda path: exif)
    session = a_session(tmp_path, "night", lens={"serial": "99"})
    entry = entry_module.read_entry(session, "latest")
    assert (entry.lens_label, entry.camera, entry.taken) == (
        "Nikkor 99",
        "Z 8 7",
        "2026-11-22T09:08:07",
    )


def test_a_session_is_read_again_only_if_its_results_changed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = list_sessions(folder)
    with monkeypatch.context() as patch:
        forbid_reading(patch)
        assert list_sessions(folder) == before
    os.utime(folder / "night-1" / "results" / "latest" / "results.json", (1, 1))
    with monkeypatch.context() as patch:
        forbid_reading(patch)
        with pytest.raises(AssertionError, match="night-1 was read again"):
            list_sessions(folder)


def test_the_catalogue_follows_the_folders(folder: Path) -> None:
    assert names(folder) == ["night-1", "night-2"]
    (folder / "night-1").rename(folder / "night-0")
    Session.create(folder / "night-3", PLAN.to_toml(), folder).close()
    entries = list_sessions(folder).entries
    assert [(entry.folder, entry.state) for entry in entries][::2] == [
        ("night-0", entries[1].state),
        ("night-3", "not fitted"),
    ]


def edit(session: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    file = session / "results" / "latest" / "results.json"
    held = json.loads(file.read_text())
    change(held)
    file.write_text(json.dumps(held))


def test_results_that_cannot_be_read_are_named_and_left_out(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(folder / "night-1", lambda held: held.update(schema=4))
    (folder / "night-2" / "results" / "latest" / "results.json").write_text("{")
    assert run(["list", str(folder)]) == 0
    printed = capsys.readouterr()
    assert "night-1 is left out" in printed.err
    assert "has schema 4, of a newer labkit" in printed.err
    assert "night-2 is left out" in printed.err
    assert "night" not in printed.out.replace(str(folder), "")


def whole(file: Path) -> Any:
    return json.loads(file.read_text())


ODD: dict[str, Callable[[Path], object]] = {
    "no JSON": lambda file: file.write_bytes(b"no JSON at all" * 40),
    "empty": lambda file: file.write_bytes(b""),
    "torn": lambda file: file.write_bytes(file.read_bytes()[:500]),
    "deep": lambda file: file.write_bytes(b"[" * 100_000),
    "a database": lambda file: file.write_bytes(b"SQLite format 3\0" * 300),
    "of another version": lambda file: changed(file, lambda held: held.update(labkit="0")),
    "a text as a number": lambda file: changed(file, with_number("2987")),
    "no number": lambda file: changed(file, with_number(None)),
    "infinite": lambda file: changed(file, with_number(float("inf"))),
    "a number as a text": lambda file: changed(file, with_lens(7)),
    "a list as a text": lambda file: changed(file, with_lens(["Apo"])),
    "another number": lambda file: changed(file, with_quantity("waves.x")),
    "less": lambda file: changed(file, lambda held: held["entries"][0][1].pop("state")),
    "a link": lambda file: file.symlink_to(file.rename(file.with_name("other"))),
    "read by others": lambda file: file.chmod(0o644),
    "endless": lambda file: os.truncate(file, 2**36),
    "a pipe": lambda file: os.mkfifo(
        file.rename(file.with_name("other")).with_name(file.name)
    ),
}
"""What may have happened to the catalogue's file."""


def changed(file: Path, change: Callable[[Any], object]) -> None:
    held = whole(file)
    change(held)
    file.write_text(json.dumps(held))


def with_number(value: object) -> Callable[[Any], object]:
    return lambda held: held["entries"][0][1]["numbers"][0].__setitem__(2, value)


def with_quantity(name: str) -> Callable[[Any], object]:
    return lambda held: held["entries"][0][1]["numbers"][0].__setitem__(0, name)


def with_lens(value: object) -> Callable[[Any], object]:
    return lambda held: held["entries"][0][1].update(lens=value)


@pytest.mark.timeout(30)
@pytest.mark.parametrize("name", ODD)
def test_a_catalogue_that_is_odd_is_built_anew(folder: Path, name: str) -> None:
    before = list_sessions(folder)
    file = catalogue_file(folder)
    ODD[name](file)
    assert list_sessions(folder) == before
    assert len(whole(file)["entries"]) == 2
    assert not file.is_symlink()


def test_a_catalogue_is_this_users_alone_and_lies_with_the_user(folder: Path) -> None:
    list_sessions(folder)
    file = catalogue_file(folder)
    assert file.is_relative_to(os.environ["XDG_STATE_HOME"])
    assert file.stat().st_mode & 0o077 == 0
    assert sorted(path.name for path in folder.iterdir()) == [
        "any.dng",
        "night-1",
        "night-2",
    ]
    (folder.parent / "link").symlink_to(folder)
    assert catalogue_file(folder.parent / "link") == file


ENDLESS = """
    CREATE VIEW results AS WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n)
    SELECT k AS folder, k AS name, k AS stamp, k AS state, k AS problem, k AS lens, k AS serial,
    k AS camera, k AS taken, k AS created FROM n
"""


@pytest.mark.timeout(30)
@pytest.mark.parametrize("place", ["a file", "a link"])
def test_a_catalogue_that_came_with_the_sessions_is_not_opened(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, place: str
) -> None:
    before = list_sessions(folder)
    catalogue_file(folder).unlink()
    stranger = tmp_path_factory.mktemp("other") / "of-another-program.sqlite"
    with closing(sqlite3.connect(stranger)) as database:
        database.execute(ENDLESS)
        database.execute("PRAGMA user_version = 1")
    content = stranger.read_bytes()
    beside = folder / "catalogue.sqlite"
    if place == "a file":
        beside.write_bytes(content)
    else:
        beside.symlink_to(stranger)
    assert list_sessions(folder) == before
    assert beside.read_bytes() == stranger.read_bytes() == content


def test_sessions_with_strange_names_are_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (b"\xff\xfe", b"\x1b[31mred", b"\xe2\x80\xaedrawkcab"):
        (folder / "night-1").rename(folder / os.fsdecode(name))
        before = list_sessions(folder)
        assert os.fsdecode(name) in [entry.folder for entry in before.entries]
        with monkeypatch.context() as patch:
            forbid_reading(patch)
            assert list_sessions(folder) == before
        (folder / os.fsdecode(name)).rename(folder / "night-1")


def test_what_cannot_be_read_is_tried_again(folder: Path) -> None:
    results = folder / "night-1" / "results" / "latest" / "results.json"
    text = results.read_bytes()
    stamp = results.stat()
    results.write_bytes(b"{" * len(text))
    os.utime(results, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert list_sessions(folder).entries[0].problem
    results.write_bytes(text)
    os.utime(results, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert list_sessions(folder).entries[0].problem == ""


def test_without_a_place_to_keep_it_sessions_are_listed_all_the_same(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "state").touch()  # for root too, nothing can be written there
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert run(["list", str(folder)]) == 0
    printed = capsys.readouterr()
    assert "night-2" in printed.out
    assert "all sessions were read anew, and nothing is kept" in printed.err
    assert printed.err.count("\n") == 1
    assert run(["catalogue", "rebuild", str(folder)]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_user_without_a_home_has_no_catalogue(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(store, "state_folder", homeless)
    found = list_sessions(folder)
    assert len(found.entries) == 2
    assert "no place to keep the catalogue in" in found.warnings[0]


def test_a_list_of_sessions_ends_when_it_is_told_to(folder: Path) -> None:
    """The reading of a session takes for ever here."""
    program = (
        "import labkit.catalogue.store as store, threading\n"
        "store.read_entry = lambda *_: print('reading', flush=True) or threading.Event().wait()\n"
        "from labkit.cli import main; import sys\n"
        "sys.argv[1:] = ['list', sys.argv[1]]; main()"
    )
    command = [sys.executable, "-c", program, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"reading\n"
        process.terminate()
        assert process.wait(30) == 130


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give the folder that the sessions are in"):
        list_sessions(tmp_path / "nowhere")


def test_a_lens_has_its_sessions_in_the_order_of_their_time(folder: Path) -> None:
    a_session(folder, "after", lens={"name": "Apo 70", "serial": "0043"})
    history = lens_history("0042", folder=folder)
    assert (history.lens, history.channel) == ("Apo 70 0042", "R")
    assert [entry.folder for entry in history.entries] == ["night-1", "night-2"]
    assert history.modes == (5, 8)
    assert history_picture(history).startswith(b"<?xml")


def test_a_lens_or_channel_that_is_not_clear_is_asked_for_again(folder: Path) -> None:
    a_session(folder, "after", lens={"name": "Apo 70", "serial": "0043"})
    entries = list_sessions(folder).entries
    both = "several lenses are called so; give one of: Apo 70 0043, Apo 70 0042"
    with pytest.raises(DataError, match=both):
        history_of(entries, "apo")
    with pytest.raises(DataError, match="no lens with results is called so"):
        history_of(entries, "Planar")
    with pytest.raises(DataError, match="--channel G: sessions of Apo 70 0042 have R, B"):
        history_of(entries, "0042", "G")


def test_the_commands_answer_programs(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(*words: str) -> Any:
        assert run([*words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    listed = answer("list", str(folder))
    assert listed["sessions"][0]["numbers"]["best_focus_mm.R"]["std"] == 0.42
    assert answer("history", "--lens", "0042", str(folder))["sessions"][1]["waves.8"]
    pair = ("compare", str(folder / "night-1"), str(folder / "night-2"))
    (compared,) = answer(*pair)["pairs"]
    assert compared["p_value"] == pytest.approx(1)
    assert {one["name"] for one in compared["differences"]} >= {"waves.R.5", "waves.B.8"}
    assert answer("catalogue", "rebuild", str(folder)) == {
        "schema": 1,
        "results": 2,
        "left_out": 0,
    }


def test_a_small_difference_is_shown_without_a_minus_zero() -> None:
    small = Difference("waves.G.7", 0.1, 0.09996, Uncertain(-0.00004, 0.001), True)
    assert _difference_row(small)[-2:] == ["0.0000 ± 0.0010", "+0.0"]


def test_pictures_are_written_on_request(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "pictures"
    sessions = [str(folder / name) for name in ("night-1", "night-2")]
    assert run(["compare", *sessions, "--out", str(out)]) == 0
    history = ["history", "--lens", "0042", str(folder), "--out", str(out / "h.svg")]
    assert run(history) == 0
    assert sorted(path.name for path in out.iterdir()) == ["h.svg", "night-1-night-2.svg"]
    assert "2 sessions" in capsys.readouterr().out


def test_one_session_is_nothing_to_compare(folder: Path) -> None:
    with pytest.raises(DataError, match="give two sessions or more to compare"):
        compare_sessions(folder / "night-1")


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ("covariance", [[1e-6, 5e-7, 0], [0, 1e-6, 0], [0, 0, 1e-6]]),
        ("lambda_n_um", {"value": 0.0, "std": 0.1}),
        ("std", [0.1]),
        ("noll", [4]),
        ("waves_rms", [1e300] * 3),
        ("poses", []),
    ],
)
def test_a_bad_session_does_not_stop_the_others(
    folder: Path, capsys: pytest.CaptureFixture[str], where: str, value: Any
) -> None:
    a_session(folder, "night-3")
    edit(folder / "night-2", lambda held: held["wavefronts"][0].update({where: value}))
    three = [str(folder / f"night-{k}") for k in (1, 2, 3)]
    for command in (
        ["list"],
        ["history", "--lens", "Apo", str(folder)],
        ["compare", *three],
    ):
        words = command if len(command) > 1 else [*command, str(folder)]
        assert run(words) == 0, command
        printed = capsys.readouterr()
        assert re.search("night-2.* left out: .*results.json is not as", printed.err)
        assert printed.err.count("night-2") == 2  # its name, and the path of its file
        assert "night-1" in printed.out
        assert "night-3" in printed.out
        assert "night-2" not in printed.out
    assert run(["compare", *three[:2]]) == 2
    assert "results.json is not as" in capsys.readouterr().err


def test_numbers_that_break_arithmetic_are_a_sessions_own_problem(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def divide(session: Session, exif: Exif) -> str:
        return str(1 / (session.folder.name != "night-1"))

    monkeypatch.setattr(entry_module, "_taken", divide)
    first, second = list_sessions(folder).entries
    assert first.problem.endswith("ZeroDivisionError: division by zero")
    assert second.problem == ""


def test_a_session_is_compared_with_itself(folder: Path) -> None:
    (pair,) = compare_sessions(folder / "night-1", folder / "night-1")
    assert pair.chi2 == 0


def test_a_folder_whose_name_is_not_utf_8_is_compared_verified_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = a_session(tmp_path, os.fsdecode(b"night-\xff\x1b"))
    other = a_session(tmp_path, "night-2")
    maps = ["--out", str(tmp_path / "maps")]
    for command in (["compare", str(odd), str(other), *maps], ["verify", str(odd)]):
        assert run(command) == 0
        printed = capsys.readouterr()
        assert r"night-\udcff\x1b" in printed.out
        assert all(line.isprintable() for line in (printed.out + printed.err).splitlines())
    assert run(["--json", "report", str(odd)]) == 0
    report = Path(json.loads(capsys.readouterr().out)["report"])
    assert report.is_file()
