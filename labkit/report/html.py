"""The report: one HTML file that needs nothing else, and its figures as files beside it."""

from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from re import sub
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from labkit.errors import InputError
from labkit.files import refuse_links, write_atomically
from labkit.report.best_focus import at_best_focus
from labkit.report.contents import contents
from labkit.report.curves import curves_of
from labkit.report.downloads import Download, downloads_of
from labkit.report.figures import draw_figures
from labkit.report.photographs import photographs_of
from labkit.report.plates import Panel, Plate
from labkit.report.quantities import PLUS_MINUS
from labkit.results import Results, Wavefront

TEMPLATES = Path(__file__).parent / "templates"


def write_report(results: Results | Path | str) -> Path:
    """Write report.html and figures/ beside results; returns the report's path.

    results: of a fit or loaded, or the folder of a session or of results. Raises DataError where there are none,
    InputError where their folder cannot be written to, and SessionError where it is a link.

    >>> labkit.write_report("night-3")
    """
    if not isinstance(results, Results):
        results = Results.load(results)
    if results.folder is None:
        raise ValueError(
            "these results lie in no folder: Results.write them first, and load them from there"
        )
    curves = curves_of(results, at_best_focus(results))
    photographs = photographs_of(
        results, min((c.focus.photographed for c in curves), key=_defocus)
    )
    drawn = draw_figures(results, curves, photographs)
    _write_figures(results.folder, drawn)
    words = contents(results, curves, photographs, set(drawn))
    html = _render(words, drawn, downloads_of(results, curves))
    path = results.folder / "report.html"
    write_atomically(
        path, html.encode(errors="replace")
    )  # the folder may have a name of any bytes
    return path


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
    script = (TEMPLATES / "report.js").read_text(encoding="utf-8")
    # the one script that the page may run: nothing that a file's name smuggles in
    allowed = b64encode(sha256(script.encode()).digest()).decode()
    html = environment.get_template("report.html.j2").render(
        drawn=drawn, downloads=downloads, script=script, script_sha256=allowed, **words
    )
    # warnings come with plain spaces: a number is never parted from its error
    return sub(r"(?<=[\d)]) ± (?=\d)", PLUS_MINUS, html)


def _data_uri(panel: Panel) -> str:
    return f"data:{panel.media_type};base64,{b64encode(panel.content).decode()}"
