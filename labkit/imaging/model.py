"""Parameters to the relative image on the pixels, with its exact Jacobian (thesis 2.70, 3.10; physics of Chapter II)."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.fft

from labkit.arrays import mask_array
from labkit.imaging.blur import Blur
from labkit.imaging.brightness import Brightness
from labkit.imaging.grid import Torus
from labkit.imaging.halo import guards, light_beyond, wrapped_light
from labkit.imaging.optics import Optics
from labkit.imaging.scene import Drawing, Scene
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.imaging.window import WINDOW_AIRY
from labkit.panel.drawn_target import PanelTarget
from labkit.target.target import Target
from labkit.types import AnyComplexes, Bools, Complexes64, Floats, Floats32

# cycles a pixel, up to which slopes are modelled: the first zero of an active pixel as wide as its pitch
ROUGH_BAND = 1.0

# relative change of a halo, up to which the light that comes around the torus is the same
HALO_MARGIN = 0.02

# -w, and by how much w grows from row to row and from column to column: signs and places, in pixels, that it is taken at
GROWTH = (
    ((-1, 0.0, 0.0),),
    ((1, 0.5, 0.0), (-1, -0.5, 0.0)),
    ((1, 0.0, 0.5), (-1, 0.0, -0.5)),
)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The mean and its derivatives at one frame's used pixels, in units of the target's radiance there.

    Derivatives that were not requested are empty.

    Attributes
    ----------
    mean : (pixels,)
    by_waves : (modes, pixels), followed by derivatives by `Optics.camera_parameters` if requested
    by_pose : (8, pixels)
    by_brightness : (2, pixels), by the light that may be due to the lens or to the target
        (`Brightness.growth_std`), if there is any
    """

    mean: Floats
    by_waves: Floats
    by_pose: Floats
    by_brightness: Floats = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True)
