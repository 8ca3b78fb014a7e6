"""The report as a file: whole in itself, truthful, safe, and written in one go."""

import csv
import json
import os
import re
from base64 import b64decode, b64encode
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import labkit
from labkit.errors import InputError
from labkit.optics.metrics import psf_value
from labkit.optics.rim import Diaphragm, Rim
from labkit.optics.wavefront import FittedWavefront
from labkit.report.focus_charts import defocus_chart
from labkit.report.html import write_report
from labkit.results.model import PartTried, Wavefront
from labkit.spectra import channel_light
from labkit.uncertain import Uncertain
from tests.results_samples import ACCEPTED, PLAN, a_wavefront, noted, some_results, written

pytestmark = pytest.mark.slow  # every test draws all figures


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
    return write_report(written(tmp_path_factory.mktemp("report")))


@pytest.fixture
def words_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report without its figures, which take most of the time."""
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})


def test_the_report_needs_no_other_file(report: Path) -> None:
    page = Page(report.read_text())
    links = [
        v or ""
        for _, attrs in page.tags
        for name, v in attrs.items()
        if name in {"src", "href", "srcset", "data"}
    ]
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert not {"link", "iframe", "object", "embed"} & {tag for tag, _ in page.tags}
    assert "url(" not in report.read_text()
    assert "@import" not in report.read_text()


def test_the_page_runs_its_own_script_alone(report: Path) -> None:
    html = report.read_text()
    (script,) = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    checksum = b64encode(sha256(script.encode()).digest()).decode()
    assert (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{checksum}'"
        in html
    )
    assert "http" not in script


def test_raw_results_and_curves_are_files_in_the_page(report: Path) -> None:
    links = {
        a["download"]: a["href"] or ""
        for tag, a in Page(report.read_text()).tags
        if a.get("download")
    }
    assert set(links) == {
        "results.json",
        "zernike.csv",
        "mtf.csv",
        "through_focus.csv",
        "encircled_energy.csv",
    }
    files = {name: b64decode(uri.partition(",")[2]).decode() for name, uri in links.items()}
    assert json.loads(files["results.json"]) == json.loads(
        (report.parent / "results.json").read_text()
    )
    rows = list(csv.DictReader(files["zernike.csv"].splitlines()))
    assert len(rows) == 4 * 3
    assert rows[2]["mode"] == "horizontal coma"
    assert float(rows[2]["std_nm_rms"]) == pytest.approx(0.0013 * 450)
    perfect = [
        row
        for row in csv.DictReader(files["mtf.csv"].splitlines())
        if row["channel"] == "R"
    ]
    assert float(perfect[0]["mtf"]) == float(perfect[0]["diffraction_limit"]) == 1.0


def test_drawings_in_the_report_point_nowhere_else(report: Path) -> None:
    sources = [
        attrs["src"] or "" for tag, attrs in Page(report.read_text()).tags if tag == "img"
    ]
    drawings = [
        b64decode(s.partition(",")[2]).decode()
        for s in sources
        if s.startswith("data:image/svg")
    ]
    assert drawings
    for drawing in drawings:
        assert drawing.count("href=") == drawing.count('href="#')


def test_links_in_the_page_lead_somewhere(report: Path) -> None:
    tags = Page(report.read_text()).tags
    anchors = {attrs["id"] for _, attrs in tags if "id" in attrs}
    links = {
        attrs.get("href") or ""
        for tag, attrs in tags
        if tag == "a" and "download" not in attrs
    }
    assert {link[1:] for link in links} <= anchors


def test_every_image_says_in_words_what_it_shows(report: Path) -> None:
    images = [attrs for tag, attrs in Page(report.read_text()).tags if tag == "img"]
    # of two colours MTF, PSF and map at best focus; energy; two through focus, two of focus; of two ranges map, PSF and
    # Q-Q; modes, budget, target's place; four fits
    assert len(images) == 6 + 1 + 4 + 6 + 3 + 4
    assert all(len(attrs["alt"] or "") > 20 for attrs in images)


def test_the_answer_is_given_to_the_digits_of_its_error(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "mm R 2986.84 ± 0.42 B 2987.31 ± 0.37" in words
    assert "0.981 ± 0.038" in words
    # sqrt(0.03² + 0.04²) = 0.05; its error sqrt((0.6·0.0012)² + (0.8·0.0013)²) = 0.00126
    assert "0.0500 ± 0.0013" in words
    assert "These ranges do not determine the pupil magnification." in words


def test_numbers_at_best_focus_stand_in_a_table(report: Path) -> None:
    words = Page(report.read_text()).words()
    # defocus 0.0751 left out: 0.05 waves RMS in red light, exp(-(2π · 0.05 · 450/650)²) = 0.954 by Maréchal
    assert re.search(r"Strehl ratio 0\.95\d+ ± 0\.00\d+", words)
    assert "at the reference wavelength waves 0.0500 ± 0.0013" in words
    assert re.search(r"RMS nm 22\.50 ± 0\.5\d", words)  # of 450 nm
    # 0.40397 of the cutoff, 1/(0.65 µm · 2.8) and 1/(0.45 µm · 2.8): Goodman's MTF is one half there;
    # 0.006 µm of 1.82 and of 1.26 is 0.33 % and 0.48 %
    assert "diffraction limit of this pupil cycles/mm 221.96 ± 0.73 320.6 ± 1.5" in words
    assert "Astigmatism waves RMS not fitted not fitted" in words  # Noll 6 is missing


def test_a_number_is_never_parted_from_its_error(report: Path) -> None:
    text = Page(report.read_text()).text
    assert len(re.findall(r"\d\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}\d", text)) > 50
    assert not re.search(r"\d ±|± \d", text)


def test_a_warnings_number_is_not_parted_from_its_error_either(
    tmp_path: Path, words_only: None
) -> None:
    html = write_report(
        written(tmp_path, findings=noted("a filter: rows 0.551 ± 0.005 px"))
    ).read_text()
    assert "rows 0.551\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.005 px" in html


def test_what_cannot_have_an_error_needs_no_note_of_it(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "From the photographs at 3000 mm 3000 mm" in words
    assert "Without an error: a by the pixel pitch" in words
    for pedantry in ("a definition", "counted", "standard errors themselves"):
        assert pedantry not in words


def test_optimum_and_model_are_two_checks_under_a_headline(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "all numbers hold within their errors" in words
    assert "optimum found in 4 of 4 fits" in words
    assert "model explains the photographs in 4 of 4 fits" in words
    assert "found explains the photographs" in words  # a row of the fits


def test_tables_hold_every_mode_in_waves_and_nanometres(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "5 3 6 oblique astigmatism 0.0300 ± 0.0012" in words
    assert "5 3 6 oblique astigmatism 13.50 ± 0.54" in words  # 0.03 · 450 nm
    assert "8 8 7 horizontal coma −0.0400 ± 0.0013" in words
    assert "1.1432 ± 0.0011" in words


@pytest.mark.parametrize(
    "shown",
    [
        "0.4567",
        "1.23",
        "1.018",
        "embedding, p = 0.37, 3 starts",
        "1.10 ± 0.50, −2.20 ± 0.60",
        "ab" * 32,
        "target_3000.0_R_0.dng",
    ],
)
def test_tables_and_provenance_hold(report: Path, shown: str) -> None:
    assert shown in Page(report.read_text()).words()


def test_the_lens_and_its_errors_have_sections(report: Path) -> None:
    words = Page(report.read_text()).words()
    assert "Focal length mm 69.31 ± 0.12 70.0 ± 1.4" in words
    assert "best focus, R mm 0.300 0.100 0.200 0.200 0.424" in words
    assert "22.530 ± 0.050" in words  # blur of 0.0751 waves, µm


def test_what_was_found_of_the_camera_has_a_section(
    tmp_path: Path, report: Path, words_only: None
) -> None:
    tried = (PartTried("low_pass_filter", 812.3, True), PartTried("veil", 0.0, False))
    found = {
        "low_pass_filter.rows_px": Uncertain(0.55, 0.004, "px"),
        "spectrum.G.width_nm": Uncertain(12.0, 3.0, "nm"),
    }
    words = Page(
        write_report(written(tmp_path, model_parts=found, parts_tried=tried)).read_text()
    ).words()
    assert "low-pass filter along rows px 0.5500 ± 0.0040" in words
    assert "spectrum standard deviation, G nm 12.0 ± 3.0" in words
    assert "low-pass filter 812.3 taken in veil of stray light 0.0" in words
    assert "The camera" not in Page(report.read_text()).words()


def test_a_pupil_that_is_no_disc_is_drawn_and_explained(tmp_path: Path) -> None:
    rim = Rim((Diaphragm(6, 0.1),), obstructed=0.1)
    wavefronts = tuple(replace(w, rim=rim) for w in some_results().wavefronts)
    page = Page(write_report(written(tmp_path, wavefronts=wavefronts)).read_text())
    words = page.words()
    assert "The pupil as found" in words
    assert "the circle of equal clear area" in words
    assert f"of the full pupil {2.874 / rim.outer:.3f}" in words
    alts = [attrs.get("alt") or "" for _, attrs in page.tags]
    assert [alt for alt in alts if alt.startswith("The pupil as found: f/")]


def test_light_that_the_plan_names_is_there_by_its_name(
    tmp_path: Path, words_only: None
) -> None:
    channels = [{"name": "R", "light": "led", "wavelength_nm": 610.0}]
    lit = PLAN.replace(channel=channels, sensor={"filters": "Nikon D700"})
    tried = (PartTried("veil", 0.0, False),)
    folder = written(tmp_path, widest_light_nm={"R": 49.0}, plan=lit, parts_tried=tried)
    words = Page(write_report(folder).read_text()).words()
    width = channel_light("led", "Nikon D700", "R").width
    assert f"R led, Nikon D700 {width.value:.1f} ± {width.std:.1f} 49 " in words


def test_light_that_the_plan_does_not_state_is_named_with_what_it_may_do(
    tmp_path: Path, words_only: None
) -> None:
    folder = written(
        tmp_path, widest_light_nm={"R": 20.0}, parts_tried=(PartTried("veil", 0.0, False),)
    )
    words = Page(write_report(folder).read_text()).words()
    (shown,) = re.findall(
        r"R — — 20 \S+ ± \S+ (\S+) (\S+) 0.000 Without an error: a a bound", words
    )

    def difference(wavefront: Wavefront, fitted: FittedWavefront) -> float:
        """Of three wavelengths whose mean and standard deviation are those, and the mean one."""
        aside = 2**0.5 * 20.0 / wavefront.wavelength_nm
        lights = [
            replace(fitted, wavelength_nm=fitted.wavelength_nm * node)
            for node in (1 - aside, 1.0, 1 + aside)
        ]
        short, mean, long = (
            psf_value(
                light, 0.5, 2 * round(64 * fitted.wavelength_um * fitted.f_number) + 1
            )
            for light in lights
        )
        return 100 * float(np.abs((short + long) / 4 - mean / 2).sum())

    of_red = labkit.Results.load(folder).of_channel("R")
    assert float(shown[0]) == pytest.approx(
        difference(of_red[0], of_red[0].at_focus()), rel=0.05
    )
    assert float(shown[1]) == pytest.approx(
        max(difference(w, w.fitted) for w in of_red), rel=0.05
    )


def test_warnings_stand_before_the_figures(report: Path) -> None:
    html = report.read_text()
    assert html.index("no dark frames: the black level") < html.index(
        "<code>no-dark-frames</code>"
    )
    assert html.index("<code>no-dark-frames</code>") < html.index("<figure>")


def test_figures_are_files_too(report: Path) -> None:
    names = {p.name for p in (report.parent / "figures").iterdir()}
    assert {
        "focus.svg",
        "budget.svg",
        "psf_R.png",
        "mtf_B.svg",
        "opd_R.png",
        "opd_photographed_3200.png",
        "strehl_through_focus.svg",
        "encircled_energy.svg",
        "zernike.svg",
        "fit_3200_B.png",
        "residuals_3000.svg",
    } <= names


def test_figures_of_an_earlier_fit_do_not_stay(tmp_path: Path) -> None:
    write_report(written(tmp_path))
    folder = written(tmp_path, wavefronts=(a_wavefront(),), focus=None)
    write_report(folder)
    names = {p.name for p in (folder / "figures").iterdir()}
    assert "focus.svg" not in names
    assert [n for n in names if n.startswith("fit_")] == ["fit_3000_R.png"]


def test_hostile_strings_are_shown_and_not_obeyed(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>"
    folder = written(
        tmp_path,
        wavefronts=(
            a_wavefront(channel="$x_</th>", frames=(hostile,) * 2, residuals=None),
        ),
        focus=None,
        findings=noted(hostile, '"><img src=http://example.com/x.png>'),
        labkit_version=hostile,
    )
    html = write_report(folder).read_text()
    assert hostile not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html
    assert "src=http" not in html.replace("&gt;&lt;img src=http", "")
    assert "$x_&lt;/th&gt;" in html


def test_without_a_focus_fit_it_says_so(tmp_path: Path) -> None:
    words = Page(write_report(written(tmp_path, focus=None)).read_text()).words()
    assert "Best focus not fitted" in words
    assert "2986" not in words


def test_results_that_know_no_lens_are_reported(tmp_path: Path, words_only: None) -> None:
    html = write_report(written(tmp_path, lens=None, budget={})).read_text()
    assert "Where the errors come from" not in html
    assert "Focal length" not in html
    assert "Pupil magnification 0.981" in html
    assert "2986.84" in html


def test_one_fit_without_range_residuals_or_noise_figures_is_reported(
    tmp_path: Path,
) -> None:
    unknown = float("nan")
    one = a_wavefront(
        None,
        "M",
        gain=unknown,
        read_noise=unknown,
        test=None,
        covariance=np.full((3, 3), unknown),
        residuals=None,
    )
    words = Page(
        write_report(
            written(tmp_path, wavefronts=(one,), focus=None, findings=())
        ).read_text()
    ).words()
    assert "range not known" in words
    assert "M: the optimum is untested" in words
    assert not re.search(r"\bnan\b", words, re.IGNORECASE)


def test_a_rejected_optimum_stands_at_the_top(tmp_path: Path) -> None:
    rejected = a_wavefront(3200.0, test=replace(ACCEPTED, accepted=False))
    html = write_report(written(tmp_path, wavefronts=(a_wavefront(), rejected))).read_text()
    assert html.index("do not use R at 3200 mm: the optimum is doubtful") < html.index(
        "<figure>"
    )


def test_pixels_that_the_model_does_not_explain_are_another_matter(
    tmp_path: Path, words_only: None
) -> None:
    unlike = a_wavefront(3200.0, test=replace(ACCEPTED, explains=False))
    folder = written(
        tmp_path,
        wavefronts=(a_wavefront(), unlike),
        joint={"f_number": -0.31, "focal_length_mm": 0.1},
    )
    words = Page(write_report(folder).read_text()).words()
    assert "optimum found in 2 of 2 fits" in words
    assert "model explains the photographs in 1 of 2 fits, not: 3200 mm R" in words
    assert "moves no number by more than 0.31 standard errors" in words


def test_focus_is_drawn_where_the_rail_was_read_to_stand() -> None:
    wavefronts = [a_wavefront(r, measured_range_mm=r + 0.7) for r in (3000.0, 3200.0)]
    results = some_results(wavefronts=tuple(wavefronts))
    figure = defocus_chart(
        results, results.focus, lambda channel, ranges_mm: 0 * ranges_mm, 71.0
    )
    (points,) = (line for line in figure.axes[0].lines if "mm" in str(line.get_label()))
    np.testing.assert_allclose(np.asarray(points.get_xdata(), float), [3000.7, 3200.7])


def test_the_report_says_which_lens_it_was_made_with(
    tmp_path: Path, words_only: None
) -> None:
    other = PLAN.model_copy(
        update={"lens": PLAN.lens.model_copy(update={"focal_length_mm": 71.5})}
    )
    assert "71.5 mm f/2.8" in write_report(written(tmp_path, plan=other)).read_text()


def test_a_report_that_fails_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written(tmp_path)
    (folder / "report.html").write_text("old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match=r"cannot write .*No space"):
        write_report(folder)
    assert (folder / "report.html").read_text() == "old"
    assert not [p for p in folder.rglob("*") if p.name.startswith(".")]


def test_a_report_may_lie_under_a_name_of_any_bytes(
    tmp_path: Path, words_only: None
) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
    folder.mkdir()
    assert "Results folder" in write_report(written(folder)).read_text()
