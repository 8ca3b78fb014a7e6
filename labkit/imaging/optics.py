"""Lens, light, sensor and panel as a forward model uses them, and their numbers that fits estimate."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from labkit.arrays import positive
from labkit.imaging.estimated import Estimated
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts import KNOWN, Part, SpectrumWidth, rim_of
from labkit.imaging.warp import Pose
from labkit.imaging.window import window_for
from labkit.optics.psf import Pupil
from labkit.optics.rim import Place, Rim
from labkit.optics.spectrum import Spectrum
from labkit.plan.mode_groups import MODE_GROUPS, USUAL_NOLL
from labkit.types import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Known properties of lens, light and sensor for one channel.

    Parameters
    ----------
    wavelength_nm : of the light
    reference_nm : wavelength of the unit of wavefronts
    f_number : working f-number, by the full pupil's clear area
    pitch_um : of the pixels, whatever their colours
    active_um : width of a pixel's active square
    noll : modes of the wavefront
    spectrum : of the light, relative to its wavelength; None if unknown
    typical : whether the spectrum is typical of a kind of light; photographs may contradict
        its width
    place : of a tile in the frame; None for frames without tiles
    parts : parts of the camera, to be estimated
    given : parts of the camera with known numbers
    panel : the lit part of a panel's pixels, to be estimated; None for other targets, and
        if known

    Raises
    ------
    ValueError
        For a length or an f-number that is not above 0.

    >>> labkit.Optics(wavelength_nm=550.0, reference_nm=550.0, f_number=2.8, pitch_um=4.78, active_um=4.78)
    """

    wavelength_nm: float
    reference_nm: float
    f_number: float
    pitch_um: float
    active_um: float
    noll: tuple[int, ...] = tuple(range(4, 16))
    spectrum: Spectrum | None = None
    typical: bool = False
    place: Place | None = None
    parts: tuple[Part, ...] = ()
    given: tuple[Part, ...] = ()
    panel: Aperture | None = None

    def __post_init__(self) -> None:
        for name in ("wavelength_nm", "reference_nm", "pitch_um", "active_um"):
            positive(name, getattr(self, name), name[-2:])
        positive("f_number", self.f_number, "unitless")

    def pupil(self, spacing_um: float, size: int) -> Pupil:
        """Return the pupil whose PSF has (size, size) samples of a spacing, um."""
        return Pupil(
            self.wavelength_um,
            self.reference_um,
            self.f_number,
            spacing_um,
            size,
            self.noll,
            self.rim,
        )

    @property
    def wavelength_um(self) -> float:
        """Wavelength, um."""
        return 1e-3 * self.wavelength_nm

    @property
    def reference_um(self) -> float:
        """Reference wavelength, um."""
        return 1e-3 * self.reference_nm

    @property
    def airy_um(self) -> float:
        """lambda N, the unit of length of diffraction."""
        return self.wavelength_um * self.f_number

    @property
    def rim(self) -> Rim:
        """Rim of the pupil."""
        return rim_of((*self.given, *self.parts))

    @property
    def light(self) -> Spectrum:
        """Spectrum of the light: a part's, if a part has one, else `spectrum`, else a single wavelength."""
        of_parts = (part.light for part in (*self.parts, *self.given))
        return next(
            (light for light in (*of_parts, self.spectrum) if light is not None), Spectrum()
        )

    @property
    def shortest(self) -> float:
        """Shortest wavelength of the light, relative, as broad as an estimate may make the spectrum."""
        broadest = (part.broadest for part in self.parts)
        return min(
            min(light.nodes) for light in (self.light, *broadest) if light is not None
        )

    def in_one_wavelength(self) -> Optics:
        """Return the same optics in light of the nominal wavelength alone."""
        parts = tuple(part for part in self.parts if part.light is None)
        given = tuple(part for part in self.given if part.light is None)
        return replace(self, spectrum=None, parts=parts, given=given)

    @property
    def estimated(self) -> tuple[Estimated, ...]:
        """Groups of the numbers in `camera_parameters`, in their order: parts, panel."""
        return self.parts if self.panel is None else (*self.parts, self.panel)

    @property
    def camera_parameters(self) -> Floats:
        """(n,) numbers that may be estimated with the wavefront: of the parts, of the panel, ln N."""
        return np.array(
            [*chain(*(group.values for group in self.estimated)), math.log(self.f_number)]
        )

    @property
    def camera_labels(self) -> tuple[str, ...]:
        """Names of the numbers before ln N, each as GROUP.NUMBER."""
        return tuple(
            f"{group.name}.{label}" for group in self.estimated for label in group.labels
        )

    @property
    def camera_stds(self) -> Floats:
        """(n,) standard deviations of the camera parameters among cameras: wide priors."""
        return np.array([*chain(*(group.usual for group in self.estimated)), 1.0])

    def with_camera_parameters(self, values: Floats) -> Optics:
        """Return the same optics with other camera parameters (n,)."""
        numbers = iter(map(float, values))
        parts = tuple(part.at([next(numbers) for _ in part.labels]) for part in self.parts)
        panel = self.panel and self.panel.at([next(numbers) for _ in self.panel.labels])
        return replace(self, parts=parts, panel=panel, f_number=math.exp(next(numbers)))

    @property
    def beyond_usual(self) -> bool:
        """Return whether there are camera parts, or modes beyond the usual ones."""
        return bool(self.parts) or max(self.noll, default=0) > USUAL_NOLL[1]

    @property
    def lacking(self) -> list[str]:
        """Names of known parts that these optics may have but lack, the commonest first."""
        every = (*self.parts, *self.given)
        have = {part.name for part in every}
        kinds = {part.kind for part in every if part.kind}
        if self.spectrum is not None and not self.typical:
            have.add(SpectrumWidth.name)
        return [
            part.name
            for part in self._known
            if part.name not in have and part.kind not in kinds and part.sought
        ]

    @property
    def _known(self) -> Iterator[Part]:
        """Known parts, for this light and this place."""
        typical = self.spectrum if self.typical and self.spectrum else Spectrum()
        return (part.about(typical, self.place) for part in KNOWN.values())

    def with_parts(self, names: Collection[str]) -> Optics:
        """Return the optics with further known parts, which do nothing yet, and with further groups of modes."""
        parts = (part for part in self._known if part.name in names)
        modes = (group.noll for name, group in MODE_GROUPS.items() if name in names)
        return replace(
            self,
            parts=(*self.parts, *parts),
            noll=(*self.noll, *chain.from_iterable(modes)),
        )

    def starts(self, before: Sequence[Part] = ()) -> list[Optics]:
        """Return the optics with idle parts at their start values, for every combination of these.

        before: parts of the previous fit
        """
        parts = (part.starts(before) if part.idle else (part,) for part in self.parts)
        return [replace(self, parts=choice) for choice in product(*parts)]

    def begun(self) -> Optics:
        """Return the optics with idle parts at their start values, before any fit."""
        return self.starts()[0]

    def twin(self) -> Optics:
        """Return the optics of the twin, whose pupil is turned by 180 degrees (thesis §3.6)."""
        return replace(self, parts=tuple(part.twin for part in self.parts))

    def with_named(self, labels: Sequence[str], values: Floats) -> Optics:
        """Return the same optics with given camera parameters, by label, the last of them ln N. Others stay as they are."""
        known = dict(zip((*labels, "ln N"), values, strict=True))
        own = zip((*self.camera_labels, "ln N"), self.camera_parameters, strict=True)
        return self.with_camera_parameters(
            np.array([known.get(label, value) for label, value in own])
        )

    def with_rim_of(self, other: Optics) -> Optics:
        """Return the same optics with the rim of other optics that have the same parts."""
        rims = {part.name: part.values for part in other.parts if part.of_rim}
        parts = (part.at(rims.get(part.name, part.values)) for part in self.parts)
        return replace(self, parts=tuple(parts))

    def without(self, names: Collection[str]) -> Optics:
        """Return the optics without some estimated parts."""
        return replace(
            self, parts=tuple(part for part in self.parts if part.name not in names)
        )

    @property
    def shared(self) -> tuple[Part, ...]:
        """Estimated parts common to all channels of a camera."""
        return tuple(part for part in self.parts if not part.per_channel)

    def tilted(self, pose: Pose, tilts: Floats) -> Pose:
        """Return the pose whose picture without some tilts is that of a pose with them.

        tilts: (2,) Noll's modes 2 and 3 at the reference wavelength
        """
        # such a tilt has a slope of 2 over the radius, which moves light by twice the f-number
        columns, rows = 4 * tilts * self.reference_um * self.f_number / self.pitch_um
        return pose.shifted(-rows, -columns)

    def window_airy(self, waves: Floats) -> float:
        """Return the width of the window, lambda N, that a wavefront's PSF needs.

        waves: (modes,) RMS at the reference wavelength
        """
        return window_for(
            self.noll, waves * (self.reference_um / self.wavelength_um), self.rim.longest
        )
