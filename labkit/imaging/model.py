"""Parameters to the relative image on the pixels, with its exact Jacobian (thesis 2.70, 3.10; physics of Chapter II)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from labkit.arrays import mask_array, positive
from labkit.imaging.blur import Blur
from labkit.imaging.grid import Torus
from labkit.imaging.scene import Drawing, Scene
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.optics.psf import Pupil
from labkit.target import Target
from labkit.types import Bools, Complexes, Floats

WINDOW_AIRY = 120.0  # PSF window in units of lambda N; wider ones change a wavefront of 1.2 waves by less than 1e-4


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The mean and its derivatives at one frame's used pixels, in units of the target's radiance.

    mean: (pixels,); by_waves: (modes, pixels); by_pose: (8, pixels). Derivatives that were not wanted are empty.
    """

    mean: Floats
    by_waves: Floats
    by_pose: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """What is known of lens, light and sensor for one channel.

    wavelength_um: of the light; reference_um: of the waves that wavefronts are counted in. f_number: of the beam that
    reaches the sensor. pitch_um: of the pixels, whatever their colours; active_um: width of a pixel's active square. noll:
    modes of the wavefront. Raises ValueError for a length or f-number that is not above 0.

    >>> labkit.Optics(wavelength_um=0.55, reference_um=0.55, f_number=2.8, pitch_um=4.78, active_um=4.78)
    """

    wavelength_um: float
    reference_um: float
    f_number: float
    pitch_um: float
    active_um: float
    noll: tuple[int, ...] = tuple(range(4, 16))

    def __post_init__(self) -> None:
        for name in ("wavelength_um", "reference_um", "pitch_um", "active_um"):
            positive(name, getattr(self, name), "um")
        positive("f_number", self.f_number, "unitless")

    @property
    def airy_um(self) -> float:
        """lambda N, the unit of length of diffraction."""
        return self.wavelength_um * self.f_number


