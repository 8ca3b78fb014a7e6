"""`labkit chart` on photographs of a camera that shares nothing with the model, whose wavefront varies over the field."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from labkit.charts.measurement import measure_chart
from labkit.charts.outcome import LEVELS_PER_MM, ChartOutcome
from labkit.cli import run
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.chart_scenes import (
    PATCH,
    PITCH_UM,
    PLAN,
    Waves,
    chart,
    checkerboard,
    squares,
    true_mtf,
    working_f_number,
)
from tests.edge_scenes import F_NUMBER, FOCAL_MM, NM, write_scene

FOCUS_MM = 2000.0
N = working_f_number(FOCUS_MM)
LEVELS = np.array(LEVELS_PER_MM)
UM_PER_WAVE = 8 * N**2 * np.sqrt(12) * NM * 1e-3
PATCH_MM = PATCH * PITCH_UM * 1e-3


def plan(folder: Path) -> Path:
    path = folder / "plan.toml"
    path.write_text(PLAN)
    return path


def tilted(y: float, x: float) -> Floats:
    """Defocus linear in the place, astigmatism with its square."""
    astigmatism = [0.06 * x * y, 0.03 * (x * x - y * y)]
    return np.array([0.35 + 0.08 * x - 0.05 * y, *astigmatism, 0.02, 0.03, 0.05])


def pulls(values: list[Uncertain], truth: Floats) -> list[float]:
    return [(of.value - true) / of.std for of, true in zip(values, truth, strict=True)]


def edge_pulls(outcome: ChartOutcome, waves: Waves) -> Floats:
    """(edges, levels), with the wavefront of each edge's patch."""
    found = []
    for edge in outcome.edges:
        patch = np.round(edge.height_mm / PATCH_MM) * PATCH_MM
        truth = true_mtf(waves(*patch), N, np.radians(edge.of.angle_deg), LEVELS)
        found.append(pulls([edge.of.fitted.at(level) for level in LEVELS], truth))
    return np.array(found)


@pytest.mark.slow
def test_edges_and_places_of_one_photograph_have_the_lenses_response_within_errors(
    tmp_path: Path,
) -> None:
    image = write_scene(tmp_path / "a.tif", [chart((3, 3), tilted, N, squares)])
    outcome = measure_chart(
        image, plan(tmp_path), columns=3, ranges_mm=[FOCUS_MM], workers=1
    )
    assert len(outcome.edges) == 36
    assert len(outcome.places) == 9
    # 1.8, 1.3 and 0.7: halos of other edges add 0.001 to the MTF at 10 cycles/mm
    off = edge_pulls(outcome, tilted)
    assert np.all(np.abs(off.mean(axis=0)) < [3.0, 2.2, 1.3])
    assert np.all(off.std(axis=0) < 2.0)  # 1.1 to 1.35
    for place in outcome.places:
        radial = float(np.arctan2(*place.height_mm))
        patch = np.round(place.height_mm / PATCH_MM) * PATCH_MM
        known = [of for of in (("S", np.pi / 2), ("T", 0.0)) if place.known(of[0])]
        # edges at 45° to the radius tell neither S nor T
        assert len(known) == (0 if abs(abs(np.sin(2 * radial)) - 1) < 0.1 else 2)
        for kind, turn in known:
            truth = true_mtf(tilted(*patch), N, radial + turn, LEVELS)
            values = [place.responses[kind].at(level) for level in LEVELS]
            assert np.all(np.abs(pulls(values, truth)) < 4.5)  # 3.2
    assert all(of.sign_open for of in outcome.foci["M"])
    assert outcome.surfaces == {"M": {}}
    assert [finding.code for finding in outcome.findings] == [
        "chart-directions-missing",
        "chart-focus-sign-open",
    ]


