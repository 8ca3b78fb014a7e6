"""Standard errors of the numbers that a plan states."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from labkit.plan.fields import Allowed, Number, problem
from labkit.plan.table import Table
from labkit.uncertain import Uncertain

Error = Annotated[Number, AfterValidator(Allowed(0, 1e6))]


def stated(value: float, std: float | None, relative: float, unit: str = "") -> Uncertain:
    """Return a number with its standard error; a relative one where the plan states none."""
    return Uncertain(value, relative * value if std is None else std, unit)


def refuse_larger(table: Table, name: str, error: str) -> None:
    """Raise an error for a standard error larger than its value."""
    value, std = getattr(table, name), getattr(table, error)
    if std is not None and std > value:
        raise problem(f"{error} = {std:g}: allowed is 0 to {name} = {value:g}")
