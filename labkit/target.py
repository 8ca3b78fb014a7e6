"""What a target is: radiance as exact geometry in millimetres, sampled on demand.

Radiance is relative: 1 is white, 0 is black. The origin is the target's centre, y runs down, x runs right.
Kinds plug in by the entry point group ``labkit.targets``: name -> factory(TargetSpec) -> Target.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicHermiteSpline

from labkit.arrays import real_array
from labkit.errors import PlanError, TargetError
from labkit.plan import Plan, TargetSpec
from labkit.types import Floats

STOP_BAND = 1.3
"""The low-pass filter of `Target.sample` blocks everything from this many times its bandwidth."""

RIPPLE_DB = 86.0
"""Its pass band is flat, and its stop band dark, within this (5e-5)."""

EXAMPLE = "an example: sierpinski:order=5,size_mm=46.8"

SURROUNDS: dict[str, float | None] = {"black": 0.0, "white": 1.0, "unknown": None}
"""Radiance around the target for each word a plan may use."""


class Target(Protocol):
    """A plane figure of known radiance."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of the figure."""
        ...

    @property
    def surround(self) -> float | None:
        """Radiance of the plane around it; None where it is not known."""
        ...

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Band-limited radiance on the grid y_mm (m,) × x_mm (n,) -> (m, n)."""
        ...

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Point values at broadcast (y_mm, x_mm), without any filter."""
        ...


