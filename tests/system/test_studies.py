"""Every study of the thesis's experiments in its quick form, through the command line and by its contract."""

from pathlib import Path

import pytest

from labkit.cli import run
from labkit.experiments.studies import STUDIES
from tests.studies import quick

NAMES = (
    *(
        "crb",
        "uniform-crb",
        "targets",
        "minima",
        "roc",
        "global",
        "annealing",
        "psf-accuracy",
        "extension",
    ),
    *("edges", "restoration"),
)
OF_THEIR_OWN = ("targets", "extension")
"""Run in tests/physics, where what they find is held too."""


def test_all_that_the_contract_names_are_there() -> None:
    assert set(STUDIES) == set(NAMES)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in OF_THEIR_OWN])
def test_a_study_prints_one_json_object_and_writes_its_files(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = quick(name, tmp_path, capsys)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{end}" for end in ("csv", "json", "png")
    }
    assert any(claim["measured"] is not None for claim in summary["claims"])


def test_an_unknown_study_is_told_which_there_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["study", "nonsense"]) == 2
    assert "there are crb" in capsys.readouterr().err
