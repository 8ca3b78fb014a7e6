"""The report as a file: whole in itself, truthful, safe, and written in one go."""

import json
import os
import re
from base64 import b64decode
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.errors import DataError, InputError
from labkit.plan import parse_plan
from labkit.report.html import write_report

pytestmark = pytest.mark.slow  # every test draws all figures

PLAN = """
[lens]
focal_length_mm = 70.0
f_number = 2.8
[sensor]
pixel_pitch_um = 4.78
[[channel]]
name = "R"
wavelength_nm = 650.0
[[channel]]
name = "B"
wavelength_nm = 450.0
[target]
kind = "sierpinski"
order = 5
size_mm = 46.8
"""


def wavefront(range_mm: float | None, channel: str, defocus: float) -> dict[str, Any]:
    return {
        "range_mm": range_mm,
        "channel": channel,
        "wavelength_nm": 650.0 if channel == "R" else 450.0,
        "noll": [4, 5, 8],
        "waves_rms": [defocus, 0.03, -0.04],
        "std": [0.0011, 0.0012, 0.0013],
        "covariance": np.diag([0.0011**2, 0.0012**2, 0.0013**2]).tolist(),
        "pose": [0.01, 0, 0, 0, 0, 0, 0, 0],
        "gain": 0.4567,
        "read_noise": 1.23,
        "chi2_per_pixel": 1.018,
        "global_test": {"name": "embedding", "p_value": 0.37, "accepted": True, "starts": 3},
        "seconds": 4.2,
        "frames": [f"target_{range_mm}_{channel}.dng"],
    }


def results() -> dict[str, Any]:
    """Defocus at 3000 mm of a lens focused at 2986.8 mm, and at 3200 mm; not exact: nothing here is fitted."""
    return {
        "schema": 1,
        "labkit_version": "0.1.0",
        "created": "2026-11-21T12:00:00Z",
        "plan_sha256": "ab" * 32,
        "convention": "corrected",
        "reference_wavelength_nm": 450.0,
        "wavefronts": [wavefront(r, c, d) for r, d in ((3000.0, 0.0751), (3200.0, 1.1432)) for c in ("R", "B")],
        "focus": {
            "best_focus_mm": {"R": {"value": 2986.84, "std": 0.42}, "B": {"value": 2987.31, "std": 0.37}},
            "pupil_magnification": {"value": 0.981, "std": 0.038, "identifiable": False},
            "residual_waves": {"R": [0.0011, -0.0022], "B": [0.0013, -0.0024]},
            "covariance": [[1.0]],
        },
        "warnings": ["no dark frames: the black level of the raw files was used"],
    }


def write_results(folder: Path, content: dict[str, Any], residuals: bool = True) -> Path:
    """A session with results of round Gaussian PSFs and residuals of pure noise."""
    results_folder = folder / "session" / "results" / "latest"
    results_folder.mkdir(parents=True, exist_ok=True)
    (folder / "session" / "plan.toml").write_text(PLAN)
    (results_folder / "results.json").write_text(json.dumps(content))
    rng = np.random.default_rng(1)
    axis = np.arange(-40, 41) * 0.6
    psf = np.exp(-(axis[:, None] ** 2 + axis[None, :] ** 2) / (2 * 3.0**2))
    psfs: dict[str, Any] = {"spacing_um": np.array(0.6)}
    arrays: dict[str, Any] = {}
    for entry in content["wavefronts"]:
        key = f"{'none' if entry['range_mm'] is None else format(entry['range_mm'], 'g')}_{entry['channel']}"
        psfs[f"psf_{key}"] = psf / psf.sum()
        arrays[f"model_{key}"] = np.full((2, 1, 24, 30), 1000.0, np.float32)
        arrays[f"sigma_{key}"] = np.full((2, 1, 24, 30), 20.0, np.float32)
        data = rng.normal(1000.0, 20.0, (2, 1, 24, 30)).astype(np.float32)
        data[0, 0, 3, 4] = np.nan
        arrays[f"data_{key}"] = data
    np.savez(results_folder / "psf.npz", **psfs)
    if residuals:
        np.savez(results_folder / "residuals.npz", **arrays)
    return results_folder


