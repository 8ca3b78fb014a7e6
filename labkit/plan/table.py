"""The base of all tables of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from labkit.errors import PlanError
from labkit.plan.fields import Allowed, Number, problem
from labkit.plan.text import message, plain
from labkit.uncertain import Uncertain


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

        Raises PlanError, one line naming every wrong field.
        """
        tables = plain(tables)
        try:
            return cls.model_validate(
                tables, context={"folder": Path(folder), "files_needed": files_needed}
            )
        except ValidationError as error:
            raise PlanError(message(error, cls, tables)) from None


Error = Annotated[Number, AfterValidator(Allowed(0, 1e6))]


def stated(value: float, std: float | None, relative: float, unit: str = "") -> Uncertain:
    """Return a number with its standard error; a relative one where the plan states none."""
    return Uncertain(value, relative * value if std is None else std, unit)


def refuse_larger(table: Table, name: str, error: str) -> None:
    """Raise an error for a standard error larger than its value."""
    value, std = getattr(table, name), getattr(table, error)
    if std is not None and std > value:
        raise problem(f"{error} = {std:g}: allowed is 0 to {name} = {value:g}")
