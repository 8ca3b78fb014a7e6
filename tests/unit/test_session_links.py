"""Symbolic links in a session: nothing behind them is changed, and `verify` names them."""

from __future__ import annotations

from pathlib import Path

import pytest

from labkit.cli import run
from labkit.errors import SessionError
from labkit.results import Results
from labkit.results.storage import RESULTS_FILE
from labkit.session.journal import JOURNAL
from labkit.session.session import Session, begin
from labkit.session.verify import verify
from tests.plans import PORTRAIT, plan_text
from tests.results_samples import some_results

PICTURES = ("holiday.png", "drawing.svg")


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder of somebody's pictures."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name in PICTURES:
        (folder / name).write_text(name)
    return folder


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session of one photograph, with results."""
    folder, photo = tmp_path / "night", tmp_path / "a.dng"
    photo.write_bytes(b"photograph")
    with Session.create(folder, plan_text(PORTRAIT), tmp_path) as made:
        made.add_frame(photo, "a.dng", "target", 3000.0)
    some_results().write(folder / "results" / "latest")
    return folder


def linked(path: Path, to: Path) -> Path:
    if path.exists():
        path.rename(path.with_name(f"{path.name}-before"))
    path.symlink_to(to)
    return path


@pytest.mark.parametrize(
    "name",
    ["results", "results/latest", "results/latest/figures", "results/latest/.fits"],
)
def test_a_report_removes_and_writes_nothing_behind_a_link(
    session: Path, elsewhere: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    linked(session / name, elsewhere)
    assert run(["report", str(session)]) == 2
    assert f"{session / name}: a link to {elsewhere}; put" in capsys.readouterr().err
    assert sorted(path.name for path in elsewhere.iterdir()) == sorted(PICTURES)
    assert run(["verify", str(session)]) != 0
    assert f"{session / name}: a link to" in capsys.readouterr().err


def test_figures_that_are_a_link_are_neither_followed_by_python(
    session: Path, elsewhere: Path
) -> None:
    from labkit.report.html import write_report

    results = Results.load(session)
    linked(session / "results/latest/figures", elsewhere)
    with pytest.raises(SessionError, match="figures: a link to"):
        write_report(results)
    results.write(session / "results/latest")  # new results have no figures yet
    assert not (session / "results/latest/figures").is_symlink()
    assert sorted(path.name for path in elsewhere.iterdir()) == sorted(PICTURES)


@pytest.mark.parametrize(
    "name", ["results", "results/latest", f"results/latest/{RESULTS_FILE}"]
)
def test_results_behind_a_link_are_not_read(
    session: Path, tmp_path: Path, name: str
) -> None:
    away = tmp_path / "away"
    (session / name).rename(away)
    (session / name).symlink_to(away)
    with pytest.raises(SessionError, match="a link to"):
        Results.load(session)


@pytest.mark.parametrize("name", ["../../other/results/latest", "..", ".", "/tmp", "a/b"])
def test_a_report_of_another_folder_is_refused(
    session: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("report", "restore"):
        assert run([command, str(session), "--name", name]) == 2
        assert "allowed is letters" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", [".exposing", ".incoming", "frames", "frames/a.dng", JOURNAL]
)
def test_a_session_with_links_takes_no_photograph(
    session: Path, tmp_path: Path, name: str
) -> None:
    elsewhere = tmp_path / "elsewhere"
    if (session / name).exists():
        (session / name).rename(elsewhere)
    else:
        elsewhere.mkdir()
    (session / name).symlink_to(elsewhere)
    with pytest.raises(SessionError, match="a link to"):
        begin(session / "plan.toml", session, resume=True)
    if name != JOURNAL:
        named = [line for line in verify(Session.open(session)) if "a link to" in line]
        assert len(named) == 1


def test_a_photograph_on_its_way_replaces_a_link(session: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    with Session.append(session) as opened:
        (session / ".incoming").symlink_to(tmp_path / "mine")
        opened.add_frame(tmp_path / "a.dng", "b.dng", "target", 3000.0)
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_session_may_itself_lie_behind_a_link(session: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(session)
    assert verify(Session.open(tmp_path / "link")) == []
    Session.append(tmp_path / "link").close()
    assert Results.load(tmp_path / "link").wavefronts
