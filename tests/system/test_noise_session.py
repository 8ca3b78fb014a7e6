"""A photon-transfer series from capture to page, by the command line, with the simulated camera."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labkit.cli.command_line import run
from labkit.session.session import Session
from labkit.uncertain import Uncertain
from tests.plans import SMALL, plan_text, simulated

EXPOSURES_S = [0.002, *(round(0.004 * k, 3) for k in range(1, 12))]
GAIN, READ_NOISE = 0.45, 0.45 * 2.5
"""The simulated camera's at ISO 100: counts per electron, counts."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("noise")
    target = {"order": 3, "size_mm": 54.0}
    plan = plan_text(
        SMALL,
        simulated([2000.0], 1900.0),
        {"target": target, "noise": {"exposures_s": EXPOSURES_S}},
        {"display": {"pixels": [800, 800]}},
    )
    (folder / "plan.toml").write_text(plan, encoding="utf-8")
    made = folder / "session"
    assert run(["--quiet", "capture", str(folder / "plan.toml"), str(made)]) == 0
    return made


@pytest.mark.slow
def test_capture_takes_pairs_of_every_exposure(session: Path) -> None:
    frames = Session.open(session).frames
    for kind in ("dark", "flat"):
        times = [frame.exposure_s for frame in frames if frame.kind == kind]
        assert times == sorted(EXPOSURES_S * 2)
    assert len(frames) == 4 * len(EXPOSURES_S)


@pytest.mark.slow
def test_the_simulated_cameras_noise_is_its_own(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["--json", "noise", str(session)]) == 0
    printed = json.loads(capsys.readouterr().out)
    kept = json.loads((session / "results" / "noise.json").read_text(encoding="utf-8"))
    assert {**kept, "created": ""} == {**printed, "created": ""}
    green = kept["channels"]["G"]
    for name, truth, share in (
        ("gain_counts_per_e", GAIN, 0.01),
        ("read_noise_counts", READ_NOISE, 0.02),
    ):
        number = Uncertain(**green[name])
        assert number.value == pytest.approx(truth, rel=share)
        assert abs(number.value - truth) < 4 * number.std
    assert green["quantum_efficiency_percent"] == {"value": None, "std": None}
    page = (session / "results" / "noise.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 3
    assert page.endswith("</html>\n")


@pytest.mark.slow
def test_the_lines_for_a_plan_are_printed(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["noise", str(session)]) == 0
    printed = capsys.readouterr().out
    assert "system gain K" in printed
    assert '# [[channel]] name = "G"  # at ISO 100\ngain_counts_per_e = 0.4' in printed


def test_a_session_without_a_series_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_text(SMALL)
    Session.create(tmp_path / "session", plan, tmp_path).close()
    assert run(["noise", str(tmp_path / "session")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("labkit: the session has no flats: photon transfer needs two")
    assert "[noise] in a plan has labkit capture take them" in said
