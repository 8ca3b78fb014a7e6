"""The width of the light's spectrum, which each channel has of its own: PSFs of several wavelengths add up."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from labkit.imaging.estimated import root
from labkit.imaging.parts.part import Part, finite
from labkit.optics.rim import Place
from labkit.optics.spectrum import ONE_WAVELENGTH, WIDEST_SPECTRUM, Spectrum
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

MOST_VARIANCE = WIDEST_SPECTRUM**2
LARGEST_LESS = 0.99
"""Largest share of a typical spectrum's variance that an estimate may subtract."""

VARIANCE_STEP, LEAST_VARIANCE_STEP = (
    0.1,
    1e-6,
)  # of the variance in its differences: a share of itself, and at least


@dataclass(frozen=True, slots=True)
class SpectrumWidth(Part):
    """Light of a symmetric spectrum, or of another width than a typical one.

    variance: of the wavelengths, over the squared wavelength of the channel, in excess of
    the variance of `typical`. Without a typical spectrum light of a variance below 0
    sharpens as much as light of the positive variance blurs: `Spectrum.of_width`.
    """

    variance: float = 0.0
    typical: Spectrum = ONE_WAVELENGTH

    name: ClassVar[str] = "spectrum"
    title: ClassVar[str] = "spectrum"
    words: ClassVar[str] = "light of several wavelengths"
    labels: ClassVar[tuple[str, ...]] = ("variance",)
    usual: ClassVar[tuple[float, ...]] = (MOST_VARIANCE,)
    meanings: ClassVar[Mapping[str, str]] = {"width_nm": "standard deviation"}
    per_channel: ClassVar[bool] = True

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        (variance,) = values
        least, most = self._bounds
        return replace(self, variance=min(max(float(variance), least), most))

    def about(self, typical: Spectrum, place: Place | None) -> Self:
        return replace(self, typical=typical)

    @property
    def one_sided(self) -> bool:  # type: ignore[override]
        return not self.typical.variance

    @property
    def idle(self) -> bool:
        return True

    @property
    def light(self) -> Spectrum:
        return self._with(self.variance)

    @property
    def broadest(self) -> Spectrum:
        """The broadest of all spectra within the bounds."""
        return self._with(self._bounds[1])

    def light_slopes(self) -> tuple[Mapping[float, float], ...]:
        """Return central differences, one-sided if the variance can grow no more."""
        least, most = self._bounds
        step = max(
            VARIANCE_STEP * abs(self.typical.variance + self.variance), LEAST_VARIANCE_STEP
        )
        above = min(self.variance + step, most)
        below = max(self.variance - step, least)
        slopes = defaultdict[float, float](float)
        for sign, variance in ((1, above), (-1, below)):
            for share, node in self._with(variance).shares:
                slopes[node] += sign * share / (above - below)
        return (slopes,)

    @property
    def _bounds(self) -> tuple[float, float]:
        """Least and largest variance in excess of the typical one, which is at most doubled."""
        known = self.typical.variance
        return (-LARGEST_LESS * known, known) if known else (-MOST_VARIANCE, MOST_VARIANCE)

    def _with(self, variance: float) -> Spectrum:
        return self.typical.with_variance(self.typical.variance + variance)

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
        whole = Uncertain(variance.value + self.typical.variance, variance.std)
        nm = channel.wavelength_nm
        width = root(whole)
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
