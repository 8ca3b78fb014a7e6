"""What each channel's optics do at best focus, from the wavefront that was photographed nearest to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from labkit.analysis.expected_bound import planes_of
from labkit.optics import metrics
from labkit.optics.encircled_energy import radius_of_energy
from labkit.optics.metrics import Directed
from labkit.optics.mtf import Direction, mtf50
from labkit.optics.strehl import strehl
from labkit.optics.wavefront import FittedWavefront
from labkit.results import Results, Wavefront
from labkit.uncertain import Uncertain

SHARE = 0.8  # of the energy, whose radius is reported: most lens tests state this one
DIRECTIONS: tuple[Direction, ...] = ("x", "y")


@dataclass(frozen=True, slots=True)
class BestFocus:
    """A channel's numbers at best focus, with standard errors.

    photographed: the wavefront nearest to focus; fitted: the same without defocus; perfect: without any aberration.
    mtf50: along x and y, cycles/mm; energy_radius_um: of the circle that holds SHARE of the energy. A pair of modes that was
    not fitted is None.
    """

    photographed: Wavefront
    fitted: FittedWavefront
    perfect: FittedWavefront
    strehl: Uncertain
    rms: Uncertain
    peak_to_valley: Uncertain
    mtf50: dict[Direction, Uncertain]
    energy_radius_um: Uncertain
    astigmatism: Directed | None
    coma: Directed | None
    trefoil: Directed | None

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.photographed.channel

    @classmethod
    def of(cls, wavefront: Wavefront) -> BestFocus:
        """The numbers of a wavefront, whatever its defocus."""
        fitted = wavefront.at_focus()
        return cls(
            photographed=wavefront,
            fitted=fitted,
            perfect=fitted.without(fitted.noll),
            strehl=strehl(fitted),
            rms=metrics.rms(fitted),
            peak_to_valley=metrics.peak_to_valley(fitted),
            mtf50={direction: mtf50(fitted, direction) for direction in DIRECTIONS},
            energy_radius_um=radius_of_energy(fitted, SHARE),
            astigmatism=_pair(metrics.astigmatism, fitted, 5, 6),
            coma=_pair(metrics.coma, fitted, 7, 8),
            trefoil=_pair(metrics.trefoil, fitted, 9, 10),
        )


def _pair(measure: Callable[[FittedWavefront], Directed], fitted: FittedWavefront, *modes: int) -> Directed | None:
    return measure(fitted) if set(modes) <= set(fitted.noll) else None


def at_best_focus(results: Results) -> list[BestFocus]:
    """For each channel, what its wavefront of least defocus is without it."""
    return [BestFocus.of(min(results.of_channel(channel), key=_defocus)) for channel in results.channels]


def _defocus(wavefront: Wavefront) -> float:
    return abs(wavefront.defocus.value) if wavefront.defocus else 0.0


def nyquist_per_mm(results: Results, channel: str) -> tuple[float, float]:
    """Nyquist's frequency of the full sampling, and of the channel's pixels alone; cycles/mm along rows and columns."""
    full = 500.0 / results.plan.sensor.pixel_pitch_um
    return full, full / planes_of(results.plan.sensor, channel).period
