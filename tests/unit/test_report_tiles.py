"""A report of tiles: one model over the frame, the wavefronts of one tile, and each tile at its place."""

from __future__ import annotations

import csv
import re
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.errors import InputError
from labkit.field.session_geometry import corner_numbers, session_geometry
from labkit.field.terms import lens_terms
from labkit.findings.findings import Finding
from labkit.key import Key
from labkit.report.contents import contents
from labkit.report.field.geometry_charts import distortion_factor, lateral_over
from labkit.report.field.tables import field_table
from labkit.report.field.tile_charts import tile_sight
from labkit.report.html import field_artist, write_report
from labkit.report.photographs import Photographs
from labkit.report.tiles import central_tile, of_tile, tiles_of
from labkit.results import Results
from tests.results_samples import REJECTED, some_results
from tests.tiled_samples import (
    FRAME,
    K1_PER_MM2,
    LATERAL,
    NEAR_MM,
    SHAPE,
    TILT,
    a_model,
    tile_corners_px,
    tiled_results,
)
from tests.unit.test_report_numbers import bare_numbers


def kept(results: Results, folder: Path) -> Results:
    place = folder / "session" / "results" / "latest"
    place.mkdir(parents=True)
    return replace(results, folder=place)


def test_the_tile_nearest_to_the_centre_stands_for_the_lens() -> None:
    results = tiled_results()
    assert central_tile(results) == (1, 2)
    at_centre = of_tile(results, (1, 2))
    assert {(w.range_mm, w.channel, w.tile) for w in at_centre} == {
        (r, c, (1, 2)) for r in (3000.0, 3200.0) for c in "RB"
    }
    doubtful = tuple(
        replace(w, test=REJECTED) if w.tile == (1, 2) and w.channel == "R" else w
        for w in results
    )
    assert central_tile(replace(results, wavefronts=doubtful)) != (1, 2)
    assert central_tile(some_results()) is None


def test_a_tile_that_was_not_fitted_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no tile \(7, 7\) was fitted: .*\(0, 0\) to"):
        write_report(kept(tiled_results(), tmp_path), tile=(7, 7))
    with pytest.raises(InputError, match="these results have no tiles"):
        of_tile(some_results(), (0, 0))


def test_a_tile_that_was_left_out_is_drawn_where_its_neighbours_predict_it() -> None:
    results = tiled_results()
    sight = tile_sight(results, results[Key(NEAR_MM, "R", (1, 2))])
    assert set(sight.left_out) == {(0, 1)}
    assert sight.doubtful == [(2, 4)]
    assert not sight.apart
    assert len(sight.fits) == SHAPE[0] * SHAPE[1] - 1
    # distortion bends the grid by up to 20 pixels, of which a plane keeps most
    assert sight.corners_px((0, 1)) == pytest.approx(tile_corners_px((0, 1)), abs=25)


def test_tiles_that_no_photograph_shows_are_left_out_too() -> None:
    absent = Finding("tiles-not-found", None, {"range_mm": NEAR_MM, "tiles": [[5, 5]]}, "")
    elsewhere = replace(absent, numbers={"range_mm": 3200.0, "tiles": [[6, 6]]})
    results = tiled_results(findings=(absent, elsewhere))
    sight = tile_sight(results, results[Key(NEAR_MM, "R", (1, 2))])
    assert set(sight.left_out) == {(5, 5)}


def test_distortion_and_lateral_colour_are_drawn_as_they_are() -> None:
    results = tiled_results()
    geometry = session_geometry(results)
    assert geometry is not None
    assert geometry.k1_per_mm2.value == pytest.approx(K1_PER_MM2, rel=0.02)
    at, shift, _ = lateral_over(geometry, "B")
    assert shift == pytest.approx(1e3 * LATERAL * at.each_mm, abs=0.02)
    # 0.42 of a rectangle of 3.6 mm, over the distortion of 0.26 mm in the corners
    assert distortion_factor(geometry) == 5.0


def test_the_table_has_tilt_curvature_and_coma_of_each_channel() -> None:
    terms = [lens_terms(a_model(), channel) for channel in "RB"]
    rows = {row.cells[0]: row.cells[2:] for row in field_table(terms).rows}
    assert len(rows["Sensor tilt, down"]) == 2
    slope = 0.05 * 2 * a_model().um_per_wave / FRAME.radius_mm
    assert rows["Sensor tilt, down"][0].startswith(f"{slope:.3f}")
    assert rows["Constant coma"][0].startswith("0.0361")  # of 0.03 down and 0.02 left


