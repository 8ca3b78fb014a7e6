"""The session folder: commits, crashes, locks, verification."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar
from unittest.mock import Mock
from xml.etree import ElementTree

import pytest

from labkit.errors import InputError, PlanError, SessionError
from labkit.session.journal import JournalWriter
from labkit.session.session import Session, begin
from labkit.session.verify import remarks, verify
from tests.plans import PORTRAIT, plan_text

P = ParamSpec("P")
R = TypeVar("R")

PLAN = plan_text(PORTRAIT, {"target": {"order": 5, "size_mm": 46.8}})


class PowerCutError(BaseException):
    """Stands for the plug being pulled."""


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "photo.dng"
    path.write_bytes(bytes(range(256)) * 8)
    return path


@pytest.fixture
def session_folder(tmp_path: Path, photo: Path) -> Path:
    folder = tmp_path / "session"
    with Session.create(folder, PLAN, tmp_path) as session:
        session.add_frame(photo, "dark_0.dng", "dark", None, exposure_s=0.5, iso=100)
        session.add_frame(photo, "target_0.dng", "target", 3000.0)
    return folder


def test_a_session_reads_back_what_was_added(session_folder: Path, photo: Path) -> None:
    dark, target = Session.open(session_folder).frames
    assert (dark.kind, dark.range_mm, dark.exposure_s, dict(dark.meta)) == (
        "dark",
        None,
        0.5,
        {"iso": 100},
    )
    assert (target.kind, target.range_mm, target.exposure_s) == ("target", 3000.0, None)
    assert target.path.read_bytes() == photo.read_bytes()
    assert verify(Session.open(session_folder)) == []


def test_the_plan_is_stored_as_it_was_written(session_folder: Path) -> None:
    assert (session_folder / "plan.toml").read_text() == PLAN


def test_a_wrong_plan_makes_no_folder(tmp_path: Path) -> None:
    with pytest.raises(PlanError):
        Session.create(tmp_path / "new" / "session", PLAN.replace("2.8", "0"), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_session_is_not_made_over_something_else(
    session_folder: Path, tmp_path: Path
) -> None:
    with pytest.raises(SessionError, match="is there already"):
        Session.create(session_folder, PLAN, tmp_path)


def test_a_session_is_not_made_inside_a_file(photo: Path, tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"photo\.dng is no folder"):
        Session.create(photo / "deep" / "session", PLAN, tmp_path)


def test_a_frame_is_never_overwritten(session_folder: Path, photo: Path) -> None:
    with (
        Session.append(session_folder) as session,
        pytest.raises(SessionError, match="never overwritten"),
    ):
        session.add_frame(photo, "dark_0.dng", "dark", None)


@pytest.mark.parametrize(
    "name", ["../escape.dng", "a/b.dng", "", ".hidden", "x\n.dng", "x" * 300]
)
def test_an_unsafe_name_is_refused(session_folder: Path, photo: Path, name: str) -> None:
    with (
        Session.append(session_folder) as session,
        pytest.raises(SessionError, match="allowed is letters"),
    ):
        session.add_frame(photo, name, "dark", None)


def test_a_session_cannot_be_opened_twice_for_writing(session_folder: Path) -> None:
    with (
        Session.append(session_folder),
        pytest.raises(SessionError, match="another process"),
    ):
        Session.append(session_folder)
    Session.append(session_folder).close()


def test_reading_goes_on_while_another_writes(session_folder: Path) -> None:
    with Session.append(session_folder):
        assert len(Session.open(session_folder).frames) == 2


def test_a_session_open_to_read_takes_no_frame(session_folder: Path, photo: Path) -> None:
    with pytest.raises(SessionError, match="read only"):
        Session.open(session_folder).add_frame(photo, "more.dng", "dark", None)


@pytest.mark.parametrize("kept", [1, 40, -1])
def test_a_torn_last_line_is_dropped_with_a_warning(
    session_folder: Path, kept: int
) -> None:
    journal = session_folder / "journal.jsonl"
    *whole, last = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(whole) + last[:kept])
    assert [frame.file for frame in Session.open(session_folder).frames] == ["dark_0.dng"]
    assert "torn" in Session.open(session_folder).warnings[0]
    assert verify(Session.open(session_folder)) == []
    with Session.append(session_folder) as session:
        assert "torn" in session.warnings[0]
    mended = Session.open(session_folder)
    assert mended.warnings == ()
    # the torn line committed a photograph that lay whole in frames/
    assert [frame.file for frame in mended.frames] == ["dark_0.dng", "target_0.dng"]
    assert verify(mended) == []


def test_every_journal_line_is_json_that_names_its_event_and_time(
    session_folder: Path,
) -> None:
    lines = [
        json.loads(line)
        for line in (session_folder / "journal.jsonl").read_text().splitlines()
    ]
    assert [line["event"] for line in lines] == [
        "created",
        "adding",
        "frame",
        "adding",
        "frame",
    ]
    assert all({"time", "check"} <= line.keys() for line in lines)


def test_verify_names_altered_missing_and_stray_files(session_folder: Path) -> None:
    frames = session_folder / "frames"
    (frames / "dark_0.dng").write_bytes(b"altered")
    (frames / "target_0.dng").unlink()
    (frames / "stray.dng").write_bytes(b"?")
    (session_folder / "plan.toml").write_text(PLAN + "# later\n")
    problems = "\n".join(verify(Session.open(session_folder)))
    for words in (
        "dark_0.dng: does not fit",
        "target_0.dng: missing",
        "stray.dng: not in",
        "plan.toml: does not fit",
    ):
        assert words in problems


def test_a_plan_that_was_altered_in_its_session_is_not_used(session_folder: Path) -> None:
    (session_folder / "plan.toml").write_text(PLAN.replace("2.8", "2.9"))
    for session in (Session.open(session_folder), Session.append(session_folder)):
        with (
            session,
            pytest.raises(
                SessionError,
                match=r"plan\.toml: does not fit .* restore it, or .* --plan OTHER\.toml",
            ),
        ):
            _ = session.plan
        assert len(session.frames) == 2
    (session_folder / "plan.toml").write_text(PLAN)
    assert Session.open(session_folder).plan.lens.f_number == 2.8


def test_folders_may_be_given_as_text(tmp_path: Path, photo: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    folder = str(tmp_path / "text")
    with Session.create(folder, PLAN, str(tmp_path)) as session:
        session.add_frame(photo, "dark_0.dng", "dark", None)
    for way in (Session.open, Session.append):
        with way(folder) as session:
            assert session.folder == tmp_path / "text"
    begin(str(tmp_path / "plan.toml"), folder, resume=True).close()


def test_a_session_shows_what_is_in_it(session_folder: Path, photo: Path) -> None:
    assert (
        repr(Session.open(session_folder))
        == f"<Session {session_folder}: 1 target, 1 dark; at 3000 mm>"
    )
    with Session.append(session_folder) as session:
        for range_mm in range(2000, 2700, 100):
            session.add_frame(photo, f"flat_{range_mm}.dng", "flat", range_mm)
        assert "1 target, 7 flat, 1 dark; at 8 ranges, 2000 to 3000 mm" in repr(session)
        table = ElementTree.fromstring(session._repr_html_())
    cells = [[cell.text for cell in row] for row in table.iter("tr")]
    assert cells[0] == ["range", "target", "flat", "dark"]
    assert cells[1] == ["none", None, None, "1"]
    assert cells[-1] == ["3000 mm", "1", None, None]


def test_what_a_killed_capture_left_is_remarked_upon_and_removed_by_the_next(
    session_folder: Path,
) -> None:
    (session_folder / ".exposing").mkdir()
    for name in (".exposing/target_1.dng", ".incoming", ".plan.toml.123.part"):
        (session_folder / name).write_bytes(b"half")
    session = Session.open(session_folder)
    assert verify(session) == []
    assert [remark.split(":")[0].rsplit("/")[-1] for remark in remarks(session)] == [
        ".exposing",
        ".incoming",
        ".plan.toml.123.part",
    ]
    with Session.append(session_folder):
        assert sorted(path.name for path in session_folder.iterdir()) == [
            "frames",
            "journal.jsonl",
            "plan.toml",
        ]


def test_a_folder_that_is_no_session_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="is no session"):
        Session.open(tmp_path)


@pytest.mark.parametrize(
    "where", ["pattern.pgm", "../patterns/my pattern.pgm", "{}/patterns/plan.toml"]
)
def test_a_session_carries_its_target_picture_with_it(tmp_path: Path, where: str) -> None:
    where = where.format(tmp_path)
    (tmp_path / "plans").mkdir()
    (tmp_path / "patterns").mkdir()
    picture = (tmp_path / "plans" / where).resolve()
    picture.write_bytes(b"P5 1 1 255\n\x80")
    text = PLAN.replace(
        '"sierpinski"', f'"image"  # "a print"\nfile = "{where}"  # it\'s the lab\'s'
    )
    Session.create(tmp_path / "session", text, tmp_path / "plans").close()
    (tmp_path / "session").rename(tmp_path / "elsewhere")
    picture.unlink()
    session = Session.open(tmp_path / "elsewhere")
    assert session.plan.target.file is not None
    assert session.plan.target.file.parent == tmp_path / "elsewhere"
    assert session.plan.target.file.read_bytes() == b"P5 1 1 255\n\x80"
    assert "it's the lab's" in (session.folder / "plan.toml").read_text()
    assert verify(session) == []


@pytest.mark.parametrize("step", range(8))
def test_a_power_cut_at_any_step_loses_no_committed_frame(
    session_folder: Path, photo: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    cuts = iter(range(100))

    def cut_before(call: Callable[P, R]) -> Callable[P, R]:
        def cut(*args: P.args, **kwargs: P.kwargs) -> R:
            if next(cuts) == step:
                raise PowerCutError
            return call(*args, **kwargs)

        return cut

    session = Session.append(session_folder)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", cut_before(os.fsync))
        patch.setattr(Path, "rename", cut_before(Path.rename))
        try:
            session.add_frame(photo, "next.dng", "flat", 3000.0)
            committed = True
        except PowerCutError:
            committed = False
    session.close()
    assert verify(Session.open(session_folder)) == []
    with Session.append(session_folder) as resumed:
        names = [frame.file for frame in resumed.frames]
        assert names[:2] == ["dark_0.dng", "target_0.dng"]
        assert ("next.dng" in names) or not committed
        if "next.dng" not in names:
            resumed.add_frame(photo, "next.dng", "flat", 3000.0)
    assert verify(Session.open(session_folder)) == []
    assert sorted(path.name for path in (session_folder / "frames").iterdir()) == sorted(
        frame.file for frame in Session.open(session_folder).frames
    )


def test_capture_goes_on_with_the_same_plan_only(
    session_folder: Path, tmp_path: Path
) -> None:
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(PLAN + "# a comment changes nothing\n")
    with begin(plan_path, session_folder, resume=True) as session:
        assert len(session.frames) == 2
    plan_path.write_text(PLAN.replace("46.8", "23.4"))
    with pytest.raises(PlanError, match=r"differs in \[target\]"):
        begin(plan_path, session_folder, resume=True)
    Session.append(session_folder).close()


def test_a_change_of_plan_that_a_crash_cut_short_is_taken_up_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan_path, folder = tmp_path / "plan.toml", tmp_path / "new"
    plan_path.write_text(PLAN)
    begin(plan_path, folder, resume=False).close()
    plan_path.write_text(PLAN.replace("46.8", "23.4"))
    with monkeypatch.context() as crashing:
        crashing.setattr(JournalWriter, "append", Mock(side_effect=PowerCutError))
        with pytest.raises(PowerCutError):
            begin(plan_path, folder, resume=True)
    assert verify(Session.open(folder)) != []
    with begin(plan_path, folder, resume=True) as session:
        assert session.plan.target.size_mm == 23.4
    assert verify(Session.open(folder)) == []


def test_resuming_what_never_began_begins_it(tmp_path: Path) -> None:
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(PLAN)
    with begin(plan_path, tmp_path / "new", resume=True) as session:
        assert session.frames == ()


def test_a_session_is_made_where_a_link_to_an_empty_folder_is(tmp_path: Path) -> None:
    (tmp_path / "disk" / "night").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "disk" / "night")
    with Session.create(tmp_path / "link", PLAN, tmp_path) as session:
        session.log("began")
    assert (tmp_path / "link").is_symlink()
    assert [
        event["event"] for event in Session.open(tmp_path / "disk" / "night").events
    ] == ["created", "began"]


def test_a_session_in_the_place_of_the_folder_one_is_in_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        SessionError, match=r"^\. is the folder you are in, .*: give the name of a new one"
    ):
        Session.create(".", PLAN, tmp_path)


def test_who_is_slower_in_making_a_session_is_told(
    session_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def overtaken(plan: object, text: str, beside: Path, taken: object) -> dict[str, str]:
        Session.open(session_folder).folder.rename(tmp_path / "new")
        return {"plan_sha256": ""}

    monkeypatch.setattr("labkit.session.session.store_plan", overtaken)
    with pytest.raises(SessionError, match=r"new is there already: give a new folder$"):
        Session.create(tmp_path / "new", PLAN, tmp_path)
    assert len(Session.open(tmp_path / "new").frames) == 2
    assert list(tmp_path.glob(".*")) == []


def test_half_made_sessions_are_removed_unless_a_process_is_at_work_on_them(
    session_folder: Path, tmp_path: Path
) -> None:
    ended = subprocess.Popen(["true"])
    ended.wait()
    gone, held, ours = (
        tmp_path / f".s.{pid}.import"
        for pid in (ended.pid, f"{ended.pid:09d}", os.getpid())
    )
    for folder in (gone, held, ours):
        shutil.copytree(session_folder, folder)
    with Session.append(held):  # as by a process of another machine
        Session.create(tmp_path / "other", PLAN, tmp_path).close()
    assert [folder.exists() for folder in (gone, held, ours)] == [False, True, True]


def test_the_lock_of_a_session_that_a_process_of_this_machine_makes_is_not_touched(
    session_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = session_folder.rename(
        tmp_path / f".s.{os.getpid()}.new"
    )  # it may be about to take it
    asked = list[object]()
    monkeypatch.setattr("labkit.session.making.is_being_written", asked.append)
    Session.create(tmp_path / "other", PLAN, tmp_path).close()
    assert made.exists()
    assert not asked


def test_a_folder_inside_a_session_is_answered_with_the_session(
    session_folder: Path,
) -> None:
    with pytest.raises(
        SessionError,
        match=rf"frames is no session: it has no journal.jsonl; give {session_folder}$",
    ):
        Session.open(session_folder / "frames")


def test_a_read_only_disk_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session.create(tmp_path / "night", plan_text(PORTRAIT), tmp_path)
    there = os.statvfs(tmp_path)
    values = [*there[:8], there.f_flag | os.ST_RDONLY, there.f_namemax]
    monkeypatch.setattr(os, "statvfs", lambda path: os.statvfs_result(values))
    with session, pytest.raises(InputError, match=r"latest: .*that is a read-only disk"):
        session.results_folder()
