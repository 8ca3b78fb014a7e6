"""The report as a PDF: its pages, what stands on each, and what happens where no browser prints it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pypdfium2 as pdfium
import pytest

from labkit.cli import run
from labkit.errors import LabkitError
from labkit.plan import About, Plan
from labkit.report import pdf
from labkit.report.html import write_report
from labkit.report.pdf import find_browser, write_pdf
from labkit.session.session import Session
from tests.plans import PORTRAIT, plan_text
from tests.results_samples import PLAN, a_wavefront, some_results, written

HOSTILE = '</style><b>"\\22 } * { display: none'
ABOUT = About(
    title=f"Repair 17 {HOSTILE}",
    operator="A. Tester",
    note="Mount replaced",
)
try:
    find_browser()
    BROWSER = True
except LabkitError:
    BROWSER = False

prints = pytest.mark.skipif(not BROWSER, reason="no Chromium to print with")


def plan_about(about: About) -> Plan:
    lens = {"name": "Apo 70", "serial": "0042"}
    return PLAN.replace(lens=lens).model_copy(update={"about": about})


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pdfium.PdfDocument]:
    """Of a session of four ranges and two colours."""
    wavefronts = tuple(
        a_wavefront(r, c, (r - 2987) / 190)
        for r in (2900.0, 3000.0, 3100.0, 3200.0)
        for c in ("R", "B")
    )
    folder = written(
        tmp_path_factory.mktemp("pdf"), plan=plan_about(ABOUT), wavefronts=wavefronts
    )
    document = pdfium.PdfDocument(write_report(folder, pdf=True).with_suffix(".pdf"))
    yield document
    document.close()


def text_of(page: pdfium.PdfPage) -> str:
    return " ".join(page.get_textpage().get_text_range().split())


def first_words(page: pdfium.PdfPage) -> str:
    """What stands at a page's top, below its running head and a table's heading."""
    words = re.split(r"Mount replaced \d+ / \d+ ", text_of(page), maxsplit=1)[1]
    return re.sub(r"^(at best focus R B|quantity measured stated) ", "", words)[:60]


def filled(page: pdfium.PdfPage) -> float:
    """How far down a page's text and figures reach, as a share of the room between its margins."""
    grey = np.asarray(page.render(scale=0.5).to_pil().convert("L"))
    inner = grey[24 : len(grey) - 26]  # 17 mm and 18 mm of 297
    return float((np.flatnonzero((inner < 245).any(axis=1)).max() + 1) / len(inner))


@pytest.mark.slow
@prints
def test_every_page_is_a4_with_its_number_and_what_the_plan_says_of_the_lens(
    pages: pdfium.PdfDocument,
) -> None:
    assert len(pages) > 5
    for number, page in enumerate(pages, 1):
        words = text_of(page)
        assert page.get_size() == pytest.approx((595.3, 841.9), abs=0.7)  # 1/72 inch
        assert f"{number} / {len(pages)}" in words
        assert f"{ABOUT.title} · Apo 70, serial number 0042" in words
        assert "measured by A. Tester" in words
        assert "Mount replaced" in words


@pytest.mark.slow
@prints
def test_no_page_but_the_last_is_half_empty(pages: pdfium.PdfDocument) -> None:
    assert min(filled(page) for page in list(pages)[:-1]) > 0.6


@pytest.mark.slow
@prints
def test_no_row_on_a_new_page_has_lost_its_parent(pages: pdfium.PdfDocument) -> None:
    children = ("along y", "diffraction limit of this pupil", "nm", "at degrees", "G", "B")
    firsts = [first_words(page) for page in pages]
    assert len(set(firsts)) == len(firsts)
    assert not [words for words in firsts if words.startswith(children)]


@pytest.mark.slow
def test_the_report_opens_with_what_the_plan_says(tmp_path: Path) -> None:
    html = write_report(written(tmp_path, plan=plan_about(ABOUT))).read_text()
    assert "<h1>Repair 17 &lt;/style&gt;&lt;b&gt;" in html
    assert "Lens measurement · session<" in html
    assert "Apo 70, serial number 0042 · measured by A. Tester" in html
    assert html.count("Mount replaced") == 1  # the other is a style sheet's string
    assert html.count("</style>") == 1


