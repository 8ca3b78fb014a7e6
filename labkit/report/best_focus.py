"""What each channel's optics do at best focus, from the wavefront that was photographed nearest to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from labkit.optics import metrics
from labkit.optics.encircled_energy import radius_of_energy
from labkit.optics.metrics import Directed
from labkit.optics.mtf import Direction, mtf, mtf50, pixel_mtf
from labkit.optics.strehl import strehl
from labkit.optics.wavefront import FittedWavefront
from labkit.plan import Sensor
from labkit.results import Results, Wavefront
from labkit.uncertain import Uncertain

SHARE = 0.8  # of the energy, whose radius is reported: most lens tests state this one
DIRECTIONS: tuple[Direction, ...] = ("x", "y")


@dataclass(frozen=True, slots=True)
class BestFocus:
    """A channel's numbers at best focus, with standard errors.

    photographed: the wavefront nearest to focus; fitted: the same without defocus; perfect: without any aberration.
    active_um: width of a pixel's active area. mtf50, camera_mtf50: along x and y, cycles/mm, of the optics alone and with the
    pixel; at_nyquist, camera_at_nyquist: MTF where the channel's own pixels have Nyquist's frequency. energy_radius_um: of
    the circle that holds SHARE of the energy. A pair of modes that was not fitted is None.
    """

    photographed: Wavefront
    fitted: FittedWavefront
    perfect: FittedWavefront
    strehl: Uncertain
    rms: Uncertain
    peak_to_valley: Uncertain
    nyquist_per_mm: float
    active_um: float
    mtf50: dict[Direction, Uncertain]
    camera_mtf50: dict[Direction, Uncertain]
    at_nyquist: dict[Direction, Uncertain]
    camera_at_nyquist: dict[Direction, Uncertain]
    energy_radius_um: Uncertain
    astigmatism: Directed | None
    coma: Directed | None
    trefoil: Directed | None

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.photographed.channel

    @classmethod
    def of(cls, wavefront: Wavefront, sensor: Sensor) -> BestFocus:
        """The numbers of a wavefront, whatever its defocus."""
        fitted, active_um = wavefront.at_focus(), sensor.active_um
        nyquist = plane_nyquist_per_mm(sensor, wavefront.channel)
        optics = {d: mtf_at(fitted, nyquist, d) for d in DIRECTIONS}
        pixel = float(pixel_mtf(nyquist, active_um, "x"))  # square: the same along y
        return cls(
            photographed=wavefront,
            fitted=fitted,
            perfect=fitted.without(fitted.noll),
            strehl=strehl(fitted),
            rms=metrics.rms(fitted),
            peak_to_valley=metrics.peak_to_valley(fitted),
            nyquist_per_mm=nyquist,
            active_um=active_um,
            mtf50={d: mtf50(fitted, d) for d in DIRECTIONS},
            camera_mtf50={d: mtf50(fitted, d, active_um=active_um) for d in DIRECTIONS},
            at_nyquist=optics,
            camera_at_nyquist={
                d: Uncertain(pixel * one.value, pixel * one.std)
                for d, one in optics.items()
            },
            energy_radius_um=radius_of_energy(fitted, SHARE),
            astigmatism=_pair(metrics.astigmatism, fitted, 5, 6),
            coma=_pair(metrics.coma, fitted, 7, 8),
            trefoil=_pair(metrics.trefoil, fitted, 9, 10),
        )


def _pair(
    measure: Callable[[FittedWavefront], Directed], fitted: FittedWavefront, *modes: int
) -> Directed | None:
    return measure(fitted) if set(modes) <= set(fitted.noll) else None


def mtf_at(
    fitted: FittedWavefront, frequency_per_mm: float, direction: Direction
) -> Uncertain:
    """MTF of the optics alone at one frequency."""
    curve = mtf(fitted, frequency_per_mm, direction)
    return Uncertain(float(curve.value), float(curve.std))


def at_best_focus(results: Results) -> list[BestFocus]:
    """For each channel, what its wavefront of least defocus is without it."""
    sensor = results.plan.sensor
    return [
        BestFocus.of(min(results.of_channel(channel), key=_defocus), sensor)
        for channel in results.channels
    ]


def _defocus(wavefront: Wavefront) -> float:
    return abs(wavefront.defocus.value) if wavefront.defocus else 0.0


def full_nyquist_per_mm(sensor: Sensor) -> float:
    """Nyquist's frequency of all pixels, cycles/mm along rows and columns."""
    return 500.0 / sensor.pixel_pitch_um


def plane_nyquist_per_mm(sensor: Sensor, channel: str) -> float:
    """That of the pixels of one channel: half as high in a filter array of 2 x 2."""
    return full_nyquist_per_mm(sensor) / sensor.pixels(channel).period
