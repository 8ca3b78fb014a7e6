"""The documentation as a site: `make docs` builds it into build/docs."""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx

from docs.generators import filled
from labkit.version import __version__

project = "labkit"
author = "The labkit developers"
project_copyright = "the labkit developers, MIT license"
release = version = __version__

extensions = ["myst_parser", "docs.mathml"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["generators"]
highlight_language = "text"
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!labkit\.).*")
]  # types by their bare names; links in the text have whole ones

smartquotes = False

html_theme = "furo"
html_title = "labkit"
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "friendly"


def setup(app: Sphinx) -> dict[str, Any]:
    """Fill the places for what is generated before a page is parsed."""
    app.connect(
        "source-read", lambda app, name, source: source.__setitem__(0, filled(source[0]))
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
