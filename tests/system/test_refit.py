"""A session is fitted again: by other modes, by another plan, in part. Nothing whole is lost; each result knows its plan."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from labkit.analysis.fit import fit
from labkit.cli import run
from labkit.errors import DataError, InputError
from labkit.plan import Plan
from labkit.results import Results
from labkit.session.session import Session
from labkit.storage.files import writing

from .conftest import capture_few


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captured once and fitted whole, with few modes, for the tests here to fit again."""
    folder = capture_few(tmp_path_factory.mktemp("refit") / "session", (4, 6))
    fit(folder, workers=1)
    return folder


def test_a_partial_fit_has_a_name_of_its_own_and_leaves_the_whole_one(
    session: Path,
) -> None:
    before = Results.load(session)
    partial = fit(session, ranges_mm=2050.5, workers=1)
    assert partial.folder == session / "results" / "2050.5mm"
    assert len(partial) == 1
    assert len(before) == 2
    assert Results.load(session).as_json() == before.as_json()


def test_a_partial_fit_is_not_put_in_the_place_of_a_whole_one(session: Path) -> None:
    with pytest.raises(
        DataError,
        match="holds G at 2000 mm too, which this fit would not replace: give it another name",
    ):
        fit(session, ranges_mm=2050.5, name="latest", workers=1)
    assert len(Results.load(session)) == 2


def test_other_modes_and_another_lens_are_kept_with_what_they_gave(session: Path) -> None:
    other = Session.open(session).plan.replace(lens={"f_number": 8.1})
    results = fit(session, plan=other, noll=(4, 7), name="f8.1", workers=1)
    again = Results.load(session, "f8.1")
    assert again.plan == results.plan
    assert (again.plan.lens.f_number, again.plan.fit.zernike_noll) == (8.1, (4, 7))
    assert [w.f_number for w in again] == [w.f_number for w in results]
    assert again.plan_sha256 != Results.load(session).plan_sha256
    assert Session.open(session).plan.lens.f_number == 8.0


def test_the_command_line_fits_again_too(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "other.toml"
    plan.write_text(Session.open(session).plan.replace(lens={"f_number": 7.9}).to_toml())
    args = [
        "--json",
        "fit",
        str(session),
        "--plan",
        str(plan),
        "--noll",
        "4:7",
        "--name",
        "by-plan",
        "--workers",
        "1",
    ]
    assert run(args) == 0
    assert json.loads(capsys.readouterr().out)["plan"]["lens"]["f_number"] == 7.9
    assert Results.load(session, "by-plan").plan == Plan.load(plan).replace(
        fit={"zernike_noll": (4, 7)}
    )


@pytest.mark.parametrize("noll", ["4", "4-22", "22:4", "1:6", "4:99999"])
def test_modes_that_are_none_are_refused_in_a_line(
    noll: str, session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["fit", str(session), "--noll", noll]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_where_the_target_stood_is_kept(session: Path) -> None:
    (w, _) = Results.load(session)
    assert w.placement is not None
    (top, left), (rows, columns) = w.placement.origin_px, w.placement.shape_px
    corners = w.placement.corners_px
    assert corners.shape == (1, 4, 2)
    # the cut has the target in it, with a margin, in pixels of the whole frame
    assert (corners.min(axis=(0, 1)) > [top, left]).all()
    assert (corners.max(axis=(0, 1)) < [top + rows, left + columns]).all()


def test_a_fit_writes_the_numbers_that_sessions_of_one_lens_have_in_common(
    session: Path,
) -> None:
    results = Results.load(session)
    common, lens = results.common, results.lens
    assert common is not None
    assert lens is not None
    numbers = ["best_focus_mm.G", "f_number", "focal_length_mm", "ln_pupil_magnification"]
    assert sorted(common.names) == [*numbers, "waves.G.5", "waves.G.6"]
    assert (np.linalg.eigvalsh(common.covariance) > 0).all()
    values = dict(zip(common.names, common.values, strict=True))
    assert values["focal_length_mm"] == pytest.approx(lens.focal_length.value)
    assert values["f_number"] == pytest.approx(lens.f_number.value)
    assert {"focal_length", "f-number"} <= common.stated.keys()


def labkit(*args: str) -> list[str]:
    return [sys.executable, "-c", "from labkit.cli import main; main()", *args]


@pytest.mark.slow
def test_a_fit_that_was_killed_and_found_the_disk_full_goes_on_where_it_was(
    session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path) -> None:
        with writing(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    folder = session / "results" / "again"
    command = labkit(
        "fit", str(session), "--workers", "2", "--name", "again", "--noll", "4:7"
    )
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        while not list(folder.glob(".fits/[!.]*")) and process.poll() is None:
            time.sleep(0.005)
        process.kill()
        process.communicate(timeout=5)  # workers hold stderr open, and end with it
    kept = {path: path.stat().st_mtime_ns for path in folder.glob(".fits/[!.]*")}
    assert kept
    with monkeypatch.context() as patch:
        patch.setattr("labkit.results.storage.replacing", full)
        with pytest.raises(
            InputError,
            match="No space left on device; make room and fit again: that goes on where",
        ):
            fit(session, workers=1, name="again", noll=(4, 7))
    assert (
        kept.items()
        <= {path: path.stat().st_mtime_ns for path in folder.glob(".fits/*")}.items()
    )
    monkeypatch.setattr(
        "labkit.estimation.searches.find_optima",
        lambda *task, **options: pytest.fail("fitted twice"),
    )
    assert len(fit(session, workers=1, name="again", noll=(4, 7))) == 2
    assert not (folder / ".fits").exists()
