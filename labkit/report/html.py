"""The report: one HTML file that needs nothing else, and its figures as files beside it."""

from base64 import b64encode
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from labkit.errors import InputError
from labkit.files import write_atomically
from labkit.report.best_focus import at_best_focus
from labkit.report.contents import contents
from labkit.report.figures import Drawn, draw_figures
from labkit.report.style import WIDTH_IN
from labkit.results import Results


def write_report(results: Results | Path | str) -> Path:
    """Write report.html and figures/ beside results; returns the report's path.

    results: of a fit or loaded, or the folder of a session or of results. Raises DataError where there are none, and
    InputError where their folder cannot be written to.

    >>> labkit.write_report("night-3")
    """
    if not isinstance(results, Results):
        results = Results.load(results)
    if results.folder is None:
        raise ValueError("these results lie in no folder: Results.write them first, and load them from there")
    focused = at_best_focus(results)
    drawn = draw_figures(results, focused)
    figures = results.folder / "figures"
    try:
        figures.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {figures}: {error.strerror}") from error
    files = {f"{f.name}.png": f.png for section in drawn.values() for f in section}
    files |= {f"{f.name}.svg": f.svg for section in drawn.values() for f in section if f.svg is not None}
    for name, content in files.items():
        write_atomically(figures / name, content)
    for old in figures.glob("*.[ps][nv]g"):
        if old.name not in files:  # of an earlier fit, with other ranges or channels
            old.unlink()
    html = _render(contents(results, focused, set(drawn)), drawn)
    path = results.folder / "report.html"
    write_atomically(path, html.encode(errors="replace"))  # the folder may have a name of any bytes
    return path


def _render(words: dict[str, Any], drawn: dict[str, list[Drawn]]) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    embedded = {
        section: [
            {"uri": _data_uri(f), "alt": f.alt, "caption": f.caption, "share": round(100 * f.width_in / WIDTH_IN)}
            for f in figures
        ]
        for section, figures in drawn.items()
    }
    return environment.get_template("report.html.j2").render(drawn=embedded, **words)


def _data_uri(figure: Drawn) -> str:
    kind, content = ("png", figure.png) if figure.svg is None else ("svg+xml", figure.svg)
    return f"data:image/{kind};base64,{b64encode(content).decode()}"
