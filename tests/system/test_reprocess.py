"""Many sessions are fitted again: what is up to date is skipped, what fails is named and stays to be done."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pytest

import labkit
from labkit.analysis import reprocess as job
from labkit.analysis.inputs import frames_digest
from labkit.analysis.reprocess import reprocess
from labkit.cli import run
from labkit.errors import DataError, InputError, NewerError, WorkersError
from labkit.estimation import searches
from labkit.estimation.local import Found
from labkit.estimation.local import find_optima as find
from labkit.numerics import source_digest
from labkit.results import Results
from labkit.results.entries import MadeFrom
from labkit.results.storage import set_aside_corrupt
from labkit.session.fit_lock import fitted_alone
from labkit.session.session import Session
from tests.results_samples import full_results


@pytest.fixture
def session(captured: Path, tmp_path: Path) -> Path:
    """A copy, without results."""
    shutil.copytree(captured, tmp_path / "night-1")
    return tmp_path / "night-1"


def with_results(session: Path, name: str = "latest", **changed: Any) -> Results:
    """Write results by hand that are up to date but for some changes."""
    digest = frames_digest(Session.open(session))
    made = replace(MadeFrom(digest, source_digest(), own_plan=False), **changed)
    results = replace(full_results(), made_from=made)
    results.write(session / "results" / name)
    return results


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, Any]]]:
    """Sessions that are fitted, with the settings; results are made by hand."""
    made: list[tuple[str, dict[str, Any]]] = []

    def fit(session: Path, **settings: Any) -> Results:
        made.append((session.name, settings))
        return with_results(session, settings["name"])

    monkeypatch.setattr(job, "fit", fit)
    return made


def state_of(session: Path, **options: Any) -> tuple[str, str]:
    (row,) = reprocess([session], workers=1, **options)
    return row.state, row.why


Fits = list[tuple[str, dict[str, Any]]]


def test_a_session_without_results_is_fitted_and_is_then_up_to_date(
    session: Path, fits: Fits
) -> None:
    assert state_of(session, dry_run=True) == ("to do", "no results yet")
    assert fits == []
    assert state_of(session) == ("fitted", "no results yet")
    assert state_of(session) == ("up to date", "nothing has changed")
    assert state_of(session, name="other") == ("fitted", "no results yet")
    assert state_of(session, force=True) == ("fitted", "--force")
    assert len(fits) == 3


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"frames_sha256": ""}, "the session has other photographs now"),
        ({"numerics_sha256": ""}, "made by labkit 0.1.0, which has other source"),
        ({"own_plan": True}, "the plan was changed"),
        ({"failed": ("G at 2000 mm is left out: killed",)}, "G at 2000 mm is left out"),
    ],
)
def test_results_that_are_out_of_date_are_made_again_with_their_settings(
    session: Path, fits: Fits, changed: dict[str, Any], why: str
) -> None:
    with_results(session, channels=("G",), patience_s=30.0, **changed)
    state, reason = state_of(session)
    assert state == "fitted"
    assert why in reason
    ((name, settings),) = fits
    assert name == "night-1"
    assert settings["channels"] == ("G",)
    assert settings["patience_s"] == 30.0
    assert ("plan" in settings) != changed.get("own_plan", False)


def test_settings_are_read_as_they_were_written(session: Path) -> None:
    made = with_results(session, ranges_mm=(2000.0,), noll=(4, 7), joint=True).made_from
    assert Results.load(session).made_from == made
    assert made is not None
    assert made.patience_s == inf


def test_results_of_earlier_labkit_are_made_again(session: Path, fits: Fits) -> None:
    replace(full_results(), made_from=None).write(session / "results" / "latest")
    state, why = state_of(session)
    assert (state, len(fits)) == ("fitted", 1)
    assert "did not record" in why


def test_results_of_a_newer_labkit_are_named_and_left(session: Path, fits: Fits) -> None:
    with_results(session)
    file = session / "results/latest/results.json"
    content = file.read_text().replace('"schema": 3', '"schema": 4')
    file.write_text(content)
    state, why = state_of(session, force=True)
    assert (state, fits) == ("skipped", [])
    assert f"{file} has schema 4, of a newer labkit" in why
    with pytest.raises(NewerError):
        labkit.fit(session, workers=1)
    assert file.read_text() == content


def test_a_report_of_results_of_a_newer_labkit_is_refused_in_a_line(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with_results(session)
    file = session / "results/latest/results.json"
    file.write_text(file.read_text().replace('"schema": 3', '"schema": 4'))
    assert run(["report", str(session)]) != 0
    assert "of a newer labkit; this version knows schemas to 3: update" in (
        capsys.readouterr().err
    )


def test_a_folder_in_the_place_of_results_is_set_aside(session: Path, fits: Fits) -> None:
    file = session / "results/latest/results.json"
    file.mkdir(parents=True)
    assert state_of(session, dry_run=True) == ("to do", "its results.json cannot be read")
    aside = set_aside_corrupt(file.parent)
    assert aside == file.with_name("results.json.corrupt")
    assert aside.is_dir()
    assert state_of(session)[0] == "fitted"


def test_failed_fits_stay_to_be_done_until_they_are_accepted(
    session: Path, fits: Fits
) -> None:
    with_results(session, failed=("G at 2000 mm is left out: killed",))
    assert state_of(session, dry_run=True, accept_failed=True)[0] == "up to date"
    assert state_of(session, dry_run=True)[0] == "to do"
    assert state_of(session, accept_failed=True)[0] == "up to date"
    why = "accepted without failed fits: G at 2000 mm is left out: killed"
    assert state_of(session) == ("up to date", why)
    assert fits == []


def test_a_session_that_fails_does_not_end_the_others(
    session: Path, fits: Fits, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere, other = session.with_name("nowhere"), session.with_name("night-2")
    shutil.copytree(session, other)
    arguments = [str(nowhere), str(session), str(other), "--workers", "2"]
    assert run(["--json", "reprocess", *arguments]) == 1
    printed = capsys.readouterr()
    rows = json.loads(printed.out)["sessions"]
    assert [row["state"] for row in rows] == ["failed", "fitted", "fitted"]
    assert "1 of 3 sessions are not done" in printed.err.splitlines()[-1]


@pytest.mark.parametrize(
    "error", [WorkersError("the scheduler is gone"), InputError("cannot write: full")]
)
def test_without_workers_or_room_no_further_session_is_begun(
    session: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    error.__cause__ = OSError(28, "No space left on device")
    begun = []

    def fit(session: Path, **settings: Any) -> Results:
        begun.append(session)
        raise error

    monkeypatch.setattr(job, "fit", fit)
    shutil.copytree(session, session.with_name("night-2"))
    with pytest.raises(type(error)):
        reprocess([session, session.with_name("night-2")], workers=1)
    assert begun == [session]


def test_two_jobs_on_one_session_are_told_apart(session: Path) -> None:
    with fitted_alone(session / "results" / "latest"):
        state, why = state_of(session)
    assert state == "failed"
    assert "is being fitted by process" in why


def test_bad_requests_are_refused_in_a_line(session: Path) -> None:
    with pytest.raises(DataError, match="no session"):
        reprocess([])
    with pytest.raises(DataError, match="given twice"):
        reprocess([session, session / "."])


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No search at one range comes to an end."""
    begin = searches.Searches.__post_init__
    least: list[float] = []

    def find_optima(
        optics: Any, target: Any, views: Any, *rest: Any, **options: Any
    ) -> Found:
        if views.frames[0].counts.sum() == least[0]:
            raise FloatingPointError("overflow")
        return find(optics, target, views, *rest, **options)

    def remember(self: searches.Searches) -> None:
        begin(self)
        least[:] = [min(view.value.frames[0].counts.sum() for view in self.views)]

    monkeypatch.setattr(searches.Searches, "__post_init__", remember)
    monkeypatch.setattr(searches, "find_optima", find_optima)


