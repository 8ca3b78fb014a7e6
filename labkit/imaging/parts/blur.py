"""Parts that multiply the transfer function.

- The optical low-pass filter: two birefringent plates that make four equal spots of each point (physics of cameras, §16)
- Diffusion of charge between the pixels before readout: a round Gaussian
- Shake of the camera or the rail during the exposure: a Gaussian in one direction
- Veiling glare: a share of all light that a lens's surfaces and barrel scatter widely
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import mean, root
from labkit.imaging.parts.part import Part, finite
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class LowPass(Part):
    """Four spots at (+-s/2, +-t/2). rows, columns: s^2 and t^2, pixels squared.

    turned: by 45 degrees, so that s runs down to the right and t down to the left. cos(pi s
    w) is analytic in s^2, so an estimate passes s = 0 smoothly; below s^2 = 0 the cosine is
    a cosh.
    """

    rows: float = 0.0
    columns: float = 0.0
    turned: bool = False

    labels: ClassVar[tuple[str, ...]] = ("rows_px2", "columns_px2")
    usual: ClassVar[tuple[float, ...]] = (0.5, 0.5)
    meanings: ClassVar[Mapping[str, str]] = {
        "spread_px": "distance of its spots",
        "rows_px": "along rows",
        "columns_px": "along columns",
    }

    @property
    def name(self) -> str:
        return "low_pass_filter_turned" if self.turned else "low_pass_filter"

    @property
    def title(self) -> str:
        return "low-pass filter, turned by 45°" if self.turned else "low-pass filter"

    @property
    def words(self) -> str:
        return (
            "an optical low-pass filter turned by 45 degrees"
            if self.turned
            else "an optical low-pass filter"
        )

    @property
    def values(self) -> tuple[float, ...]:
        return self.rows, self.columns

    def at(self, values: Sequence[float]) -> Self:
        rows, columns = values
        return replace(self, rows=float(rows), columns=float(columns))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        along, across = self._axes(rows, columns)
        return np.asarray(_split(self.rows, along) * _split(self.columns, across))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        along, across = self._axes(rows, columns)
        return (
            np.asarray(_split_slope(self.rows, along) * _split(self.columns, across)),
            np.asarray(_split(self.rows, along) * _split_slope(self.columns, across)),
        )

    def _axes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, AnyFloats]:
        """Return the frequencies along the two plates."""
        if not self.turned:
            return rows, columns
        return (rows + columns) / math.sqrt(2), (rows - columns) / math.sqrt(2)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        table = plan.sensor.low_pass_filter
        if table is None or table.turned != self.turned:
            return None
        return self.at(table.squares), table.spread_px == "fit"

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        rows, columns = numbers
        return {
            f"{self.name}.spread_px": root(mean(numbers), "px"),
            f"{self.name}.rows_px": root(rows, "px"),
            f"{self.name}.columns_px": root(columns, "px"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sides = finite(found, f"{self.name}.rows_px", f"{self.name}.columns_px")
        return None if sides is None else self.at([side**2 for side in sides])

    def finding(self, found: Mapping[str, Uncertain]) -> str:
        return Part.finding(
            self, {key: found[key] for key in found if not key.endswith(".spread_px")}
        )


def _split(square: float, frequency: AnyFloats) -> AnyFloats:
    """Return cos(pi s w) as a function of s^2."""
    angle = np.pi * math.sqrt(abs(square)) * frequency
    return np.asarray(np.cos(angle) if square >= 0 else np.cosh(angle))


def _split_slope(square: float, frequency: AnyFloats) -> AnyFloats:
    """Return the derivative of `_split` by s^2: -(pi w)^2 / 2 times the sine over its angle."""
    angle = np.pi * math.sqrt(abs(square)) * frequency
    tiny = np.abs(angle) < 1e-4
    safe = np.where(tiny, 1.0, angle)
    ratio = np.where(tiny, 1.0, (np.sin(safe) if square >= 0 else np.sinh(safe)) / safe)
    return np.asarray(-0.5 * (np.pi * frequency) ** 2 * ratio)


@dataclass(frozen=True, slots=True)
class Diffusion(Part):
    """exp(-2 pi^2 sigma^2 w^2). variance: sigma^2, pixels squared."""

    variance: float = 0.0

    name: ClassVar[str] = "diffusion"
    title: ClassVar[str] = "charge diffusion"
    words: ClassVar[str] = "charge that diffuses between pixels"
    labels: ClassVar[tuple[str, ...]] = ("variance_px2",)
    usual: ClassVar[tuple[float, ...]] = (0.2,)
    meanings: ClassVar[Mapping[str, str]] = {"sigma_px": "standard deviation"}

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        (variance,) = values
        return type(self)(float(variance))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return np.asarray(np.exp(-2 * np.pi**2 * self.variance * (rows**2 + columns**2)))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        return (
            np.asarray(
                -2 * np.pi**2 * (rows**2 + columns**2) * self.transfer(rows, columns)
            ),
        )

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        sigma_px = plan.sensor.diffusion_px
        if sigma_px is None:
            return None
        if isinstance(sigma_px, str):
            return type(self)(), True
        return type(self)(sigma_px**2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        (variance,) = numbers
        return {"diffusion.sigma_px": root(variance, "px")}

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sigma_px = finite(found, "diffusion.sigma_px")
        return None if sigma_px is None else self.at([sigma**2 for sigma in sigma_px])


@dataclass(frozen=True, slots=True)
class Smear(Part):
    """A Gaussian of any direction, by its second moments, pixels squared: rows, columns, and across, of rows and columns.

    A line of length l has the variance l^2 / 12, and its Gaussian's transfer function to the fourth power of l w.
    """

    rows: float = 0.0
    columns: float = 0.0
    across: float = 0.0

    name: ClassVar[str] = "smear"
    title: ClassVar[str] = "smear"
    words: ClassVar[str] = "smear, by a shake or a rolling shutter"
    labels: ClassVar[tuple[str, ...]] = ("rows_px2", "columns_px2", "across_px2")
    usual: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2)
    meanings: ClassVar[Mapping[str, str]] = {
        "rows_px": "along rows",
        "columns_px": "along columns",
        "slant_px2": "covariance of both",
    }

    @property
    def values(self) -> tuple[float, ...]:
        return self.rows, self.columns, self.across

    def at(self, values: Sequence[float]) -> Self:
        rows, columns, across = values
        return type(self)(float(rows), float(columns), float(across))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        moment = (
            self.rows * rows**2
            + self.columns * columns**2
            + 2 * self.across * rows * columns
        )
        return np.asarray(np.exp(-2 * np.pi**2 * moment))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        transfer = -2 * np.pi**2 * self.transfer(rows, columns)
        return rows**2 * transfer, columns**2 * transfer, 2 * rows * columns * transfer

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        sigma_px = plan.sensor.smear_px
        if sigma_px is None:
            return None
        if isinstance(sigma_px, str):
            return type(self)(), True
        rows, columns = sigma_px if isinstance(sigma_px, tuple) else (sigma_px, sigma_px)
        return type(self)(rows**2, columns**2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        rows, columns, across = numbers
        return {
            "smear.rows_px": root(rows, "px"),
            "smear.columns_px": root(columns, "px"),
            "smear.slant_px2": Uncertain(across.value, across.std, "px²"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sides = finite(found, "smear.rows_px", "smear.columns_px")
        if sides is None:
            return None
        slant = finite(found, "smear.slant_px2") or [0.0]  # earlier results lack it
        return self.at([*(side**2 for side in sides), *slant])


SCALE_PX = 15.0
"""Width of the veil without prior knowledge."""

NARROWEST_PX, BROADEST_PX = 3.0, 100.0
"""Limits of the estimated width: a narrower veil acts as aberrations, a veil much broader than the picture as ambient light."""


@dataclass(frozen=True, slots=True)
class Veil(Part):
    """Veiling glare exp(-r / scale_px), r the distance in pixels, with a share of the light.

    Scattered light has long tails. A share of 0 leaves the scale undetermined; then the
    usual scale holds. Of a usual glare 83 % stays within its reach; the light beyond is
    nearly even.
    """

    share: float = 0.0
    scale_px: float = SCALE_PX

    name: ClassVar[str] = "veil"
    title: ClassVar[str] = "veil of stray light"
    words: ClassVar[str] = "a veil of stray light"
    labels: ClassVar[tuple[str, ...]] = ("share", "log_scale")
    usual: ClassVar[tuple[float, ...]] = (0.2, 1.0)
    meanings: ClassVar[Mapping[str, str]] = {
        "share": "of all light",
        "scale_px": "distance over which it falls to 1/e",
    }
    reach_px: ClassVar[float] = 48.0

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share, math.log(self.scale_px / SCALE_PX))

    def at(self, values: Sequence[float]) -> Self:
        share, log_scale = map(float, values)
        least = math.log(NARROWEST_PX / SCALE_PX)
        most = math.log(BROADEST_PX / SCALE_PX)
        return type(self)(share, SCALE_PX * math.exp(min(max(log_scale, least), most)))

    @property
    def idle(self) -> bool:
        return not self.share

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return 1 + self.share * self.slopes(rows, columns)[0]

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        square = (2 * np.pi * self.scale_px) ** 2 * (rows**2 + columns**2)
        return (
            np.asarray((1 + square) ** -1.5 - 1),
            np.asarray(-3 * self.share * square * (1 + square) ** -2.5),
        )

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        share = plan.lens.veil
        scale_px = plan.lens.veil_scale_px
        if share is None:
            return None
        if isinstance(share, str):
            return type(self)(scale_px=scale_px), True
        return type(self)(share, scale_px), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        share, log_scale = numbers
        scale_px = SCALE_PX * float(np.exp(log_scale.value))
        return {
            "veil.share": share,
            "veil.scale_px": Uncertain(scale_px, scale_px * log_scale.std, "px"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        share = finite(found, "veil.share")
        if share is None:
            return None
        return type(self)(*share, *(finite(found, "veil.scale_px") or [SCALE_PX]))
