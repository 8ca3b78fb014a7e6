"""Numbers of the optics at best focus: of a wavefront without its defocus, each with its standard error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from labkit.optics import metrics
from labkit.optics.encircled_energy import radius_of_energy
from labkit.optics.metrics import Directed
from labkit.optics.mtf import Curve, Direction, mtf, mtf50
from labkit.optics.strehl import strehl
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

SHARE = 0.8
"""Share of the energy, whose radius is reported: most lens tests state this value."""


@dataclass(frozen=True, eq=False)
class BestFocus:
    """A wavefront at best focus, the focus of zero Noll defocus.

    The numbers are of the optics alone and belong to the lens, not to the photographed range. Each number is
    computed on first use, and kept. Twins, which differ in the sign of the even modes, have the same numbers.

    Parameters
    ----------
    fitted : the wavefront without defocus

    >>> w = labkit.Results.load("night-3")[3200, "G"]
    >>> print(w.best.strehl, w.best.rms_nm, w.best.mtf50("x"))
    """

    fitted: FittedWavefront
    _kept: dict[tuple[Any, ...], Uncertain] = field(default_factory=dict, repr=False)

    @cached_property
    def ideal(self) -> BestFocus:
        """A lens without aberrations, of the same cone and light."""
        return BestFocus(self.fitted.without(self.fitted.noll))

    @cached_property
    def strehl(self) -> Uncertain:
        """Strehl ratio."""
        return strehl(self.fitted)

    @cached_property
    def rms(self) -> Uncertain:
        """RMS of the path difference, waves at the reference wavelength."""
        return metrics.rms(self.fitted)

    @property
    def rms_nm(self) -> Uncertain:
        """RMS of the path difference, nm."""
        return _times(self.rms, 1e3 * self.fitted.reference_um, "nm")

    @property
    def rms_own_waves(self) -> Uncertain:
        """RMS of the path difference, waves at the channel's own wavelength."""
        return _times(
            self.rms, self.fitted.reference_um / self.fitted.wavelength_um, "waves"
        )

    @cached_property
    def peak_to_valley(self) -> Uncertain:
        """Greatest path difference less the least, waves at the reference wavelength."""
        return metrics.peak_to_valley(self.fitted)

    @cached_property
    def astigmatism(self) -> Directed | None:
        """Primary astigmatism, Noll 5 and 6; None where either was not fitted."""
        return self._pair(metrics.astigmatism, 5, 6)

    @cached_property
    def coma(self) -> Directed | None:
        """Primary coma, Noll 7 and 8; None where either was not fitted."""
        return self._pair(metrics.coma, 7, 8)

    @cached_property
    def trefoil(self) -> Directed | None:
        """Primary trefoil, Noll 9 and 10; None where either was not fitted."""
        return self._pair(metrics.trefoil, 9, 10)

    def mtf(self, frequency_per_mm: ArrayLike, direction: Direction | float = "x") -> Curve:
        """MTF of the optics alone with standard errors, along "x" (right), "y" (down), or degrees from x towards y."""
        return mtf(self.fitted, frequency_per_mm, direction)

    def mtf_at(
        self, frequency_per_mm: float, direction: Direction | float = "x"
    ) -> Uncertain:
        """MTF of the optics alone at a frequency, cycles/mm."""
        curve = self.mtf(frequency_per_mm, direction)
        return Uncertain(float(curve.value), float(curve.std))

    def mtf50(
        self, direction: Direction | float = "x", active_um: float | None = None
    ) -> Uncertain:
        """Lowest frequency at which the MTF is 0.5, cycles/mm.

        Parameters
        ----------
        direction : "x" (right), "y" (down), or degrees from x towards y
        active_um : width of a pixel's square active area, to include its MTF; None for the optics alone
        """
        return self._once(
            ("mtf50", direction, active_um),
            lambda: mtf50(self.fitted, direction, active_um=active_um),
        )

    def energy_radius(self, share: float = SHARE) -> Uncertain:
        """Radius, um, of the circle about the centroid with a share of the energy, at most 0.99."""
        return self._once(("energy", share), lambda: radius_of_energy(self.fitted, share))

    def psf(self, spacing_um: float, size: int | None = None) -> Floats:
        """(size, size) point-spread function of the optics alone, as `Wavefront.psf` has it."""
        return metrics.psf_value(self.fitted, spacing_um, size)

    def opd(self, samples: int) -> Floats:
        """(samples, samples) path difference over the pupil, waves at the reference wavelength; nan outside."""
        return metrics.opd_map(self.fitted, samples).value

    def _once(self, name: tuple[Any, ...], computed: Callable[[], Uncertain]) -> Uncertain:
        if name not in self._kept:
            self._kept[name] = computed()
        return self._kept[name]

    def _pair(
        self, measure: Callable[[FittedWavefront], Directed], *modes: int
    ) -> Directed | None:
        return measure(self.fitted) if set(modes) <= set(self.fitted.noll) else None


def _times(number: Uncertain, factor: float, unit: str) -> Uncertain:
    return Uncertain(factor * number.value, factor * number.std, unit)