class ForwardModel:
    """Target, lens and pixel: the blurred, sampled radiance H(v, alpha) f of thesis (2.70).

    optics: as built. rough: the same blur up to ROUGH_BAND, for the slopes of a climb:
    docs/decisions.md. wrapped: (rows, columns) of the frame, light that comes around the
    torus, which is subtracted. window_airy: width of the PSF's window, lambda N. beside:
    (rows, columns) light of neighbouring targets, for a lambda N of one pixel; None without.
    """

    optics: Optics
    scene: Scene
    blur: Blur
    rough: Blur
    wrapped: Floats
    window_airy: float = WINDOW_AIRY
    beside: Floats | None = None

    @property
    def _pixels(self) -> tuple[Floats, Floats]:
        """Rows and columns of the frame."""
        rows, columns = self.scene.torus.frame
        return np.arange(rows, dtype=np.float64), np.arange(columns, dtype=np.float64)

    @cached_property
    def light(self) -> Floats:
        """(rows, columns) how brightly the target shines at each pixel, relative."""
        brightness = self.scene.brightness
        return (
            np.ones(self.scene.torus.frame)
            if brightness is None
            else brightness.at(*self._pixels)
        )

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
        f_number_margin: float = 0.0,
        brightness: Brightness | None = None,
        beside: Floats | None = None,
    ) -> "ForwardModel":
        """Build a model of frames of a given size.

        Parameters
        ----------
        optics, target : lens, light and sensor, and the photographed target
        frame : (rows, columns) of the frames
        reference : the target's pose in such frames, its scale right to 5 %; see `Scene`
        band : modelled share of the optics' pass band; below 1 the model is a rough and
            quick sketch
        window_airy : width of the PSF's window in lambda N; a smaller window is quicker and
            errs by the halo's dependence on the wavefront
        f_number_margin : relative, by which `with_optics` may lower the f-number
        brightness : brightness of the target from place to place
        beside : (rows, columns) light of neighbouring targets, for a lambda N of one pixel
        """
        window_um = window_airy * optics.airy_um
        cutoff = optics.rim.reach / (
            optics.airy_um * (1 - f_number_margin) * optics.shortest
        )
        reaches_px = (part.reach_px for part in (*optics.parts, *optics.given))
        whole = reference.of_target(target.size_mm)
        guard_px = guards(
            frame, whole, max(window_um / 2 / optics.pitch_um, *reaches_px, 0.0)
        )
        torus = Torus.around(frame, guard_px, optics.pitch_um, band * cutoff)
        target = _lit(target, optics)
        halo_um = optics.airy_um * optics.rim.halo
        wrapped = wrapped_light(torus, target, reference, halo_um, optics.active_um)
        for far in (beside, light_beyond(torus, target, whole)):
            if far is not None:
                wrapped = wrapped - far * (halo_um / optics.pitch_um)
        limit = min(band * cutoff, ROUGH_BAND / optics.pitch_um)
        fewer = replace(
            torus,
            oversampling=math.ceil(2 * optics.pitch_um * limit * (1 - 1e-9)),
            band_limit_per_um=limit,
        )
        blur = blur_on(torus, optics, window_um, cutoff)
        rough = (blur if fewer == torus else replace(blur, torus=fewer)).simple
        return cls(
            optics,
            Scene(torus, target, band * cutoff, reference, brightness),
            blur,
            rough,
            wrapped,
            window_airy,
            beside,
        )

    def with_optics(self, optics: Optics) -> "ForwardModel":
        """Return the model with other `Optics.camera_parameters`, parts or modes.

        Drawings serve both unless a panel's `Aperture` changes.

        Raises
        ------
        ValueError : the cone is wider than the margin allows, at some wavelength of the light, or the rim has another halo
        """
        rim = optics.rim
        highest = rim.reach / (optics.airy_um * min(optics.light.nodes))
        if not rim.is_round and highest > self.scene.torus.band_limit_per_um:
            raise ValueError(
                f"light passes up to {highest:g} cycles/um, beyond the model's "
                f"{self.scene.torus.band_limit_per_um:g}"
            )
        if abs(rim.halo / self.optics.rim.halo - 1) > HALO_MARGIN:
            raise ValueError(
                f"the rim's halo is {rim.halo:g}, the model's {self.optics.rim.halo:g}"
            )
        pupil = replace(
            self.blur.pupil, f_number=optics.f_number, noll=optics.noll, rim=rim
        )
        blur = replace(self.blur, pupil=pupil, spectrum=optics.light, parts=optics.parts)
        target = _lit(self.scene.target, optics)
        scene = (
            self.scene
            if target is self.scene.target
            else replace(self.scene, target=target)
        )
        rough = replace(blur, torus=self.rough.torus).simple
        return replace(self, optics=optics, scene=scene, blur=blur, rough=rough)

    def rebuilt(
        self, optics: Optics, reference: Pose, *, waves: Floats, f_number_margin: float
    ) -> "ForwardModel":
        """Build the model anew for other optics, over the whole band, with a window for a wavefront (modes,) RMS."""
        window_airy = max(self.window_airy, optics.window_airy(waves))
        scene = self.scene
        return ForwardModel.build(
            optics,
            scene.target,
            scene.torus.frame,
            reference,
            window_airy=window_airy,
            f_number_margin=f_number_margin,
            brightness=scene.brightness,
            beside=self.beside,
        )

    def draw(self, poses: Sequence[Pose]) -> Drawing:
        """Draw the target at the frames' poses, for `means` and `evaluate`."""
        return self.scene.draw(poses)

    def means(self, waves: Floats, drawing: Drawing, used: Sequence[Bools]) -> list[Floats]:
        """Return the mean at the used pixels of each frame.

        used: masks (rows, columns) of the frame
        """
        self._checked(drawing, used)
        transfer = self.blur.transfer(waves)
        return [
            self._mean(spectrum, transfer, u)
            for spectrum, u in zip(drawing.spectra, used, strict=True)
        ]

    def evaluate(
        self,
        waves: Floats,
        drawing: Drawing,
        used: Sequence[Bools],
        *,
        by_waves: bool = True,
        by_camera: bool = False,
        exact: bool = True,
        means: Sequence[Floats] = (),
    ) -> list[Evaluation]:
        """Compute mean and Jacobian at the used pixels of each frame; the wavefront is common to all frames.

        Parameters
        ----------
        waves : (modes,) RMS at the reference wavelength
        drawing : the target at the frames' poses
        used : (rows, columns) mask of each frame
        by_waves, by_camera : whether to compute derivatives by the wavefront and by `Optics.camera_parameters`; the former
            take most of the time
        exact : whether derivatives cover the whole band, or only the part that a climb needs
        means : result of `means` at the same point, if at hand
        """
        self._checked(drawing, used)
        blur = self.blur if exact else self.rough
        spectra = [self._cut(blur, spectrum) for spectrum in drawing.spectra]
        by_modes = self._responses(
            blur, blur.psf_slopes(waves) if by_waves else (), spectra, used
        )
        by_lens = [
            np.array(rows, float).reshape(-1, int(u.sum()))
            for rows, u in zip(by_modes, used, strict=True)
        ]
        means = means or self.means(waves, drawing, used)
        single = blur.transfer(waves, np.float32)
        if by_camera:
            by_parts = self._turned(blur, blur.by_parts(waves), spectra, used)
            by_panel = self._by_panel(blur, single, drawing, used)
            by_f_number = self._turned(blur, [blur.by_f_number(waves)], spectra, used)
            by_lens = [
                np.concatenate(rows)
                for rows in zip(by_lens, by_parts, by_panel, by_f_number, strict=True)
            ]
        kernels = (single, *blur.spread(single))
        by_pose = [
            self._lit(_by_pose(blur.torus, spectrum, kernels, pose, u), u)
            for spectrum, pose, u in zip(spectra, drawing.poses, used, strict=True)
        ]
        by_brightness = (
            self._by_brightness(blur.torus, spectra, kernels, used)
            if by_camera
            else np.empty((len(used), 0, 0))
        )
        return [
            Evaluation(*of)
            for of in zip(means, by_lens, by_pose, by_brightness, strict=True)
        ]

    def _by_brightness(
        self,
        torus: Torus,
        spectra: Sequence[Complexes64],
        kernels: Sequence[AnyComplexes],
        used: Sequence[Bools],
    ) -> list[Floats]:
        """Return (0 or 2, pixels) derivatives of each frame by the light, to first order.

        kernels: as of `_by_pose`
        """
        if self.scene.brightness is None:
            return [np.empty((0, int(u.sum()))) for u in used]
        growth_std = self.scene.brightness.growth_std(*self._pixels)
        made = []
        for spectrum, u in zip(spectra, used, strict=True):
            down, right = (torus.sample(spectrum, kernel)[u] for kernel in kernels[1:])
            made.append(
                self._lit(-growth_std[:, 0, u] * down - growth_std[:, 1, u] * right, u)
            )
        return made

    def by_parts(
        self, waves: Floats, drawing: Drawing, used: Sequence[Bools], *, first: int
    ) -> list[Floats]:
        """Return (numbers, pixels) derivatives of each frame by the numbers of the optics' parts from `first`
        on.
        """
        return self._turned(
            self.blur, self.blur.by_parts(waves, first), drawing.spectra, used
        )

    def by_modes(
        self, waves: Floats, drawing: Drawing, used: Sequence[Bools], *, first: int
    ) -> list[list[Floats32]]:
        """Return (pixels,) derivatives of each frame by each mode from `first` on."""
        psfs = self.blur.psf_slopes(waves, slice(first, None))
        return self._responses(self.blur, psfs, drawing.spectra, used)

    def _turned(
        self,
        blur: Blur,
        turns: Iterable[Complexes64],
        spectra: Sequence[Complexes64],
        used: Sequence[Bools],
    ) -> list[Floats]:
        """Return (turns, pixels) changes of each frame by derivatives of the transfer function."""
        rows = [list[Floats]() for _ in used]
        for turn in turns:
            for of_frame, spectrum, u in zip(rows, spectra, used, strict=True):
                of_frame.append(self._seen(blur.torus.sample(spectrum, turn), u))
        return [
            np.array(of_frame).reshape(-1, int(u.sum()))
            for of_frame, u in zip(rows, used, strict=True)
        ]

    def _by_panel(
        self, blur: Blur, transfer: AnyComplexes, drawing: Drawing, used: Sequence[Bools]
    ) -> list[Floats]:
        """Return (0 or 2, pixels) derivatives of each frame by a panel's aperture."""
        count = 0 if self.optics.panel is None else len(self.optics.panel.labels)
        rows = [np.zeros((count, int(u.sum()))) for u in used]
        if count:
            for of_frame, slopes, u in zip(
                rows, self.scene.slopes(drawing.poses), used, strict=True
            ):
                for row, slope in zip(
                    of_frame, slopes, strict=False
                ):  # no slopes of a target that is no panel's
                    row[:] = self._seen(
                        blur.torus.sample(self._cut(blur, slope), transfer), u
                    )
        return rows

    def departures(self, psfs: Floats32, drawing: Drawing, used: Bools) -> list[Floats32]:
        """Return (pixels,) changes of one frame's mean by each departure (n, size, size) from the perfect PSF."""
        return self._responses(self.blur, psfs, drawing.spectra, [used])[0]

    def slopes(self, waves: Floats, drawing: Drawing, used: Bools, only: slice) -> Floats:
        """Return (modes, pixels) derivatives of one frame by some of the modes, to save memory."""
        (rows,) = self._responses(
            self.blur, self.blur.psf_slopes(waves, only), drawing.spectra, [used]
        )
        return np.array(rows, float).reshape(-1, int(used.sum()))

    def _cut(self, blur: Blur, spectrum: Complexes64) -> Complexes64:
        """Return the part of a drawing's half plane in the band of a blur."""
        return (
            spectrum
            if blur.torus == self.blur.torus
            else blur.torus.cut(spectrum, self.blur.torus.oversampling)
        )

    def _responses(
        self,
        blur: Blur,
        psfs: Iterable[Floats32],
        spectra: Sequence[AnyComplexes],
        used: Sequence[Bools],
    ) -> list[list[Floats32]]:
        """Return (pixels,) changes of each frame's mean by each of some changes of the PSF."""
        behind = [blur.behind_pixel(spectrum) for spectrum in spectra]
        changes = list[list[Floats32]]([] for _ in used)
        for response in blur.responses(psfs):
            for of_frame, b, u in zip(changes, behind, used, strict=True):
                of_frame.append(
                    self._seen(blur.torus.sample(b, response), u).astype(
                        np.float32, copy=False
                    )
                )
        return changes

    def _checked(self, drawing: Drawing, used: Sequence[Bools]) -> None:
        if len(drawing.poses) != len(used):
            raise ValueError(
                f"poses, used: {len(drawing.poses)} poses and {len(used)} masks; each frame needs one of both"
            )
        for mask in used:
            mask_array("used", mask, self.scene.torus.frame)

    def _mean(self, spectrum: Complexes64, transfer: AnyComplexes, used: Bools) -> Floats:
        picture = self._seen(self.blur.torus.sample(spectrum, transfer), used)
        return picture - self.wrapped[used] + self.scene.surround

    def _seen(self, picture: Floats, used: Bools) -> Floats:
        """Return (pixels,) the used pixels of an image (rows, columns), relative to the target's brightness
        there.
        """
        return self._lit(picture[used], used)

    def _lit(self, pixels: Floats, used: Bools) -> Floats:
        """Return (..., pixels) relative to the target's brightness at the used pixels."""
        return pixels if self.scene.brightness is None else pixels / self.light[used]