@dataclass(frozen=True, slots=True)
class CellTarget:
    """A target of equal rectangular cells, each of one radiance.

    cells: (rows, cols) radiance, finite and not negative; size_mm: (height, width) of all of them;
    surround: radiance of the plane around, None = unknown (it is then taken as 0 and must be masked by whoever cares).
    Raises TargetError for anything else.
    """

    cells: Floats
    size_mm: tuple[float, float]
    surround: float | None = 0.0
    _core: Floats = field(init=False, repr=False, compare=False)
    _row_of: NDArray[np.intp] = field(init=False, repr=False, compare=False)
    _col_of: NDArray[np.intp] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        cells = np.array(self.cells, dtype=np.float64)
        if cells.ndim != 2 or not cells.size:
            raise TargetError(
                f"a target's cells are a table of rows and columns, not of shape {cells.shape}"
            )
        if not np.all(np.isfinite(cells)) or cells.min() < 0:
            raise TargetError("a target's radiances are finite and not negative")
        if not all(np.isfinite(side) and side > 0 for side in self.size_mm):
            raise TargetError(
                f"a target's sides are longer than 0 mm, not {self.size_mm[0]:g} × {self.size_mm[1]:g} mm"
            )
        cells.flags.writeable = False
        core, row_of, col_of = distinct(cells)
        for name, value in (
            ("cells", cells),
            ("_core", core),
            ("_row_of", row_of),
            ("_col_of", col_of),
        ):
            object.__setattr__(self, name, value)

    @property
    def cell_mm(self) -> tuple[float, float]:
        """(height, width) of one cell."""
        rows, cols = self.cells.shape
        return self.size_mm[0] / rows, self.size_mm[1] / cols

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Radiance on a grid after an ideal low-pass filter in y and in x: exact, without an intermediate raster.

        y_mm: (m,), x_mm: (n,) in mm; bandwidth_per_mm: the pass band's end in cycles/mm. Returns (m, n).
        The pass band is flat within 1e-4, the stop band begins at 1.3 times the bandwidth and is below 1e-4:
        the samples alias nothing if they are closer than 1 / (2.3 bandwidth). Each cell contributes the difference
        of the filter's step response at its two edges, so the whole is B_y @ cells @ B_x.T.
        Raises ValueError unless bandwidth_per_mm > 0. The object of thesis §2.4.1 and (2.28).
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y_mm, x_mm = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        around = self.surround or 0.0
        by = _blurred_cells(
            y_mm, self.size_mm[0], self._row_of, self._core.shape[0], bandwidth_per_mm
        )
        bx = _blurred_cells(
            x_mm, self.size_mm[1], self._col_of, self._core.shape[1], bandwidth_per_mm
        )
        blurred: Floats = by @ ((self._core - around) @ bx.T)
        if around:
            blurred += around
        return blurred

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Exact point values at broadcast (y_mm, x_mm); the surround (0 if unknown) outside."""
        y, x = np.broadcast_arrays(
            real_array("y_mm", y_mm, None, "mm"), real_array("x_mm", x_mm, None, "mm")
        )
        row = np.floor(y / self.cell_mm[0] + self.cells.shape[0] / 2)
        col = np.floor(x / self.cell_mm[1] + self.cells.shape[1] / 2)
        inside = (
            (row >= 0)
            & (row < self.cells.shape[0])
            & (col >= 0)
            & (col < self.cells.shape[1])
        )
        values = self.cells[
            np.where(inside, row, 0).astype(np.intp),
            np.where(inside, col, 0).astype(np.intp),
        ]
        return np.where(inside, values, self.surround or 0.0)


def distinct(cells: Floats) -> tuple[Floats, NDArray[np.intp], NDArray[np.intp]]:
    """A table's rows and columns that differ, and which of them each row and each column is: computed with once.

    Of the 243 rows of a carpet only 32 differ.
    """
    rows, row_of = np.unique(cells, axis=0, return_inverse=True)
    core, col_of = np.unique(rows, axis=1, return_inverse=True)
    return core, row_of, col_of


def open_target(spec: TargetSpec | str) -> Target:
    """The target that a plan's [target] table describes, or a text as `read_spec` takes it.

    Raises PlanError, and TargetError for an unknown kind.

    >>> target = labkit.open_target("sierpinski:order=5,size_mm=46.8")
    """
    spec = read_spec(spec) if isinstance(spec, str) else spec
    kinds = {entry.name: entry for entry in entry_points(group="labkit.targets")}
    if spec.kind not in kinds:
        known = ", ".join(sorted(kinds)) or "none (is labkit installed?)"
        raise TargetError(f"no target of kind {spec.kind!r}; installed kinds: {known}")
    target: Target = kinds[spec.kind].load()(spec)
    return target


def read_spec(text: str) -> TargetSpec:
    """A target from a plan's path, or from ``kind:name=value,...`` such as ``sierpinski:order=5,size_mm=46.8``.

    Raises PlanError for a bad plan, TargetError for anything else that is not understood.
    """
    if text.endswith(".toml"):
        return Plan.load(text).target
    kind, _, listed = text.partition(":")
    fields: dict[str, object] = {"kind": kind}
    for item in filter(None, listed.split(",")):
        name, equals, value = item.partition("=")
        if not equals:
            raise TargetError(f"target {text!r}: {item!r} is not name=value; {EXAMPLE}")
        fields[name.strip()] = _number_or_text(value.strip())
    try:
        return TargetSpec.from_tables(fields)
    except PlanError as error:
        raise TargetError(f"target {text!r}: {error}; {EXAMPLE}") from error


def _number_or_text(value: str) -> int | float | str:
    for number in (int, float):
        try:
            return number(value)
        except ValueError:
            continue
    return value


def _blurred_cells(
    at_mm: ArrayLike,
    side_mm: float,
    group: NDArray[np.intp],
    groups: int,
    bandwidth_per_mm: float,
) -> Floats:
    """What each group of equal cells of one axis adds to each sample: (m, groups)."""
    at = np.asarray(at_mm, dtype=np.float64)
    edges = (np.arange(group.size + 1) / group.size - 0.5) * side_mm
    reach, step = low_pass()
    # only edges between unlike cells matter: a run of equal cells is one wide cell
    keep = np.concatenate(([True], group[1:] != group[:-1], [True]))
    passed = step(np.clip((at[:, None] - edges[keep]) * bandwidth_per_mm, -reach, reach))
    member = np.zeros((int(keep.sum()) - 1, groups))
    member[np.arange(member.shape[0]), group[keep[:-1]]] = 1.0
    blurred: Floats = (passed[:, :-1] - passed[:, 1:]) @ member
    return blurred


@cache
def low_pass() -> tuple[float, CubicHermiteSpline]:
    """(reach, step): integral of `Target.sample`'s kernel, for a bandwidth of 1, from -reach up to the argument.

    A sinc cut off midway between pass band and stop band under a Kaiser window: Kaiser, *Nonrecursive digital
    filter design using the I0-sinh window function*, ISCAS 1974.
    """
    beta = 0.1102 * (RIPPLE_DB - 8.7)
    reach = (RIPPLE_DB - 7.95) / (2 * 2.285 * 2 * np.pi * (STOP_BAND - 1))
    u = np.linspace(-reach, reach, 8193)
    kernel = np.sinc((1 + STOP_BAND) * u) * np.i0(
        beta * np.sqrt(np.clip(1 - (u / reach) ** 2, 0, None))
    )
    area = cumulative_simpson(kernel, x=u, initial=0.0)
    return float(reach), CubicHermiteSpline(u, area / area[-1], kernel / area[-1])