@dataclass(frozen=True)
class ForwardModel:
    """Target, lens and pixel: the blurred, sampled radiance H(v, alpha) f of thesis (2.70)."""

    scene: Scene
    blur: Blur

    @classmethod
    def build(
        cls,
        optics: Optics,
        target: Target,
        frame: tuple[int, int],
        reference: Pose,
        *,
        band: float = 1.0,
        window_airy: float = WINDOW_AIRY,
    ) -> "ForwardModel":
        """A model of frames of a size, (rows, columns).

        reference: the target's pose in such frames, its scale right to 5 %; see `Scene`.
        band: share of the optics' pass band that is modelled; below 1 it is a rough and quick sketch.
        window_airy: width of the PSF's window in lambda N; a smaller one is quicker and errs by the halo's dependence on
        the wavefront.
        """
        window_um = window_airy * optics.airy_um
        guard_px = math.ceil(window_um / optics.pitch_um)
        cutoff = 1 / optics.airy_um
        torus = Torus.around(frame, guard_px, optics.pitch_um, band * cutoff)
        finer = math.ceil(2 * torus.spacing_um * cutoff * (1 - 1e-9))
        spacing_um = torus.spacing_um / finer
        size = scipy.fft.next_fast_len(math.ceil(window_um / spacing_um), real=True)
        size = min(size, min(torus.fine) * finer)
        pupil = Pupil(optics.wavelength_um, optics.reference_um, optics.f_number, spacing_um, size, optics.noll)
        return cls(Scene(torus, target, band * cutoff, reference), Blur(torus, pupil, optics.active_um))

    @property
    def optics(self) -> Optics:
        """What it was built for."""
        pupil, pitch_um, active_um = self.blur.pupil, self.scene.torus.pitch_um, self.blur.active_um
        return Optics(
            wavelength_um=pupil.wavelength_um,
            reference_um=pupil.reference_um,
            f_number=pupil.f_number,
            pitch_um=pitch_um,
            active_um=active_um,
            noll=pupil.noll,
        )

    def draw(self, poses: Sequence[Pose]) -> Drawing:
        """The target from the frames' poses: what `means` and `evaluate` blur."""
        return self.scene.draw(poses)

    def means(self, waves: Floats, drawing: Drawing, used: Sequence[Bools]) -> list[Floats]:
        """The mean at the used pixels of each frame. used: masks (rows, columns) of the frame."""
        self._checked(drawing, used)
        transfer = self.blur.transfer(waves)
        return [
            self._sample(spectrum * transfer, u, self.scene.surround)
            for spectrum, u in zip(drawing.spectra, used, strict=True)
        ]

    def evaluate(
        self, waves: Floats, drawing: Drawing, used: Sequence[Bools], *, by_waves: bool = True
    ) -> list[Evaluation]:
        """Mean and Jacobian at the used pixels of each frame; the wavefront is common to all of them.

        by_waves: whether derivatives by the wavefront are wanted; they cost most of the time.
        """
        self._checked(drawing, used)
        transfer = self.blur.transfer(waves)
        spread = self.blur.spread(transfer)
        product = np.empty_like(transfer)  # fresh memory for each costs as much as the multiplication
        slopes = [np.empty((len(waves) if by_waves else 0, int(u.sum()))) for u in used]
        for mode, slope in enumerate(self.blur.transfer_jacobian(waves) if by_waves else ()):
            for spectrum, u, out in zip(drawing.spectra, used, slopes, strict=True):
                out[mode] = self._sample(np.multiply(spectrum, slope, out=product), u)
        results = []
        for spectrum, pose, u, by_mode in zip(drawing.spectra, drawing.poses, used, slopes, strict=True):
            mean = self._sample(spectrum * transfer, u, self.scene.surround)
            results.append(Evaluation(mean, by_mode, self._by_pose(spectrum, transfer, spread, pose, u)))
        return results

    def departures(self, psfs: Floats, drawing: Drawing, used: Bools) -> Floats:
        """(n, pixels) by which departures (n, size, size) of the PSF from the perfect one change the mean of one frame."""
        (spectrum,) = drawing.spectra
        return np.array([self._sample(spectrum * self.blur.departure(psf), used) for psf in psfs])

    def slopes(self, waves: Floats, drawing: Drawing, used: Bools, only: slice) -> Floats:
        """(modes, pixels) derivatives of one frame by some of the modes, for those who cannot hold all at once."""
        (spectrum,) = drawing.spectra
        return np.array([self._sample(spectrum * s, used) for s in self.blur.transfer_jacobian(waves, only)])

    def _checked(self, drawing: Drawing, used: Sequence[Bools]) -> None:
        if len(drawing.poses) != len(used):
            raise ValueError(
                f"poses, used: {len(drawing.poses)} poses and {len(used)} masks; each frame needs one of both"
            )
        for mask in used:
            mask_array("used", mask, self.scene.torus.frame)

    def _sample(self, spectrum: Complexes, used: Bools, offset: float = 0.0) -> Floats:
        return self.blur.torus.sample(spectrum)[used] + offset

    def _by_pose(
        self, spectrum: Complexes, transfer: Complexes, spread: tuple[Complexes, Complexes], pose: Pose, used: Bools
    ) -> Floats:
        """Derivatives by the pose: -h * (grad f . w), w(x) the motion of the target's point at x.

        w is linear over the width of the PSF, so with t the place in the PSF this is
        -w . (h * grad f) + sum_ab dw_a/dx_b ((t_b h) * df/dx_a): exact for affine motions, and for perspective up to the
        square of blur over distance.
        """
        torus = self.blur.torus
        rows, columns = (index.astype(np.float64) for index in np.nonzero(used))
        motions = pose.jacobian(rows, columns)
        one_down = pose.jacobian(rows + 0.5, columns), pose.jacobian(rows - 0.5, columns)
        one_right = pose.jacobian(rows, columns + 0.5), pose.jacobian(rows, columns - 0.5)
        result = np.zeros((POSE_SIZE, rows.size))
        for axis, frequency in enumerate((torus.row_frequency, torus.column_frequency)):
            gradient = spectrum * (2j * np.pi * torus.pitch_um * frequency)
            result -= motions[axis] * self._sample(gradient * transfer, used)
            for (high, low), kernel in zip((one_down, one_right), spread, strict=True):
                result += (high[axis] - low[axis]) * self._sample(gradient * kernel, used) / torus.pitch_um
        return result
