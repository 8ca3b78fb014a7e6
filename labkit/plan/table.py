"""The base of all tables of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from labkit.errors import PlanError
from labkit.plan.messages import message
from labkit.plan.text import plain


class Table(BaseModel):
    """A table of the plan: frozen, and unknown keys are errors. The text below a field is its entry in the reference."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[str, Any],
        folder: Path | str = ".",
        *,
        files_needed: bool = True,
    ) -> Self:
        """Return the plan in dicts and lists such as TOML gives; a target's file is relative to `folder`.

        files_needed: whether a target's file must exist.

        Raises PlanError, one line that names every wrong field.
        """
        tables = plain(tables)
        try:
            return cls.model_validate(
                tables, context={"folder": Path(folder), "files_needed": files_needed}
            )
        except ValidationError as error:
            raise PlanError(message(error, cls, tables)) from None