@pytest.fixture
def report(tmp_path: Path) -> Path:
    page = tmp_path / "report.html"
    page.write_text("<p>a page</p>")
    return page


def browser(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> Path:
    """A browser that does what a shell script says; $printed is the file that it is to print to."""
    path = folder / "chromium"
    path.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && { echo Chromium 140.0.7339.16; exit; }\n'
        "for each; do case $each in --print-to-pdf=*) printed=${each#*=};; esac; done\n"
        f"{script}\n"
    )
    path.chmod(0o755)
    monkeypatch.setattr(pdf, "BROWSERS", (str(path),))
    return path


@pytest.mark.parametrize(
    ("script", "words"),
    [
        (
            "echo no display >&2; exit 1",
            "printed no whole PDF of .*: 'no display'; print the page",
        ),
        ('printf "%%PDF-1.4 half" > "$printed"', "printed no whole PDF"),
        ("sleep 60", "did not end within 0.3 s; print the page"),
    ],
)
def test_a_pdf_is_whole_or_not_there(
    report: Path, monkeypatch: pytest.MonkeyPatch, script: str, words: str
) -> None:
    browser(report.parent, monkeypatch, script)
    with pytest.raises(LabkitError, match=words):
        write_pdf(report, timeout_s=0.3 if "sleep" in script else 20.0)
    assert {path.name for path in report.parent.iterdir()} == {"report.html", "chromium"}


def test_without_a_browser_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pdf, "BROWSERS", ("/nowhere/chromium",))
    with pytest.raises(
        LabkitError, match=r"install one \(Debian, Ubuntu: apt install chromium;"
    ):
        find_browser()


def test_an_old_browser_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = tmp_path / "old"
    old.write_text("#!/bin/sh\necho Chromium 120.0.6099.224\n")
    old.chmod(0o755)
    monkeypatch.setattr(pdf, "BROWSERS", (str(old),))
    with pytest.raises(LabkitError, match="is version 120: page numbers need 131 or newer"):
        find_browser()
    new = browser(tmp_path, monkeypatch, "true")
    monkeypatch.setattr(pdf, "BROWSERS", (str(old), str(new)))
    assert find_browser() == str(new)


@pytest.mark.slow
def test_a_pdf_of_an_earlier_report_does_not_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})
    monkeypatch.setattr(pdf, "BROWSERS", ())
    folder = written(tmp_path)
    (folder / "report.pdf").write_bytes(b"%PDF of another fit")
    with pytest.raises(LabkitError, match="install one"):
        write_report(folder, pdf=True)
    assert (folder / "report.html").exists()
    assert not (folder / "report.pdf").exists()


@pytest.mark.slow
def test_progress_counts_to_its_end(tmp_path: Path) -> None:
    steps: list[tuple[int, int, str]] = []
    write_report(written(tmp_path), progress=lambda *step: steps.append(step))
    total = steps[0][1]
    assert [(done, of) for done, of, _ in steps] == [(k, total) for k in range(total + 1)]
    assert "drawing through focus" in [words for *_, words in steps]


@pytest.mark.slow
def test_the_command_line_prints_a_pdf_where_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("labkit.report.html.draw_figures", lambda *_: {})
    browser(tmp_path, monkeypatch, r'printf "%%PDF-1.4\n%%%%EOF\n" > "$printed"')
    with Session.create(tmp_path / "night", plan_text(PORTRAIT), tmp_path):
        folder = some_results().write(tmp_path / "night" / "results" / "latest").parent
    assert run(["report", str(tmp_path / "night"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pdf"] is None
    assert run(["report", str(tmp_path / "night"), "--pdf", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pdf"] == f"{folder}/report.pdf"
    assert (folder / "report.pdf").read_bytes() == b"%PDF-1.4\n%%EOF\n"
