"""Every study of the thesis's experiments in its quick form, through the command line and by its contract."""

import json
from pathlib import Path
from typing import Any

import pytest

from labkit.cli import run
from labkit.experiments.studies import STUDIES

NAMES = (
    *("crb", "uniform-crb", "targets", "minima", "roc", "global", "annealing", "psf-accuracy", "extension"),
    *("edges", "restoration"),
)
FIELDS: dict[str, Any] = {"what": str, "measured": (int, float, type(None)), "unit": str, "n": int}


def test_all_that_the_contract_names_are_there() -> None:
    assert set(STUDIES) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_study_prints_one_json_object_and_writes_its_files(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["study", name, "--quick", "--workers", "1", "--out", str(tmp_path)]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["schema"], summary["study"], summary["quick"]) == (1, name, True)
    assert summary["seconds"] > 0
    assert summary["claims"]
    for claim in summary["claims"]:
        assert set(claim) == {"what", "thesis", "measured", "unit", "n"}
        assert all(isinstance(claim[key], kind) for key, kind in FIELDS.items())
    assert json.loads((tmp_path / f"{name}.json").read_text()) == summary
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / f"{name}.csv").read_text().splitlines()) > 1


def test_an_unknown_study_is_told_which_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["study", "nonsense"]) == 2
    assert "there are crb" in capsys.readouterr().err
