"""`labkit field`: tables, JSON and curves of a session's field."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.cli import field as command
from labkit.cli.command_line import run
from labkit.field.session_geometry import session_geometry
from labkit.field.summary import LEAN_NOTE, summarise_field
from labkit.field.tables import coverage, headline
from labkit.findings.findings import Finding
from labkit.key import Key
from labkit.optics.field import FieldModel
from labkit.results import Placement, Results
from tests.field_samples import FRAME, a_field
from tests.results_samples import a_wavefront, some_results
from tests.tiled_samples import TILED, tiled_results

CORNERS = np.array([[100.0, 100], [100, 160], [160, 160], [160, 100]])


def a_lens() -> FieldModel:
    model = a_field()
    model.waves[0, :4, 0] = 0.01, 0.03, -0.05, -0.02
    model.waves[0, 0, 4] = 0.02
    return model


def tiled(model: FieldModel | None = None, pull: float = 0.0) -> Results:
    """Two tiles in green with the field's own modes, one of them rejected at a range; one tile not found."""
    model = a_lens() if model is None else model
    fits = []
    for column in (0, 1):
        corners = CORNERS + np.array([0, 300 * column])
        place = Placement((90, 90 + 300 * column), (80, 80), corners[None])
        waves, covariance = model.modes("G", corners.mean(axis=0))
        fit = a_wavefront(
            3000.0,
            "G",
            noll=model.noll,
            waves=waves,
            covariance=covariance,
            tile=(0, column),
            placement=place,
            pulls=np.full(len(model.noll), pull),
        )
        fits += [fit, replace(fit, range_mm=3100.0)]
    assert fits[-1].test is not None
    fits[-1] = replace(fits[-1], test=replace(fits[-1].test, accepted=False))
    findings = (
        Finding("tiles-not-found", None, {"range_mm": 3000.0, "tiles": [[1, 1]]}, "one"),
        Finding("tile-left-out", Key(3000.0, "G", (0, 1)), {}, "tile (0, 1) is clipped"),
    )
    plan = some_results().plan.replace(limits={"corner_mtf50": 40, "tilt_um": 0.5})
    return some_results(plan=plan, wavefronts=tuple(fits), findings=findings, field=model)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "a_session", lambda path: None)
    monkeypatch.setattr(Results, "load", lambda session, name: tiled())


