"""A target: radiance as exact geometry in millimetres, sampled on demand.

Radiance is relative: 1 is white, 0 is black. The origin is the target's centre, y runs
down, x runs right. Kinds plug in by the entry point group ``labkit.targets``: name ->
factory(TargetSpec) -> Target.
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
        """Radiance of the plane around the target; None if unknown."""
        ...

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the band-limited radiance on a grid.

        Parameters
        ----------
        y_mm : (m,)
        x_mm : (n,)
        bandwidth_per_mm : end of the pass band, cycles/mm

        Returns
        -------
        (m, n)
        """
        ...

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return point values at broadcast (y_mm, x_mm), without any filter."""
        ...


def on_dots(target: Target, dots: tuple[int, int]) -> Floats:
    """Return the radiance of a target in the middle of each of (rows, cols) dots that cover it."""
    y_mm, x_mm = (
        ((np.arange(n) + 0.5) / n - 0.5) * side
        for n, side in zip(dots, target.size_mm, strict=True)
    )
    return target.radiance(y_mm[:, None], x_mm[None, :])


@dataclass(frozen=True, slots=True)
class CellTarget:
    """A target of equal rectangular cells, each of one radiance.

    Parameters
    ----------
    cells : (rows, cols) radiance, finite and not negative
    size_mm : (height, width) of all cells together
    surround : radiance of the plane around; None if unknown, then drawn as 0, to be masked
        by the caller

    Raises
    ------
    TargetError
        for any other value
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
        """Return the radiance on a grid after an ideal low-pass filter in y and in x.

        The result is exact: no raster lies between. The pass band is flat within 1e-4. The
        stop band begins at 1.3 times the bandwidth and is below 1e-4, so samples closer
        than 1 / (2.3 bandwidth) have no aliases. Each cell contributes the difference of
        the filter's step responses at its two edges: the whole is B_y @ cells @ B_x.T. The
        object of thesis §2.4.1 and (2.28).

        Parameters
        ----------
        y_mm : (m,)
        x_mm : (n,)
        bandwidth_per_mm : end of the pass band, cycles/mm

        Returns
        -------
        (m, n)

        Raises
        ------
        ValueError
            unless bandwidth_per_mm > 0
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y_mm = real_array("y_mm", y_mm, (None,), "mm")
        x_mm = real_array("x_mm", x_mm, (None,), "mm")
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
        """Return exact point values at broadcast (y_mm, x_mm); outside the surround, 0 if unknown."""
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
    """Return a table without repeated rows and columns, and the index of each original row and column.

    Computing with the distinct ones saves time: only 32 of a carpet's 243 rows differ.
    """
    rows, row_of = np.unique(cells, axis=0, return_inverse=True)
    core, col_of = np.unique(rows, axis=1, return_inverse=True)
    return core, row_of, col_of


def open_target(spec: TargetSpec | str) -> Target:
    """Open the target of a plan's [target] table, or of a text as `read_spec` reads it.

    Parameters
    ----------
    spec : table of a plan, or a text

    Raises
    ------
    PlanError
        for a bad plan
    TargetError
        for an unknown kind

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
    """Read a target from a plan's path, or from ``kind:name=value,...``.

    Parameters
    ----------
    text : such as ``sierpinski:order=5,size_mm=46.8``, or of a grid
        ``sierpinski:order=4,size_mm=27,grid=3x4,pitch_mm=42,marks=true``

    Raises
    ------
    PlanError
        for a bad plan
    TargetError
        for any other text that is not a target
    """
    if text.endswith(".toml"):
        return Plan.load(text).target
    kind, _, listed = text.partition(":")
    fields: dict[str, object] = {"kind": kind}
    for item in filter(None, listed.split(",")):
        name, equals, value = item.partition("=")
        if not equals:
            raise TargetError(f"target {text!r}: {item!r} is not name=value; {EXAMPLE}")
        fields[name.strip()] = _value(value.strip())
    try:
        return TargetSpec.from_tables(fields)
    except PlanError as error:
        raise TargetError(f"target {text!r}: {error}; {EXAMPLE}") from error


def _value(text: str) -> object:
    """Return the value of a key: true, false, a number, a pair such as 2x3, or text."""
    if text in ("true", "false"):
        return text == "true"
    rows, times, cols = text.partition("x")
    if times and rows.isdecimal() and cols.isdecimal():
        return [int(rows), int(cols)]
    return _number_or_text(text)


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
    """Return the contribution (m, groups) of each group of equal cells along an axis to each sample."""
    at = np.asarray(at_mm, dtype=np.float64)
    edges = (np.arange(group.size + 1) / group.size - 0.5) * side_mm
    reach, step = low_pass()
    # only edges between unlike cells matter: a run of equal cells is one wide cell
    kept = np.flatnonzero(np.concatenate(([True], group[1:] != group[:-1], [True])))
    # nor edges that no sample is near to, but for one on each side
    near_mm = at.min() - reach / bandwidth_per_mm, at.max() + reach / bandwidth_per_mm
    first = max(0, int(np.searchsorted(edges[kept], near_mm[0])) - 1)
    kept = kept[first : int(np.searchsorted(edges[kept], near_mm[1])) + 1]
    if kept.size < 2:
        return np.zeros((at.size, groups))
    passed = step(np.clip((at[:, None] - edges[kept]) * bandwidth_per_mm, -reach, reach))
    member = np.zeros((kept.size - 1, groups))
    member[np.arange(member.shape[0]), group[kept[:-1]]] = 1.0
    blurred: Floats = (passed[:, :-1] - passed[:, 1:]) @ member
    return blurred


@cache
def low_pass() -> tuple[float, CubicHermiteSpline]:
    """Return (reach, step): the integral of `Target.sample`'s kernel from -reach, for a bandwidth of 1.

    The kernel is a sinc cut off midway between pass band and stop band under a Kaiser
    window: Kaiser, *Nonrecursive digital filter design using the I0-sinh window function*,
    ISCAS 1974.
    """
    beta = 0.1102 * (RIPPLE_DB - 8.7)
    reach = (RIPPLE_DB - 7.95) / (2 * 2.285 * 2 * np.pi * (STOP_BAND - 1))
    u = np.linspace(-reach, reach, 8193)
    kernel = np.sinc((1 + STOP_BAND) * u) * np.i0(
        beta * np.sqrt(np.clip(1 - (u / reach) ** 2, 0, None))
    )
    area = cumulative_simpson(kernel, x=u, initial=0.0)
    return float(reach), CubicHermiteSpline(u, area / area[-1], kernel / area[-1])