class Page(HTMLParser):
    """What a page shows, and what it points to."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += " " + data

    def words(self) -> str:
        return " ".join(self.text.split())


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(write_results(tmp_path_factory.mktemp("report"), results()))


def test_the_report_needs_no_other_file(report: Path) -> None:
    page = Page(report.read_text())
    links = [
        v or "" for _, attrs in page.tags for name, v in attrs.items() if name in {"src", "href", "srcset", "data"}
    ]
    assert links
    assert all(link.startswith(("data:image/", "#")) for link in links)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert "url(" not in report.read_text()
    assert "@import" not in report.read_text()


def test_drawings_in_the_report_point_nowhere_else(report: Path) -> None:
    sources = [attrs["src"] or "" for tag, attrs in Page(report.read_text()).tags if tag == "img"]
    drawings = [b64decode(s.partition(",")[2]).decode() for s in sources if s.startswith("data:image/svg")]
    assert drawings
    for drawing in drawings:
        assert drawing.count("href=") == drawing.count('href="#')


def test_links_in_the_page_lead_somewhere(report: Path) -> None:
    tags = Page(report.read_text()).tags
    anchors = {attrs["id"] for _, attrs in tags if "id" in attrs}
    assert {(attrs.get("href") or "")[1:] for tag, attrs in tags if tag == "a"} <= anchors


def test_every_image_says_in_words_what_it_shows(report: Path) -> None:
    images = [attrs for tag, attrs in Page(report.read_text()).tags if tag == "img"]
    # focus, two ranges of modes, PSFs, MTFs, four fits, Q-Q
    assert len(images) == 10
    assert all(len(attrs["alt"] or "") > 20 for attrs in images)


def test_the_answer_is_given_to_the_digits_of_its_error(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "2986.84 ± 0.42 mm" in words
    assert "2987.31 ± 0.37 mm" in words
    assert "0.981 ± 0.038" in words
    # sqrt(0.03² + 0.04²) = 0.05; its error sqrt((0.6·0.0012)² + (0.8·0.0013)²) = 0.00126
    assert "0.0500 ± 0.0013" in words
    assert "It cannot be told at these ranges." in words


def test_tables_hold_every_mode_in_waves_and_nanometres(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "5 oblique astigmatism 0.0300 ± 0.0012 13.5" in words  # 0.03 · 450 nm
    assert "8 horizontal coma −0.0400 ± 0.0013 −18.0" in words
    assert "1.1432 ± 0.0011 514.4" in words


@pytest.mark.parametrize(
    "shown",
    ["0.4567", "1.23", "1.018", "embedding, p = 0.37, 3 starts", "1.10, −2.20", "ab" * 32, "target_3000.0_R.dng"],
)
def test_tables_and_provenance_hold(report: Path, shown: str) -> None:
    assert shown in Page(report.read_text()).words()


def test_warnings_stand_before_the_figures(report: Path) -> None:
    html = report.read_text()
    assert html.index("no dark frames: the black level") < html.index("<figure>")


def test_figures_are_files_too(report: Path) -> None:
    names = {p.name for p in (report.parent / "figures").iterdir()}
    assert {
        "focus.png",
        "focus.svg",
        "psf.png",
        "mtf.svg",
        "zernike_3000.svg",
        "fit_3200_B.png",
        "residuals.svg",
    } <= names


def test_figures_of_an_earlier_fit_do_not_stay(tmp_path: Path) -> None:
    folder = write_results(tmp_path, results())
    write_report(folder)
    one = results() | {"wavefronts": results()["wavefronts"][:1], "focus": None}
    write_report(write_results(tmp_path, one))
    names = {p.name for p in (folder / "figures").iterdir()}
    assert "focus.png" not in names
    assert [n for n in names if n.startswith("fit_")] == ["fit_3000_R.png"]


def test_hostile_strings_are_shown_and_not_obeyed(tmp_path: Path) -> None:
    content, hostile = results(), "<script>alert(1)</script>"
    content["wavefronts"] = [wavefront(3000.0, "$x_</th>", 0.1)]
    content["wavefronts"][0]["frames"] = [hostile]
    content["warnings"] = [hostile, '"><img src=http://example.com/x.png>']
    content["focus"], content["labkit_version"] = None, hostile
    html = write_report(write_results(tmp_path, content, residuals=False)).read_text()
    assert hostile not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html
    assert "src=http" not in html.replace("&gt;&lt;img src=http", "")
    assert "$x_&lt;/th&gt;" in html


def test_without_a_focus_fit_it_says_so(tmp_path: Path) -> None:
    content = results() | {"focus": None}
    words = Page(write_report(write_results(tmp_path, content)).read_text()).words()
    assert "Best focus not fitted" in words
    assert "2986" not in words


def test_one_fit_without_range_residuals_or_noise_figures_is_reported(tmp_path: Path) -> None:
    content = results() | {"focus": None, "warnings": [], "wavefronts": [wavefront(None, "M", 0.1)]}
    content["wavefronts"][0] |= {"gain": None, "read_noise": None, "global_test": None, "std": [None, None, None]}
    del content["wavefronts"][0]["covariance"]
    words = Page(write_report(write_results(tmp_path, content, residuals=False)).read_text()).words()
    assert "range not known" in words
    assert "1 optimum untested" in words
    assert not re.search(r"\bnan\b", words, re.IGNORECASE)


def test_a_rejected_optimum_is_told_at_the_top(tmp_path: Path) -> None:
    content = results()
    content["wavefronts"][2]["global_test"]["accepted"] = False
    html = write_report(write_results(tmp_path, content, residuals=False)).read_text()
    assert html.index("1 of 4 optima rejected as local minima: 3200 mm R") < html.index("<figure>")


def test_a_plan_may_be_handed_in(tmp_path: Path) -> None:
    folder = write_results(tmp_path, results(), residuals=False)
    (tmp_path / "session" / "plan.toml").unlink()
    plan = parse_plan(PLAN.replace("70.0", "71.5"), tmp_path)
    assert "71.5 mm f/2.8" in write_report(folder, plan).read_text()


def test_a_report_that_fails_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_results(tmp_path, results(), residuals=False)
    (folder / "report.html").write_text("old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match=r"cannot write .*No space"):
        write_report(folder)
    assert (folder / "report.html").read_text() == "old"
    assert not [p for p in folder.rglob("*") if p.name.startswith(".")]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "no .*results.json"),
        ("{", "cannot read"),
        ('{"schema": 2}', "schema 2"),
        ('{"schema": 1}', "labkit_version"),
    ],
)
def test_results_that_cannot_be_read_give_one_line(tmp_path: Path, text: str | None, complaint: str) -> None:
    if text is not None:
        (tmp_path / "results.json").write_text(text)
    with pytest.raises(DataError, match=complaint) as caught:
        write_report(tmp_path)
    assert "\n" not in str(caught.value)