@pytest.mark.slow
def test_edges_are_s_and_t_by_their_direction_and_neither_on_the_diagonals(
    tmp_path: Path,
) -> None:
    even: Waves = lambda y, x: np.array([0.3, 0.0, 0.0, 0.02, 0.03, 0.05])  # noqa: E731
    image = write_scene(tmp_path / "a.tif", [chart((4, 5), even, N, checkerboard)])
    outcome = measure_chart(
        image, plan(tmp_path), columns=5, each=1, ranges_mm=[FOCUS_MM], workers=1
    )
    assert outcome.left_out["cut"] >= 1
    assert {edge.kind for edge in outcome.edges} == {"S", "T", "O", "C"}
    for edge in outcome.edges:
        y, x = edge.height_mm
        normal = np.radians(edge.of.angle_deg)
        share = abs(x * np.cos(normal) + y * np.sin(normal)) / np.hypot(y, x)
        if edge.kind != "C":
            assert edge.kind == ("T" if share > 0.924 else "S" if share < 0.383 else "O")
    truth = [
        true_mtf(even(0, 0), N, np.radians(edge.of.angle_deg), LEVELS)
        for edge in outcome.edges
    ]
    values = [[edge.of.fitted.at(level) for level in LEVELS] for edge in outcome.edges]
    off = np.array([pulls(of, true) for of, true in zip(values, truth, strict=True)])
    assert np.all(np.abs(off) < 6)


RANGES_MM = (1700.0, 2000.0, 2500.0)
MIDDLE_MM = float(1 / np.mean(1 / np.array(RANGES_MM)))
OFFSET_UM, TILT, CURVATURE, S_TO_T = 5.0, (2.4, -6.0), -3.0, 4.0
"""um, um/mm down and right, um/mm^2 of the medial surface, and of T from S."""


def medial_um(y: float, x: float) -> float:
    return OFFSET_UM + TILT[0] * y + TILT[1] * x + CURVATURE * (x * x + y * y)


def at_range(range_mm: float) -> Waves:
    """The wavefront of a tilted sensor behind a lens with astigmatism, for a target at a range."""
    path_mm = (FOCAL_MM / F_NUMBER) ** 2 / 8 * (1 / MIDDLE_MM - 1 / range_mm)
    law = path_mm / np.sqrt(12) / (NM * 1e-6)

    def waves(y: float, x: float) -> Floats:
        astigmatism = (
            S_TO_T / np.sqrt(2) / UM_PER_WAVE * np.array([2 * x * y, x * x - y * y])
        )
        return np.array(
            [law + medial_um(y, x) / UM_PER_WAVE, *astigmatism, 0.02, 0.03, 0.05]
        )

    return waves


@pytest.fixture(scope="module")
def through_focus(tmp_path_factory: pytest.TempPathFactory) -> ChartOutcome:
    folder = tmp_path_factory.mktemp("chart")
    images = [
        write_scene(
            folder / f"{k}.tif",
            [chart((3, 5), at_range(mm), working_f_number(MIDDLE_MM), squares)],
            seed=k,
        )
        for k, mm in enumerate(RANGES_MM)
    ]
    return measure_chart(images, plan(folder), columns=5, ranges_mm=RANGES_MM)


@pytest.mark.slow
def test_ranges_give_the_focus_of_each_place_with_its_sign(
    through_focus: ChartOutcome,
) -> None:
    foci = through_focus.foci["M"]
    assert len(foci) == 15
    assert not any(of.sign_open for of in foci)
    medial, apart = [], []
    for of in foci:
        y, x = of.height_mm
        medial.append(of.of("medial"))
        half = S_TO_T * (x * x + y * y) / 2
        truth = medial_um(y, x) + half * np.array([-1, 1])
        apart += pulls([of.of("S"), of.of("T")], truth)
    off = pulls(medial, np.array([medial_um(*of.height_mm) for of in foci]))
    assert np.std(off) < 2  # 1.06 measured
    assert abs(np.mean(off)) < 0.7  # 0.34
    assert max(map(abs, apart)) < 4
    assert max(of.std for of in medial) < 0.58  # um, 0.29 measured


