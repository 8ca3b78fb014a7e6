"""The report: one HTML file that needs nothing else, and its figures as files beside it."""

from base64 import b64encode
from collections.abc import Callable
from hashlib import sha256
from itertools import count
from pathlib import Path
from re import sub
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from labkit.errors import DataError, InputError
from labkit.files import refuse_links, write_atomically, writing
from labkit.report.best_focus import at_best_focus
from labkit.report.contents import contents
from labkit.report.curves import curves_of
from labkit.report.downloads import Download, downloads_of
from labkit.report.figures import DRAWINGS, draw_figures
from labkit.report.photographs import photographs_of
from labkit.report.plates import Panel, Plate
from labkit.report.quantities import PLUS_MINUS
from labkit.results import Results, Wavefront
from labkit.types import Progress, no_progress

TEMPLATES = Path(__file__).parent / "templates"


def write_report(
    results: Results | Path | str, *, pdf: bool = False, progress: Progress = no_progress
) -> Path:
    """Write report.html and figures/ beside results, and report.pdf where it is asked for.

    Parameters
    ----------
    results : of a fit or loaded, or the folder of a session or of results
    pdf : whether to print the page as report.pdf too; one of an earlier report is removed in any case
    progress : called as the work goes on

    Returns
    -------
    path of report.html

    Raises
    ------
    DataError : there are no results
    InputError : their folder cannot be written to
    SessionError : their folder is a link
    LabkitError : no browser is there to print the PDF, or it failed; report.html is written

    >>> labkit.write_report("night-3", pdf=True)
    """
    total, steps = DRAWINGS + 2 + pdf, count()

    def begin(words: str) -> None:
        progress(next(steps), total, words)

    begin("computing curves")
    if not isinstance(results, Results):
        results = Results.load(results)
    if results.folder is None:
        raise ValueError(
            "these results lie in no folder: Results.write them first, and load them from there"
        )
    try:
        drawn, html = _made(results, begin)
    except (ArithmeticError, LookupError, MemoryError, ValueError) as error:
        raise DataError(
            f"no report can be made of {results.folder}, numbers of no lens stand there ({error}): fit the session again"
        ) from error
    _write_figures(results.folder, drawn)
    path = results.folder / "report.html"
    write_atomically(
        path, html.encode(errors="replace")
    )  # the folder may have a name of any bytes
    with writing(path.with_suffix(".pdf")):
        path.with_suffix(".pdf").unlink(missing_ok=True)
    if pdf:
        from labkit.report.pdf import write_pdf

        begin("printing the PDF")
        write_pdf(path)
    progress(total, total, "")
    return path


def _made(
    results: Results, begin: Callable[[str], None]
) -> tuple[dict[str, list[Plate]], str]:
    """Make figures and page. begin: called with each step."""
    curves = curves_of(results, at_best_focus(results))
    photographs = photographs_of(
        results, min((c.focus.photographed for c in curves), key=_defocus)
    )
    drawn = draw_figures(results, curves, photographs, begin)
    begin("writing the page")
    words = contents(results, curves, photographs, set(drawn))
    return drawn, _render(words, drawn, downloads_of(results, curves))


def _defocus(wavefront: Wavefront) -> float:
    return abs(wavefront.defocus.value) if wavefront.defocus else 0.0


def _write_figures(folder: Path, drawn: dict[str, list[Plate]]) -> None:
    figures = folder / "figures"
    refuse_links(folder, figures)  # what is no figure of ours would be removed
    try:
        figures.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {figures}: {error.strerror}") from error
    files = {
        panel.file: panel.content
        for plates in drawn.values()
        for plate in plates
        for panel in plate.panels
    }
    for name, content in files.items():
        write_atomically(figures / name, content)
    for old in figures.glob("*.[ps][nv]g"):
        if old.name not in files:  # of an earlier fit, with other ranges or channels
            old.unlink()


def _render(
    words: dict[str, Any], drawn: dict[str, list[Plate]], downloads: list[Download]
) -> str:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["uri"] = _data_uri
    environment.filters["css"] = _css_string
    script = (TEMPLATES / "report.js").read_text(encoding="utf-8")
    # the one script that the page may run: nothing that a file's name smuggles in
    allowed = b64encode(sha256(script.encode()).digest()).decode()
    html = environment.get_template("report.html.j2").render(
        drawn=drawn, downloads=downloads, script=script, script_sha256=allowed, **words
    )
    # warnings come with plain spaces: a number is never parted from its error
    return sub(r"(?<=[\d)]) ± (?=\d)", PLUS_MINUS, html)


def _css_string(text: str) -> str:
    """Return a text as a string of CSS, in which no character can end it or the style sheet."""
    letters = (c if c.isascii() and c.isalnum() else f"\\{ord(c):06x}" for c in text)
    return f'"{"".join(letters)}"'


def _data_uri(panel: Panel) -> str:
    return f"data:{panel.media_type};base64,{b64encode(panel.content).decode()}"
