"""Fields of a turned lens and of a turned screw, by Seidel sums, and the commands that compare sessions."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.cli import run
from labkit.errors import DataError, InputError
from labkit.field.summary import summarise_field
from labkit.field.terms import lens_terms
from labkit.field.turned import check_screw_move, split_fields, tilt_of
from labkit.optics.field import FieldModel
from labkit.plan import Plan
from labkit.results import Results
from labkit.types import Floats
from tests.field_samples import of_path
from tests.plans import SMALL, plan_text
from tests.results_samples import some_results
from tests.tiled_samples import a_model, tiled_results

SCREWS = {"screws_mm": [[0.0, 30.0], [26.0, -15.0], [-26.0, -15.0]], "screw_pitch_mm": 0.5}


def a_plan(**tables: object) -> Plan:
    return Plan.parse(plan_text(SMALL, tables))


def lens(x: Floats, y: Floats, p: Floats, q: Floats) -> Floats:
    """Return the path of a lens whose coma and focal surfaces are decentred."""
    square = p**2 + q**2
    coma = 0.11 * ((x - 0.5) * p + (y + 0.3) * q) * square
    down, right = y + 0.15, x - 0.2
    astigmatism = 0.05 * (right * p + down * q) ** 2
    return coma + astigmatism - 0.04 * (right**2 + down**2) * square


def turned_field(angle_deg: float, down: float = 0.3, right: float = -0.1) -> FieldModel:
    """Return the field with the lens turned from right towards down, on a body that adds a tilt times p² + q²."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def path(x: Floats, y: Floats, p: Floats, q: Floats) -> Floats:
        turned = lens(
            cos * x + sin * y, cos * y - sin * x, cos * p + sin * q, cos * q - sin * p
        )
        return turned + (down * y + right * x) * (p**2 + q**2)

    return of_path(path, std=1e-4)


def session(model: FieldModel, **changed: Any) -> Results:
    """Return results of two ranges with a field, and a mount with three screws."""
    return some_results(**{"field": model, "plan": a_plan(mount=SCREWS)} | changed)


def um_per_square() -> float:
    """Return the focus error of a wave of p² + q²."""
    return float(turned_field(0).um_per_wave / (2 * np.sqrt(3)))


@pytest.mark.parametrize("angles", [(0.0, 180.0), (0.0, 90.0), (20.0, 140.0, -70.0)])
def test_what_turns_with_the_lens_is_the_lens_s(angles: tuple[float, ...]) -> None:
    parts = split_fields([session(turned_field(a)) for a in angles], angles)
    alone = lens_terms(of_path(lens), "G")
    assert parts["coma"].lens.value == pytest.approx(alone.coma.value)
    assert parts["coma"].body.value == pytest.approx(np.zeros(2), abs=1e-9)
    astigmatism = parts["linear_astigmatism"]
    assert astigmatism.lens.value == pytest.approx(alone.linear_astigmatism.value)
    assert astigmatism.body.value == pytest.approx(np.zeros(2), abs=1e-9)
    tilt = parts["sensor_tilt"]
    assert tilt.lens.value == pytest.approx(alone.tilt.slope.value)
    assert tilt.body.value == pytest.approx(um_per_square() * np.array([0.3, -0.1]))


@pytest.mark.parametrize(("sign", "way"), [(1, "away"), (-1, "towards")])
def test_a_screw_turned_by_20_degrees_proves_its_way(sign: int, way: str) -> None:
    """28 µm at 45 mm from the line through the other screws."""
    change = sign * 1e3 * 0.5 * 20 / 360 / 45 / um_per_square()
    before, after = (session(turned_field(0, down=0.3 + more)) for more in (0.0, change))
    move = check_screw_move(before, after, 1, 20.0)
    assert move.clockwise == way
    assert move.factor.value == pytest.approx(sign)
    assert move.factor.std < 0.05


def test_curvature_moves_no_screw() -> None:
    """A bowl of 10 µm in the corners is no tilt."""
    bowl = of_path(lambda x, y, p, q: 0.1 * (x**2 + y**2) * (p**2 + q**2))
    assert lens_terms(bowl, "G").tilt.slope.value == pytest.approx(np.zeros(2), abs=1e-9)


def test_sessions_that_do_not_compare_are_refused() -> None:
    models = [turned_field(0), turned_field(180)]
    fields = [session(model) for model in models]
    with pytest.raises(InputError, match="two different angles"):
        split_fields(fields, (0, 0))
    with pytest.raises(InputError, match=r"450 and 550 nm"):
        split_fields([fields[0], session(replace(models[1], reference_nm=550.0))], (0, 180))
    with pytest.raises(DataError, match="no channel X"):
        split_fields(fields, (0, 180), "X")
    with pytest.raises(InputError, match="screw 4: allowed is 1 to 3"):
        check_screw_move(fields[0], fields[1], 4, 30.0)
    with pytest.raises(InputError, match=r"no mount\.screws_mm"):
        check_screw_move(fields[0], fields[1], 1, 30.0, a_plan())
    with pytest.raises(DataError, match="no field was estimated"):
        check_screw_move(some_results(), fields[1], 1, 30.0)


def test_an_open_sign_proves_no_way_and_splits_no_tilt() -> None:
    sure = session(turned_field(0))
    one_range = session(turned_field(180), wavefronts=sure.at_range(3000.0))
    with pytest.raises(DataError, match="sign of the tilt is open"):
        check_screw_move(sure, one_range, 1, 20.0)
    with pytest.raises(DataError, match="sign of the tilt is open"):
        split_fields([one_range, sure], (0, 180))


def test_the_compared_tilt_is_the_one_that_labkit_field_prints() -> None:
    """The camera's, without the target's tilt: re-aiming between two sessions moves no screw."""
    results = tiled_results()
    camera = summarise_field(results).camera_tilt
    assert camera is not None
    assert tilt_of(results).value == pytest.approx(camera.slope.value)
    slope = lens_terms(a_model(), "R").tilt.slope.value
    assert not np.allclose(camera.slope.value, slope, rtol=1e-4)


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return two sessions: before and after half a turn of the lens, or of a screw by 20° that moved away."""
    fields = {"A": turned_field(0), "B": turned_field(180)}
    monkeypatch.setattr("labkit.cli.field_moves.a_session", lambda path: None)
    monkeypatch.setattr(
        "labkit.results.Results.load",
        lambda path, name, residuals: session(fields[Path(path).name]),
    )
    return [str(tmp_path / name) for name in fields]


def test_split_prints_both_parts(
    folders: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["field", "split", *folders, "--turned", "0,180"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == [
        "misalignment",
        "of",
        "down",
        "right",
        "unit",
        "p",
        "if",
        "none",
    ]
    assert len(lines) == 1 + 2 * 3
    assert run(["field", "split", *folders, "--turned", "0,180", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["parts"]["sensor_tilt"]["p_no_body"] < 1e-6
    assert answer["parts"]["coma"]["p_no_body"] == pytest.approx(1)
    assert run(["field", "split", *folders, "--turned", "90"]) == 2
    assert "1 angles (90) for 2 sessions" in capsys.readouterr().err


def test_check_move_says_what_the_move_proves(
    folders: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Half a turn of the lens is no move of a screw: the change is across."""
    command = ["field", "check-move", *folders, "--screw", "1", "--turn", "20"]
    assert run(command) == 0
    printed = capsys.readouterr().out
    assert "no turn of screw 1 does" in printed
    assert run([*command, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["clockwise"] is None
    assert answer["p_across"] < 1e-6
