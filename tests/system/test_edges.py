"""`labkit edges` on photographs of a camera that shares nothing with the model: the contract, ranges, and bad input."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.cli import run
from labkit.types import Floats
from tests.edge_scenes import PLAN, SIDE, TABLES, box, lens_results, square, write_scene
from tests.plans import plan_text

RANGES_MM = (1500.0, 3000.0)
ANGLES = (0.15, 1.75)
CONTRACT = {
    *(
        "box",
        "angle_deg",
        "range_mm",
        "other_sign_mm",
        "mtf50_per_mm",
        "esfr_mtf50_per_mm",
        "chi2_per_pixel",
    ),
}


@pytest.fixture(scope="module")
def edges() -> list[Floats]:
    return [square(r, a) for r, a in zip(RANGES_MM, ANGLES, strict=True)]


@pytest.fixture
def folder(tmp_path: Path, edges: list[Floats]) -> Path:
    """A scene of: an edge at either range, noise, and an edge whose halves are at either range; a plan; a session."""
    upper = np.arange(SIDE)[:, None] < SIDE // 2
    mixed = np.where(upper, square(1500.0, 0.05), square(3000.0 + 3000.0, 0.05))
    write_scene(tmp_path / "scene.tif", [*edges, np.full((SIDE, SIDE), 3000.0), mixed])
    (tmp_path / "plan.toml").write_text(PLAN)
    results = tmp_path / "session" / "results" / "latest"
    results.mkdir(parents=True)
    lens_results().write(results)
    return tmp_path


def asked(
    folder: Path, capsys: pytest.CaptureFixture[str], *options: str, status: int = 0
) -> tuple[Any, str]:
    """JSON and what stands on stderr."""
    words = [
        "edges",
        str(folder / "scene.tif"),
        str(folder / "plan.toml"),
        "--workers",
        "1",
        "--json",
        *options,
    ]
    assert run(words) == status
    printed = capsys.readouterr()
    return json.loads(printed.out) if printed.out else None, printed.err


def boxes(*places: int) -> list[str]:
    return [word for k in places for word in ("--box", ",".join(map(str, box(k))))]


@pytest.mark.slow
def test_ranges_come_from_a_sessions_lens_and_what_is_no_edge_is_rejected(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    psf = ["--psf", str(folder / "session"), "--out", str(folder / "out")]
    found, err = asked(folder, capsys, *psf, *boxes(0, 1, 2, 3), "--box", "0,0,400,400")
    assert found["schema"] == 1
    assert [edge["box"] for edge in found["edges"]] == [[*box(0)], [*box(1)]]
    for edge, range_mm, angle in zip(found["edges"], RANGES_MM, ANGLES, strict=True):
        assert set(edge) >= CONTRACT
        value, std = edge["range_mm"]["value"], edge["range_mm"]["std"]
        assert abs(value - range_mm) < 4 * std
        assert std < 0.06 * range_mm  # the plan's engravings, 2 and 3 %, rule
        assert edge["angle_deg"] == pytest.approx(np.degrees(angle), abs=0.1)
        assert edge["esfr_mtf50_per_mm"] == pytest.approx(
            edge["mtf50_per_mm"]["value"], rel=0.2
        )  # 12 % measured: a box of 36 pixels cuts the blur's tails off
        assert edge["chi2_per_pixel"] == pytest.approx(1, abs=0.1)
    whys = {tuple(of["box"]): of["why"] for of in found["rejected"]}
    assert "holds no edge" in whys[box(2)]
    assert "edges at different depths" in whys[box(3)]
    assert "outside the image, which has 40 rows and 160 columns" in whys[0, 0, 400, 400]
    assert len(err.splitlines()) >= 3
    assert json.loads((folder / "out" / "edges.json").read_text()) == found
    assert (folder / "out" / "edges.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_edges_declared_to_be_at_one_range_that_are_not_are_told(
    folder: Path, capsys: pytest.CaptureFixture[str], edges: list[Floats]
) -> None:
    write_scene(folder / "scene.tif", [edges[0], square(6000.0, 1.75), edges[0]], seed=2)
    found, _ = asked(
        folder, capsys, "--psf", str(folder / "session"), "--one-range", *boxes(0, 1, 2)
    )
    assert [edge["box"] for edge in found["edges"]] == [[*box(0)], [*box(2)]]
    assert found["edges"][0]["range_mm"] == found["edges"][1]["range_mm"]
    assert "one range with the others, but its defocus" in found["rejected"][0]["why"]


@pytest.mark.slow
def test_without_a_session_the_wavefront_is_fitted_along_and_both_sides_are_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, _ = asked(folder, capsys, "--focus", "2000±1", *boxes(0, 1))
    for edge, range_mm in zip(found["edges"], RANGES_MM, strict=True):
        sides = [edge["range_mm"], edge["other_sign_mm"]]
        assert min(abs(side["value"] - range_mm) / side["std"] for side in sides) < 4
        assert (sides[0]["value"] - 2000) * (sides[1]["value"] - 2000) < 0
    assert set(found["wavefront"]) == {*map(str, range(5, 12))}


def test_edges_are_found_where_none_are_given_and_ranges_need_a_focus(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, err = asked(folder, capsys, "--most", "1")
    assert len(found["edges"]) == 1
    assert found["edges"][0]["range_mm"] == {"value": None, "std": None}
    assert [finding["code"] for finding in found["findings"]] == ["ranges-not-determined"]
    assert "--focus" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--box", "1,2,3"], "--box 1,2,3: give R0,C0,R1,C1"),
        (["--focus", "near"], "--focus near: give millimetres"),
        (["--channel", "Z"], "channel Z: allowed are M"),
        (["--psf", "nowhere"], "nowhere"),
        (["--box", "0,0,400,400"], "no edge could be measured: the box lies outside"),
        (["--box", "20,20,10,10"], "spans -10 rows"),
    ],
)
def test_bad_input_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    _, err = asked(folder, capsys, *options, status=2)
    assert words in err.splitlines()[-1]


def test_the_psf_of_another_camera_is_refused_unless_forced(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lens_results(f_number=5.6).write(folder / "session" / "results" / "latest")
    psf = ["--psf", str(folder / "session"), *boxes(0)]
    _, err = asked(folder, capsys, *psf, status=2)
    assert "of another camera: lens.f_number = 8, the session's is 5.6; give" in err
    found, err = asked(folder, capsys, *psf, "--force")
    assert len(found["edges"]) == 1
    assert "by force: lens.f_number = 8" in err
    assert found["findings"][0]["code"] == "psf-of-another-camera"


def test_a_channel_that_the_session_lacks_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = {"channel": [{"name": "X", "wavelength_nm": 550.0}]}
    (folder / "plan.toml").write_text(plan_text(TABLES, other))
    _, err = asked(folder, capsys, "--psf", str(folder / "session"), *boxes(0), status=2)
    assert "channel X, the session has M" in err


def test_an_edge_that_the_model_does_not_explain_keeps_its_response_by_the_standard(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    even = square(1500.0, 0.15)
    striped = even + 0.4 * np.ptp(even) * (
        np.arange(SIDE)[:, None] // 6 % 2
    )  # along the edge, both sides alike
    write_scene(folder / "scene.tif", [striped, even])
    found, err = asked(folder, capsys, "--psf", str(folder / "session"), *boxes(0))
    assert not found["edges"]
    (rejected,) = found["rejected"]
    assert "no straight edge between two even sides" in rejected["why"]
    clean, _ = asked(folder, capsys, "--psf", str(folder / "session"), *boxes(1))
    assert rejected["channels"][0]["esfr_mtf50_per_mm"]["value"] == pytest.approx(
        clean["edges"][0]["esfr_mtf50_per_mm"], rel=0.15
    )
    assert rejected["why"] in err
