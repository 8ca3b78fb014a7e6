"""The report: a self-contained HTML file with its numbers to download, and its figures as files in a folder."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import count
from pathlib import Path
from re import sub
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from labkit.errors import DataError, InputError
from labkit.figure_style import channel_inks
from labkit.jobs.threads import one_thread
from labkit.key import Tile
from labkit.optics.through_focus import ThroughFocus
from labkit.optics.zernike import mode_name
from labkit.report.contents import contents
from labkit.report.curves import Curves, at_best_focus, curves_of
from labkit.report.figures import DRAWN_SECTIONS, Artist, draw_figures
from labkit.report.photographs import photographs_of
from labkit.report.pictures import Plate
from labkit.report.table import (
    PLUS_MINUS,
    bare,
    estimated,
    fixed,
    millimetres,
    plus_minus,
    when,
)
from labkit.report.tiles import central_tile, of_tile
from labkit.results import Results, Wavefront
from labkit.storage.files import refuse_links, write_atomically, writing
from labkit.storage.spreadsheet import Cell, csv_text
from labkit.types import Floats, Progress, no_progress

if TYPE_CHECKING:
    from labkit.report.field.plates import FieldArtist

TEMPLATES = Path(__file__).parent / "templates"


@one_thread
def write_report(
    results: Results | Path | str,
    *,
    pdf: bool = False,
    tile: Tile | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write report.html and figures/ into the folder of the results, and report.pdf if requested.

    Parameters
    ----------
    results : of a fit or loaded, or the folder of a session or of results
    pdf : whether to print the page as report.pdf too; one of an earlier report is removed in any case
    tile : (row, column) of the tile whose wavefronts are shown one by one; by default the
        tile nearest to the frame's centre. Results of whole frames have none
    progress : called as the work goes on

    Returns
    -------
    path of report.html

    Raises
    ------
    DataError : there are no results
    InputError : their folder cannot be written to, or the tile was not fitted
    SessionError : their folder is a link
    LabkitError : no browser is there to print the PDF, or it failed; report.html is written

    >>> labkit.write_report("night-3", pdf=True)
    """
    total = len(DRAWN_SECTIONS) + 2 + pdf
    steps = count()

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
        drawn, html = _made(results, tile or central_tile(results), begin)
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
    whole: Results, tile: Tile | None, begin: Callable[[str], None]
) -> tuple[dict[str, list[Plate]], str]:
    """Make figures and page. begin: called with each step."""
    results = of_tile(whole, tile)
    curves = curves_of(results, at_best_focus(results))
    nearest = min((c.focus.photographed for c in curves), key=_defocus)
    photographs = photographs_of(results, nearest)
    field = field_artist(whole, nearest)
    drawn = draw_figures(Artist(results, curves, photographs, field), begin)
    begin("writing the page")
    words = contents(whole, results, curves, photographs, set(drawn), field)
    return drawn, _render(words, drawn, downloads_of(whole, results, curves, field))


def field_artist(whole: Results, nearest: Wavefront) -> FieldArtist | None:
    """Return who draws the field; None for results without its model, whose report needs none of its modules."""
    if whole.field is None:
        return None
    from labkit.report.field.plates import FieldArtist

    return FieldArtist(whole.field, channel_inks(whole.channels), whole, nearest)


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
    environment.filters |= TEMPLATE_FILTERS
    script = (TEMPLATES / "report.js").read_text(encoding="utf-8")
    # the one script that the page may run: nothing that a file's name smuggles in
    allowed = b64encode(sha256(script.encode()).digest()).decode()
    html = environment.get_template("report.html.j2").render(
        drawn=drawn, downloads=downloads, script=script, script_sha256=allowed, **words
    )
    # warnings come with plain spaces: a number is never parted from its error
    return sub(r"(?<=[\d)]) ± (?=\d)", PLUS_MINUS, html)


def _css_string(text: str) -> str:
    """Return a text as a string of CSS, with escapes for all special characters."""
    letters = (c if c.isascii() and c.isalnum() else f"\\{ord(c):06x}" for c in text)
    return f'"{"".join(letters)}"'


def _data_uri(content: bytes, media_type: str) -> str:
    """Return bytes as a link."""
    return f"data:{media_type};base64,{b64encode(content).decode()}"