@pytest.mark.usefixtures("shown")
def test_the_field_is_shown_in_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["field", "night-3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    slope = 2 * np.hypot(0.03, 0.05) / FRAME.radius_mm * a_lens().um_per_wave
    assert lines[0].startswith(f"sensor tilt in G: {slope:.2f} ± ")
    assert "towards -59° ± 1° (0° right, 90° down)" in lines[0]
    words = {line.split("  ")[0]: line.split() for line in lines}
    # the points come twice, at last with the movement to best focus
    moved = words["centre"][2]
    focus = a_lens().modes("G", FRAME.centre_px)[0][0] * a_lens().um_per_wave
    assert float(moved) == pytest.approx(-focus, abs=3)
    assert words["corner_mtf50"][-1] == "pass"
    assert words["tilt_um"][-1] == "fail"
    assert words["0, 1"][-5:] == ["tile", "(0,", "1)", "is", "clipped"]
    assert "not found at 3000 mm" in " ".join(words["1, 1"])


@pytest.mark.usefixtures("shown")
def test_json_has_terms_points_curves_limits_and_tiles(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["--json", "field", "show", "night-3"]) == 0
    answer = json.loads(capsys.readouterr().out)
    terms = answer["terms"]["G"]
    slope = 2 / FRAME.radius_mm * a_lens().um_per_wave
    assert terms["tilt_um_per_mm"]["value"] == pytest.approx([-0.05 * slope, 0.03 * slope])
    assert terms["coma_waves"]["value"] == pytest.approx([0, 0.02])
    assert len(answer["points"]) == 18
    assert len(answer["profiles"]) == 12
    assert {curve["place"] for curve in answer["through_focus"]} >= {"centre", "top left"}
    assert [one["verdict"] for one in answer["limits"]] == ["pass", "fail"]
    assert [tile["tile"] for tile in answer["tiles"]] == [[0, 0], [0, 1], [1, 1]]


@pytest.mark.usefixtures("shown")
def test_curves_are_written_one_value_a_line(tmp_path: Path) -> None:
    path = tmp_path / "curves.csv"
    assert run(["field", "night-3", "--csv", str(path)]) == 0
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    heights = [
        float(row["height_mm"])
        for row in rows
        if (row["curve"], row["azimuth_deg"], row["surface"], row["frequency_per_mm"])
        == ("mtf", "0", "sagittal", "20")
    ]
    assert heights[0] == -heights[-1] == pytest.approx(-768 / 2 * 5.2e-3, rel=1e-5)
    assert {row["curve"] for row in rows} == {"mtf", "mtf50", "focus_um", "through_focus"}
    assert all(float(row["std"]) >= 0 for row in rows)


def test_distortion_lateral_colour_and_screws_are_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    places = [[0, 30], [26, -15], [-26, -15]]
    plan = TILED.replace(
        mount={"screws_mm": places, "screw_pitch_mm": 0.5},
        limits={"distortion_percent": 50, "lateral_colour_um": 1000},
    )
    results = tiled_results(plan=plan)
    monkeypatch.setattr(command, "a_session", lambda path: None)
    monkeypatch.setattr(Results, "load", lambda session, name: results)
    assert run(["field", "night-3"]) == 0
    out = capsys.readouterr().out
    geometry = session_geometry(results)
    assert geometry is not None
    words = [line.split() for line in out.splitlines()]
    k1 = str(geometry.k1_per_mm2).removesuffix(" /mm²")
    assert ["distortion,", "k1", "1/mm²", *k1.split()] in words
    assert "lateral colour, top left, B" in out
    assert "which a known move has to prove" in out
    last = out.splitlines()[-2:]
    assert [line.split()[-1] for line in last] == ["pass", "pass"]
    answer = summarise_field(results).as_json()
    assert answer["geometry"]["distortion"]["k1_per_mm2"] == geometry.k1_per_mm2.as_json()
    heights = [screw["height_um"]["value"] for screw in answer["screws"]]
    # screws about the frame's centre: a plane through 0
    assert sum(heights) == pytest.approx(0, abs=1e-9)


def test_a_session_without_a_field_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "a_session", lambda path: None)
    monkeypatch.setattr(Results, "load", lambda session, name: some_results())
    assert run(["field", "night-3"]) == 2
    error = capsys.readouterr().err.strip()
    assert error.count("\n") == 0
    assert "these results have no field: photograph a grid of targets" in error


def test_an_unknown_channel_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "a_session", lambda path: None)
    monkeypatch.setattr(Results, "load", lambda session, name: tiled())
    assert run(["field", "night-3", "--channel", "R"]) == 2
    assert "the field has no channel R: it has G" in capsys.readouterr().err


def test_tiles_show_their_fits_and_agreement_with_the_model() -> None:
    summary = summarise_field(tiled(pull=2.0))
    # two tiles of 60 pixels, 300 apart, in a frame of 512 by 768
    assert summary.covered == pytest.approx((60 / 512, 360 / 768))
    assert "47% of the frame's width and 12% of its height" in coverage(summary.covered)
    first, second, absent = summary.tiles
    assert first.centre_px == pytest.approx([130, 130])
    assert (first.fits, first.accepted) == (2, 2)
    assert (second.fits, second.accepted) == (2, 1)
    assert first.pull == pytest.approx(2.0)
    assert (absent.fits, absent.remarks) == (0, ("not found at 3000 mm",))


def test_a_tilt_within_its_errors_has_no_direction() -> None:
    assert headline(summarise_field(tiled(a_field()))).endswith(
        "the errors leave its direction open"
    )
    assert "not determined" in headline(summarise_field(tiled(a_field(order=0))))


def test_an_open_sign_is_said_and_moves_no_screw() -> None:
    sure = tiled_results()
    known = summarise_field(sure)
    assert len(known.screws) == 3
    assert LEAN_NOTE not in known.notes
    wavefronts = tuple(replace(w, sign_open=True) for w in sure)
    one_range = tuple(w for w in sure if w.range_mm == 3000.0)
    for fits in (wavefronts, one_range):
        summary = summarise_field(replace(sure, wavefronts=fits))
        assert summary.screws == ()
        assert "or the opposite way" in headline(summary)
        assert any(note.endswith("a second range tells") for note in summary.notes)
        # and the target's tilt is named as unknown
        named = [LEAN_NOTE in note or "perspective alone" in note for note in summary.notes]
        assert any(named)
        assert summary.as_json()["sign_open"] is True