@pytest.mark.slow
def test_the_sensors_tilt_and_the_curvatures_of_three_surfaces_are_recovered(
    through_focus: ChartOutcome,
) -> None:
    surfaces = through_focus.surfaces["M"]
    half = {"medial": 0.0, "S": -S_TO_T / 2, "T": S_TO_T / 2}
    for kind, of in surfaces.items():
        expected = {
            "tilt_rows_um_per_mm": TILT[0],
            "tilt_columns_um_per_mm": TILT[1],
            "curvature_per_mm": 1e-3 * (CURVATURE + half[kind]),
        }
        for name, value in expected.items():
            number = of.number(name)
            assert abs(number.value - value) < 3 * number.std, (kind, name)
        assert of.chi2_per_freedom < 3
    assert set(surfaces) == {"medial", "S", "T"}
    assert surfaces["medial"].number("tilt_rows_um_per_mm").std < 0.3  # 0.15 measured


@pytest.mark.slow
def test_the_command_prints_places_and_writes_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = write_scene(tmp_path / "a.tif", [chart((3, 3), tilted, N, squares)])
    words = ["chart", str(image), str(plan(tmp_path)), "--places", "3", "--edges", "1"]
    assert run([*words, "--out", str(tmp_path / "out"), "--workers", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer == json.loads((tmp_path / "out" / "chart.json").read_text())
    assert len(answer["edges"]) == 18
    edge = answer["edges"][0]
    assert edge["kind"] in "STOC"
    assert edge["height_mm"] == pytest.approx(
        np.hypot(edge["y_mm"], edge["x_mm"]), abs=1e-5
    )
    assert set(edge) >= {
        "mtf50_per_mm",
        "mtf_at_10_per_mm",
        "mtf_at_20_per_mm",
        "mtf_at_40_per_mm",
    }
    assert {of["sign_open"] for of in answer["focus"]["M"]} == {True}
    for name in ("profiles", "map"):
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_board_of_small_squares_gives_distortion_and_pose_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    side, turn = 32, np.radians(7.0)
    y, x = np.mgrid[: 4 * 360, : 4 * 480] / 4
    u = x * np.cos(turn) + y * np.sin(turn)
    v = y * np.cos(turn) - x * np.sin(turn)
    bright = (np.floor(u / side) + np.floor(v / side)) % 2
    pixels = cv2.resize(bright, (480, 360), interpolation=cv2.INTER_AREA)
    mean = cv2.GaussianBlur(1000 + 5000 * pixels, (0, 0), 1.0)
    image = write_scene(tmp_path / "a.tif", [np.asarray(mean, float)])
    words = ["chart", str(image), str(plan(tmp_path)), "--out", str(tmp_path / "out")]
    assert run([*words, "--json"]) == 0
    out = capsys.readouterr()
    answer = json.loads(out.out)
    assert "squares are 32 pixels wide, and edges need 44" in out.err
    assert answer["chart"] == "checkerboard"
    assert (answer["edges"], answer["places"], answer["focus"]) == ([], [], {})
    distortion = answer["geometry"]["distortion"]
    assert abs(distortion["value"]) < 4 * distortion["std"]
    assert answer["geometry"]["poses"][0]["points"] > 80
    assert not answer["geometry"]["poses"][0]["bent"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--range", "2000", "--range", "3000"],
            "2 ranges for 1 photographs: give --range MM once",
        ),
        (["--range", "0"], "ranges 0 mm: each must be above 0"),
        (["--places", "4"], "4 places across, 2 edges: an odd number"),
        (["--channel", "Z"], "channel Z: allowed are M"),
        ([], "a.tif: no chart was found"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    image = write_scene(tmp_path / "a.tif", [np.full((300, 400), 3000.0)])
    assert run(["chart", str(image), str(plan(tmp_path)), *options]) == 2
    err = capsys.readouterr().err
    assert words in err.splitlines()[-1]