def _lit(target: Target, optics: Optics) -> Target:
    """Return the target with the optics' estimated aperture; itself if the aperture is not estimated."""
    if (
        optics.panel is None
        or not isinstance(target, PanelTarget)
        or target.aperture == optics.panel.lit
    ):
        return target
    return target.lit(*optics.panel.lit)


def _by_pose(
    torus: Torus,
    spectrum: Complexes64,
    kernels: Sequence[AnyComplexes],
    pose: Pose,
    used: Bools,
) -> Floats:
    """Return the derivatives by the pose: -h * (grad f . w), w(x) the motion of the target's point at x.

    kernels: transforms of h and of t h, t the place in the PSF along rows and along
    columns, in pixels. w is linear over the width of the PSF, so the result is -w . (h *
    grad f) + sum_ab dw_a/dx_b ((t_b h) * df/dx_a): exact for affine motions, and for
    perspective up to the square of blur over distance.
    """
    rows, columns = (index.astype(np.float64) for index in np.nonzero(used))
    result = np.zeros((POSE_SIZE, rows.size))
    for kernel, growth in zip(kernels, GROWTH, strict=True):
        pictures = [picture[used] for picture in torus.sample_slopes(spectrum, kernel)]
        for sign, row, column in growth:
            for motion, picture in zip(
                pose.jacobian(rows + row, columns + column), pictures, strict=True
            ):
                motion *= sign * picture
                result += motion
    return result


def blur_on(torus: Torus, optics: Optics, window_um: float, cutoff_per_um: float) -> Blur:
    """Return the blur by optics on a torus.

    window_um: least width of the PSF's window, the torus at most; cutoff_per_um: of the optics, which sets the PSF's spacing
    """
    finer = math.ceil(2 * torus.spacing_um * cutoff_per_um * (1 - 1e-9))
    spacing_um = torus.spacing_um / finer
    size = scipy.fft.next_fast_len(math.ceil(window_um / spacing_um), real=True)
    pupil = optics.pupil(spacing_um, min(size, min(torus.fine) * finer))
    return Blur(torus, pupil, optics.active_um, optics.light, optics.parts, optics.given)