TEMPLATE_FILTERS: dict[str, Callable[..., str]] = {
    "uri": _data_uri,
    "css": _css_string,
    "estimated": estimated,
    "fixed": fixed,
    "millimetres": millimetres,
    "range": bare,
    "plus_minus": lambda number: plus_minus(number.value, number.std),
    "when": when,
}
"""Filters of the templates."""


@dataclass(frozen=True, slots=True)
class Download:
    """A file in the page: its name, bytes and description."""

    name: str
    media_type: str
    content: bytes
    what: str


def downloads_of(
    whole: Results,
    results: Results,
    curves: Sequence[Curves],
    field: FieldArtist | None = None,
) -> list[Download]:
    """Return the data of all charts at full precision, with standard errors.

    whole: the session, whose results.json would be most of a page of many tiles; results: the part that the page shows
    wavefront by wavefront
    """
    of_field = () if field is None else field.files()
    return [
        *([_raw(results)] if results is whole else []),
        *(_table(*file) for file in of_field),
        _table("zernike.csv", _zernike(results), "coefficients of all ranges and channels"),
        _table("mtf.csv", _mtf(curves), "MTF at best focus"),
        _table("through_focus.csv", _through(curves), "Strehl ratio and MTF through focus"),
        _table("encircled_energy.csv", _energy(curves), "encircled energy at best focus"),
    ]


def _raw(results: Results) -> Download:
    raw = json.dumps(results.as_json(), indent=1, allow_nan=False).encode()
    what = "everything, as labkit keeps it, with covariances"
    return Download("results.json", "application/json", raw, what)


def _table(name: str, rows: Iterable[Sequence[Cell]], what: str) -> Download:
    return Download(name, "text/csv", csv_text(rows).encode(), what)


def _zernike(results: Results) -> Iterable[Sequence[Cell]]:
    yield [
        "range_mm",
        "channel",
        "wavelength_nm",
        "noll",
        "mode",
        "waves_rms",
        "std_waves_rms",
        "nm_rms",
        "std_nm_rms",
        "sign_open",
        "twin_waves_rms",
    ]
    nm = results.reference_wavelength_nm
    for w in results:
        columns = (w.waves, w.std, w.waves * nm, w.std * nm)
        for j, twin, *numbers in _rows([w.twin.waves, *columns], w.noll):
            sign_open = str(w[j].sign_open).lower()
            where = (w.range_mm, w.channel, w.wavelength_nm, j, mode_name(j))
            yield *where, *numbers, sign_open, twin if w.sign_open else None


def _rows(columns: Sequence[Floats], *before: Iterable[Any]) -> Iterable[Sequence[Any]]:
    """Return the rows of columns of one length."""
    return zip(*before, *(column.tolist() for column in columns), strict=True)


def _mtf(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    yield [
        "channel",
        "direction",
        "cycles_per_mm",
        "mtf",
        "std",
        "diffraction_limit",
        "pixel",
        "mtf_with_pixel",
    ]
    for c in curves:
        for direction, curve in c.mtf.items():
            optics = [curve.frequency_per_mm, curve.value, curve.std]
            for row in _rows([*optics, c.perfect, c.pixel, curve.value * c.pixel]):
                yield c.channel, direction, *row


def _through(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    where = "range_mm" if curves and curves[0].in_ranges else "sensor_shift_um"
    yield "channel", "defocus_waves_rms", where, "quantity", "cycles_per_mm", "value", "std"
    for c in curves:
        each: list[tuple[str, float | None, ThroughFocus]] = [("strehl", None, c.strehl)]
        each += [(f"mtf_{d}", c.through_per_mm, curve) for d, curve in c.modulation.items()]
        for name, per_mm, curve in each:
            columns = [curve.defocus_waves, c.places, curve.value, curve.std]
            for defocus, place, *number in _rows(columns):
                yield c.channel, defocus, place, name, per_mm, *number


def _energy(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    yield "channel", "radius_um", "share", "std", "diffraction_limit"
    for c in curves:
        energy = c.energy
        columns = [energy.radius_um, energy.value, energy.std, c.perfect_energy]
        yield from ((c.channel, *row) for row in _rows(columns))
