"""The page of a photon transfer: numbers and figures in one HTML file."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from labkit.figure_style import svg
from labkit.noise.figures import CAPTIONS, drawn

if TYPE_CHECKING:
    from labkit.noise.measure import Noise

PAGE_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1c1e21; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { padding: .2rem .8rem .2rem 0; text-align: left; border-bottom: 1px solid #d5d8db; }
figure { display: inline-block; margin: 1rem .9rem 1rem 0; width: 29rem; max-width: 100%; vertical-align: top; }
figure svg { width: 100%; height: auto; }
figcaption, .soft { color: #55595e; font-size: 13px; }
pre { background: #f4f4f2; padding: .6rem; }
@media print { figure { width: 48%; break-inside: avoid; } }
"""


def page(noise: Noise, title: str) -> str:
    """Return the HTML page of a measured camera. title: the session's name"""
    heading, *rows = noise.rows()
    table = "".join(_row("td", row) for row in rows)
    notes = "".join(f"<p>{escape(note)}</p>" for note in noise.notes())
    figures = "".join(
        f'<figure role="img" aria-label="{escape(name)}">{_drawing(svg(figure))}'
        f"<figcaption>{escape(CAPTIONS[name][1])}</figcaption></figure>"
        for name, figure in drawn(noise.channels).items()
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>{escape(title)} · camera noise</title><style>{PAGE_STYLE}</style></head><body>"
        f"<h1>Camera noise: {escape(title)}</h1>"
        '<p class="soft">Photon transfer by EMVA 1288, Release 4.0 Linear; ± is one standard error.</p>'
        f"<table><thead>{_row('th', heading)}</thead><tbody>{table}</tbody></table>"
        f"{notes}{figures}<h2>For a plan</h2><pre>{escape(noise.to_toml())}</pre></body></html>\n"
    )


def _row(kind: str, cells: list[str]) -> str:
    return f"<tr>{''.join(f'<{kind}>{escape(cell)}</{kind}>' for cell in cells)}</tr>"


def _drawing(content: bytes) -> str:
    """Return an SVG file's drawing, without the file's heading."""
    text = content.decode()
    return text[text.index("<svg") :]
