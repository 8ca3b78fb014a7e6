"""The width of the light's spectrum, which each channel has of its own: PSFs of several wavelengths add up."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from labkit.imaging.estimated import root
from labkit.imaging.parts.part import Part, finite
from labkit.optics.spectrum import WIDEST_SPECTRUM, Spectrum
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

MOST_VARIANCE = WIDEST_SPECTRUM**2
VARIANCE_STEP, LEAST_VARIANCE_STEP = (
    0.1,
    1e-6,
)  # of the variance in its differences: a share of itself, and at least


@dataclass(frozen=True, slots=True)
class SpectrumWidth(Part):
    """Light of a symmetric spectrum. variance: of its wavelengths, over the squared wavelength of the channel.

    Below 0 the light sharpens as much as light of the positive variance blurs: `Spectrum.of_width`.
    """

    variance: float = 0.0

    name: ClassVar[str] = "spectrum"
    title: ClassVar[str] = "spectrum"
    words: ClassVar[str] = "light of several wavelengths"
    labels: ClassVar[tuple[str, ...]] = ("variance",)
    usual: ClassVar[tuple[float, ...]] = (MOST_VARIANCE,)
    meanings: ClassVar[Mapping[str, str]] = {"width_nm": "standard deviation"}
    per_channel: ClassVar[bool] = True
    broadest: ClassVar[Spectrum] = Spectrum.of_width(MOST_VARIANCE)

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        (variance,) = values
        return type(self)(min(max(float(variance), -MOST_VARIANCE), MOST_VARIANCE))

    @property
    def idle(self) -> bool:
        return True

    @property
    def light(self) -> Spectrum:
        return Spectrum.of_width(self.variance)

    def light_slopes(self) -> tuple[Mapping[float, float], ...]:
        """Return central differences, one-sided if the variance can grow no more."""
        step = max(VARIANCE_STEP * abs(self.variance), LEAST_VARIANCE_STEP)
        above = min(self.variance + step, MOST_VARIANCE)
        below = max(self.variance - step, -MOST_VARIANCE)
        slopes = defaultdict[float, float](float)
        for sign, variance in ((1, above), (-1, below)):
            for share, node in Spectrum.of_width(variance).shares:
                slopes[node] += sign * share / (above - below)
        return (slopes,)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        if channel.width_nm is None:
            return None
        if isinstance(channel.width_nm, str):
            return type(self)(), True
        return type(self)((channel.width_nm / channel.wavelength_nm) ** 2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        assert channel is not None
        (variance,) = numbers
        nm = channel.wavelength_nm
        width = root(variance)
        return {
            f"spectrum.{channel.name}.width_nm": Uncertain(
                nm * width.value, nm * width.std, "nm"
            )
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        assert channel is not None
        width_nm = finite(found, f"spectrum.{channel.name}.width_nm")
        return (
            None
            if width_nm is None
            else self.at([(nm / channel.wavelength_nm) ** 2 for nm in width_nm])
        )