def test_limits_screws_and_places_have_their_tables() -> None:
    results = tiled_results()
    artist = field_artist(results, results[Key(NEAR_MM, "R", (1, 2))])
    assert artist is not None
    tables = artist.contents()
    limits, screws, places = (
        tables[name] for name in ("limit_table", "screw_table", "places_table")
    )
    assert limits is not None
    assert {row.cells[0]: row.cells[4] for row in limits.rows} == {
        "tilt_um": "pass",
        "coma_waves": "fail",
        "curvature_um": "cannot tell",
        "distortion_percent": "fail",
        "lateral_colour_um": "fail",
    }
    assert artist.camera_tilt is not None
    # no target is tilted here: all of the slope is the camera's
    slope = 2 * a_model().um_per_wave / FRAME.radius_mm * np.array(TILT)
    pull = (artist.camera_tilt.value - slope) / np.sqrt(
        np.diag(artist.camera_tilt.covariance)
    )
    assert np.abs(pull).max() < 3
    assert tables["tilt_table"] is not None
    assert screws is not None
    # the sensor recedes to the left and down: the screw there goes towards the lens
    assert [row.cells[2][0] == "−" for row in screws.rows] == [True, False, False]
    assert [row.cells[3] for row in screws.rows].count("none") == 1
    assert places is not None
    by_name = {row.cells[0]: row.cells[2] for row in places.rows}
    printed = by_name["Distortion, k₁"].split("\N{NO-BREAK SPACE}")[0]
    assert float(printed.replace("−", "-")) == pytest.approx(1e6 * K1_PER_MM2, rel=0.02)


def test_distortion_and_lateral_colour_in_the_corners_by_closed_forms() -> None:
    geometry = session_geometry(tiled_results())
    assert geometry is not None
    corners = corner_numbers(geometry)
    percent = 100 * K1_PER_MM2 * FRAME.radius_mm**2
    for number in corners["distortion_percent"].values():
        assert number.value == pytest.approx(percent, rel=0.002)
        assert 0 < number.std < 0.002
    for number in corners["lateral_colour_um"].values():
        assert number.value == pytest.approx(1e3 * LATERAL * FRAME.radius_mm, rel=0.02)
    assert session_geometry(some_results()) is None


def test_checks_count_all_tiles_and_name_few() -> None:
    results = tiled_results()
    rejected = tuple(replace(w, test=REJECTED) for w in results)
    whole = replace(results, wavefronts=rejected)
    one = of_tile(whole, (1, 2))
    checks = contents(whole, one, [], Photographs(), set())["checks"]
    (optimum,) = (c["text"] for c in checks if c["text"].startswith("optimum"))
    assert optimum.startswith("optimum found in 0 of 56 fits")
    assert optimum.endswith("and 50 more")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(kept(tiled_results(), tmp_path_factory.mktemp("tiles")))


@pytest.mark.slow
def test_a_page_of_tiles_has_the_field_and_one_tiles_wavefronts(page: Path) -> None:
    html = page.read_text()
    figures = {path.name for path in (page.parent / "figures").iterdir()}
    assert {"field_map_focus_R.png", "field_psf_R.png", "field_distortion.svg"} <= figures
    assert {"field_coma_B.svg", "field_tiles.png", "psf_R.png"} <= figures
    assert html.count("<h2>Over the field</h2>") == 1
    assert "of one tile of 14: row 1, column 2, counted from 0" in html
    for alt in re.findall(r'<img [^>]*alt="([^"]*)"', html):
        assert len(alt.split()) > 4
    assert bare_numbers(html) == []


@pytest.mark.slow
def test_an_open_sign_is_said_before_any_number_of_the_field(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "sign of focus, tilt, curvature and astigmatism is open" not in page.read_text()
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})
    one = tiled_results()
    near = (w for w in one if w.range_mm == NEAR_MM)
    open_signs = tuple(replace(w, sign_open=True) for w in near)
    html = write_report(kept(replace(one, wavefronts=open_signs), tmp_path)).read_text()
    assert "sign of focus, tilt, curvature and astigmatism is open" in html
    assert "No screw can be told to move" in html
    assert html.index("astigmatism is open") < html.index("Sensor tilt, down")


@pytest.mark.slow
def test_the_page_holds_the_fields_numbers_and_every_tiles(page: Path) -> None:
    links = re.findall(r'download="([^"]+)" href="data:[^,]*,([^"]+)"', page.read_text())
    files = {name: b64decode(content).decode() for name, content in links}
    assert "results.json" not in files  # of many tiles it lies beside the page
    tiles = list(csv.DictReader(files["tiles.csv"].splitlines()))
    assert len(tiles) == 56
    assert [row["accepted"] for row in tiles].count("false") == 1
    terms = list(csv.DictReader(files["field.csv"].splitlines()))
    assert len(terms) == a_model().waves.size
    lines = list(csv.DictReader(files["field_profiles.csv"].splitlines()))
    assert {row["quantity"] for row in lines} >= {"focus_error_um", "mtf_at_40_per_mm"}
    assert len({row["line"] for row in lines}) == 4


@pytest.mark.slow
def test_more_tiles_make_no_more_figures(page: Path, tmp_path: Path) -> None:
    few = write_report(kept(tiled_results((3, 3)), tmp_path), tile=(2, 0))
    count = len(list((few.parent / "figures").iterdir()))
    assert count == len(list((page.parent / "figures").iterdir()))
    assert "row 2, column 0, counted from 0" in few.read_text()


def test_results_without_tiles_have_no_section_of_the_field() -> None:
    results = some_results()
    words = contents(results, results, [], Photographs(), set())
    assert "field" not in words["sections"]
    assert "field_table" not in words
    assert tiles_of(results) == ()
    assert np.all([w.tile is None for w in of_tile(results, None)])
