"""The columns and rows that `labkit advise` prints."""

from __future__ import annotations

from docs.generators.markdown import code, table
from labkit.analysis.advice_tables import COLUMNS, SESSION_ROWS


def advise_columns() -> str:
    """Columns of the table of ranges, then rows of the table of the whole session."""
    columns = table([["column", "meaning"], *([code(name), meaning] for name, meaning in COLUMNS.items())])
    rows = table([["row", "meaning"], *([code(name), meaning] for name, meaning in SESSION_ROWS.items())])
    return f"## For each range\n\n{columns}\n## For the whole session\n\n{rows}"
