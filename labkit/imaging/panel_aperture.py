"""The lit part of a panel's stripes: two numbers of the drawn target, which fits estimate with the camera's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from labkit.imaging.estimated import Estimated
from labkit.panel import USUAL_APERTURE
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

LEAST_APERTURE_SHARE = 0.02
"""Least drawn aperture: apertures are above 0, but a step of a fit can ask for less."""


@dataclass(frozen=True, slots=True)
class Aperture(Estimated):
    """Excess of a stripe's lit width and length over the usual, as shares: `labkit.panel.drawn_target`.

    `labkit.imaging.scene` draws the target accordingly; the transfer function does not
    depend on the aperture.
    """

    across: float = 0.0
    down: float = 0.0

    name: ClassVar[str] = "panel_pixels"
    title: ClassVar[str] = "the panel's pixels"
    labels: ClassVar[tuple[str, ...]] = ("across", "down")
    usual: ClassVar[tuple[float, ...]] = (0.15, 0.15)
    meanings: ClassVar[Mapping[str, str]] = {
        "lit_across": "share of its third that a stripe is lit over",
        "lit_down": "share of the pitch along it",
    }

    @classmethod
    def wanted(cls, plan: Plan) -> Self | None:
        """Return the usual aperture if a plan states a panel's pixels but not their lit part, else None."""
        pixels = plan.target.pixels
        return cls() if pixels is not None and pixels.aperture is None else None

    @property
    def values(self) -> tuple[float, ...]:
        return self.across, self.down

    @property
    def lit(self) -> tuple[float, float]:
        """Across and down: shares of a third of a pixel, and of a pixel."""
        return max(USUAL_APERTURE + self.across, LEAST_APERTURE_SHARE), max(
            USUAL_APERTURE + self.down, LEAST_APERTURE_SHARE
        )

    def at(self, values: Sequence[float]) -> Self:
        across, down = values
        return type(self)(float(across), float(down))

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        across, down = (
            Uncertain(USUAL_APERTURE + number.value, number.std) for number in numbers
        )
        return {"panel_pixels.lit_across": across, "panel_pixels.lit_down": down}

    def finding(self, found: Mapping[str, Uncertain]) -> str:
        lit = self.own(found)
        return (
            f"a stripe of the panel's pixels is lit over {lit['lit_across']} of its third, "
            f"and over {lit['lit_down']} of the pitch"
        )