@pytest.mark.slow
@pytest.mark.usefixtures("failing")
def test_a_fit_that_fails_is_a_row_and_a_corrupt_file_is_set_aside(session: Path) -> None:
    latest = session / "results" / "latest"
    latest.mkdir(parents=True)
    (latest / "results.json").write_text('{"schema": 3, "wavefronts": [')
    assert state_of(session, dry_run=True) == ("to do", "its results.json cannot be read")
    state, why = state_of(session)
    assert state == "failed"
    assert "is left out: FloatingPointError: overflow" in why
    assert (latest / "results.json.corrupt").read_text().startswith('{"schema": 3')
    results = Results.load(session)
    assert len(results) == 1
    assert "results-corrupt" in [finding.code for finding in results.findings]
    assert results.unanswered is not None
    assert state_of(session, accept_failed=True)[0] == "up to date"


@pytest.mark.slow
def test_any_executor_gives_the_same_numbers(session: Path) -> None:
    with ThreadPoolExecutor(2) as executor:
        here = labkit.fit(session, run=executor, name="threads", plain=True)
    assert here.as_json()["wavefronts"] is not None
    again = labkit.fit(session, workers=1, name="alone", plain=True)
    for one, other in zip(here, again, strict=True):
        assert one.waves.tolist() == other.waves.tolist()
