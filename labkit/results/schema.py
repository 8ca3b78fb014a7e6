"""results.json as it is read: what each key must hold, in schemas 1 to 3, and the objects that are made of it.

A file that was altered ends in one line that names the key. Bounds are those of the plan where it has them, or far beyond
any lens: no number in a file makes a report or a restoration take the machine's memory.
"""

from __future__ import annotations

from math import nan, radians
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from labkit.errors import LONGEST, shown
from labkit.finding import NOTE, Finding
from labkit.key import Key
from labkit.optics.rim import ROUND, Circle, Cut, Diaphragm, Rim
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.results.model import (
    Focus,
    Lens,
    OptimumTest,
    OtherOptimum,
    PartTried,
    Placement,
    ResidualSpectrum,
    Wavefront,
)
from labkit.types import Floats
from labkit.uncertain import Uncertain

FIRST_WITH_FINDINGS = 3

LENS = {
    "focal_length_mm": ("focal_length", "mm"),
    "f_number": ("f_number", ""),
    "pupil_magnification": ("pupil_magnification", ""),
    "range_zero_mm": ("range_zero", "mm"),
}
"""Keys of the lens, the fields that they hold, and their units."""

UNITS = {"px": "px", "px2": "px²", "nm": "nm", "deg": "deg"}
"""Of numbers of the camera, by the end of their names."""

MOST_WAVES = 1e3
"""RMS, of any mode."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Maybe = Finite | None
"""null stands for what is not finite, or not known."""

Std = Annotated[Finite, Field(ge=0)] | None
Waves = Annotated[Finite, Field(ge=-MOST_WAVES, le=MOST_WAVES)]
Nanometres = Annotated[Finite, Field(ge=10, le=100_000)]
Noll = Annotated[int, Field(ge=1, le=10_000)]
Range = Annotated[Finite, Field(gt=0, le=1e7)]
FNumber = Annotated[Finite, Field(ge=0.1, le=1e4)]
Place = Annotated[int, Field(ge=-(2**20), le=2**20)]
Size = Annotated[int, Field(ge=1, le=2**16)]
Text = Annotated[str, Field(max_length=10_000)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Pose = Annotated[tuple[Maybe, ...], Field(min_length=8, max_length=8)]
Corners = Annotated[tuple[tuple[Maybe, Maybe], ...], Field(min_length=4, max_length=4)]


class Entry(BaseModel):
    """A table of results.json. Keys that are not known, of a later labkit, are left out."""

    model_config = ConfigDict(strict=True, frozen=True)


class NumberEntry(Entry):
    """A number with its standard error."""

    value: Maybe
    std: Std

    def uncertain(self, unit: str = "") -> Uncertain:
        """Return the number."""
        return Uncertain(_number(self.value), _number(self.std), unit)


class PositiveEntry(NumberEntry):
    """A number above 0."""

    value: Annotated[Finite, Field(gt=0)]


class WhereEntry(Entry):
    """The identity of a wavefront, or of all of a channel, or of the session."""

    range_mm: Range | None
    channel: Name | None
    tile: tuple[Place, Place] | None = None

    @property
    def key(self) -> Key | None:
        """The identity; None for the session."""
        return None if self.channel is None else Key(self.range_mm, self.channel, self.tile)


class FindingEntry(Entry):
    """A finding."""

    code: Name
    where: WhereEntry
    numbers: dict[str, Any]
    text: Text


class OtherEntry(Entry):
    """Another optimum."""

    waves_rms: tuple[Waves | None, ...]
    log_likelihood_below: Maybe


class OptimumEntry(Entry):
    """The test of the optimum."""

    name: Text = ""
    accepted: bool
    p_value: Maybe = None
    starts: int | None = None
    undetermined: tuple[Text, ...] = ()
    others: tuple[OtherEntry, ...] = ()


class ResidualSpectrumEntry(Entry):
    """What is left of the data, by frequency."""

    cycles_per_px: tuple[Finite, ...]
    power: tuple[Maybe, ...]
    power_without_parts: tuple[Maybe, ...] | None = None

    def spectrum(self) -> ResidualSpectrum:
        """Return the spectrum. Raises ValueError for parts of different lengths."""
        without = self.power_without_parts
        columns = [self.cycles_per_px, self.power, without or self.power]
        if len({len(column) for column in columns}) != 1:
            raise ValueError("residual_spectrum has columns of different lengths")
        return ResidualSpectrum(
            _numbers(self.cycles_per_px),
            _numbers(self.power),
            None if without is None else _numbers(without),
        )


class ModelEntry(Entry):
    """Whether the model explains the data."""

    accepted: bool
    missing: tuple[Name, ...] = ()
    residual_spectrum: ResidualSpectrumEntry | None = None


class BladesEntry(Entry):
    """A diaphragm."""

    blades: Annotated[int, Field(ge=3, le=20)]
    turn_deg: Finite
    roundness: Annotated[Finite, Field(ge=0, le=1)]


class CircleEntry(Entry):
    """A circle that cuts the pupil."""

    shift: Annotated[Finite, Field(ge=0, le=5)]
    radius: Annotated[Finite, Field(gt=0, le=10)]
    direction_deg: Finite


class PupilEntry(Entry):
    """The rim of a pupil that is no clear disc."""

    cuts: Annotated[tuple[BladesEntry | CircleEntry, ...], Field(max_length=5)] = ()
    uneven: Annotated[tuple[Finite, ...], Field(max_length=4)] = ()
    obstructed: Annotated[Finite, Field(ge=-0.9, le=0.9)] = 0.0

    @property
    def rim(self) -> Rim:
        """The rim. Raises ValueError where it is no closed curve."""
        if sum(map(abs, self.uneven)) >= 1:
            raise ValueError(f"uneven = {self.uneven}: the rim is no closed curve")
        cuts = list[Cut]()
        for cut in self.cuts:
            if isinstance(cut, BladesEntry):
                cuts.append(Diaphragm(cut.blades, radians(cut.turn_deg), cut.roundness))
            elif cut.shift >= cut.radius:
                raise ValueError(f"a circle {cut.shift:g} off, of radius {cut.radius:g}")
            else:
                cuts.append(Circle(cut.shift, cut.radius, radians(cut.direction_deg)))
        return Rim(tuple(cuts), self.uneven, self.obstructed)


class WavefrontEntry(Entry):
    """A wavefront. Before schema 3 its identity is its range and channel."""

    key: WhereEntry | None = None
    range_mm: Range | None
    channel: Name
    measured_range_mm: Range | None = None
    wavelength_nm: Nanometres
    spectrum: (
        Annotated[tuple[tuple[Nanometres, Finite], ...], Field(min_length=1, max_length=99)]
        | None
    ) = None
    pupil: PupilEntry | None = None
    f_number: FNumber | None = None
    f_number_working: NumberEntry | None = None
    blur_um: NumberEntry | None = None
    noll: Annotated[tuple[Noll, ...], Field(max_length=1000)]
    waves_rms: tuple[Waves, ...]
    sign_open: bool = False
    std: tuple[Std, ...]
    covariance: tuple[tuple[Maybe, ...], ...] | None = None
    pose: Pose | None = None
    poses: Annotated[tuple[Pose, ...], Field(min_length=1)] | None = None
    gain: Maybe = None
    read_noise: Maybe = None
    chi2_per_pixel: Maybe = None
    global_test: OptimumEntry | None = None
    model: ModelEntry | None = None
    seconds: Maybe = None
    frames: tuple[Text, ...] = ()
    origin_px: tuple[Place, Place] = (0, 0)
    shape_px: tuple[Size, Size] | None = None
    corners_px: Annotated[tuple[Corners, ...], Field(min_length=1)] | None = None

    @property
    def identity(self) -> Key:
        """The wavefront's key. Raises ValueError for one that is of no channel."""
        key = Key(self.range_mm, self.channel) if self.key is None else self.key.key
        if key is None:
            raise ValueError("a wavefront's key has no channel")
        return key

    def wavefront(self, plan: Plan) -> Wavefront:
        """Return the wavefront, without its residuals. Raises ValueError."""
        key, test, model = self.identity, self.global_test, self.model
        f_number = self.f_number or plan.lens.f_number
        lines = self.spectrum or ((self.wavelength_nm, 1.0),)
        left = None if model is None else model.residual_spectrum
        return Wavefront(
            range_mm=key.range_mm,
            measured_range_mm=key.range_mm
            if "measured_range_mm" not in self.model_fields_set
            else self.measured_range_mm,
            channel=key.channel,
            tile=key.tile,
            wavelength_nm=self.wavelength_nm,
            reference_wavelength_nm=plan.reference_wavelength_nm,
            f_number=f_number,
            f_number_std=nan
            if self.f_number_working is None
            else _number(self.f_number_working.std),
            blur=None if self.blur_um is None else self.blur_um.uncertain("um"),
            noll=self.noll,
            waves=_numbers(self.waves_rms),
            sign_open=self.sign_open,
            covariance=self._covariance(),
            poses=self._poses(),
            gain=_number(self.gain),
            read_noise=_number(self.read_noise),
            chi2_per_pixel=_number(self.chi2_per_pixel),
            test=None if test is None else _test(test, test if model is None else model),
            seconds=_number(self.seconds),
            frames=self.frames,
            missing=() if model is None else model.missing,
            spectrum=Spectrum.of_lines(lines, self.wavelength_nm),
            rim=ROUND if self.pupil is None else self.pupil.rim,
            residual_spectrum=None if left is None else left.spectrum(),
            placement=self._placement(),
        )

    def _poses(self) -> Floats:
        """Return (frames, 8) poses; before schema 3 there may be only that of the first photograph."""
        poses = self.poses or (() if self.pose is None else (self.pose,))
        if not poses:
            raise ValueError(f"{self.identity.label} has no pose")
        return _numbers(poses)

    def _covariance(self) -> Floats:
        """Return the covariance; of results without one, that of independent errors."""
        return (
            np.diag(_numbers(self.std) ** 2)
            if self.covariance is None
            else _numbers(self.covariance)
        )

    def _placement(self) -> Placement | None:
        if self.corners_px is None or self.shape_px is None:
            return None
        return Placement(self.origin_px, self.shape_px, _numbers(self.corners_px))


class MagnificationEntry(NumberEntry):
    """The pupil magnification, and whether the ranges determine it."""

    identifiable: bool = True


class FocusEntry(Entry):
    """Best focus."""

    best_focus_mm: Annotated[dict[Name, NumberEntry], Field(min_length=1)]
    pupil_magnification: MagnificationEntry
    residual_waves: dict[Name, tuple[Maybe, ...]] = {}
    residual_std_waves: dict[Name, tuple[Std, ...]] = {}
    covariance: tuple[tuple[Maybe, ...], ...] | None = None
    chi2_per_freedom: Maybe = None

    def focus(self) -> Focus:
        """Return best focus."""
        return Focus(
            best_focus_mm={
                channel: best.uncertain("mm")
                for channel, best in self.best_focus_mm.items()
            },
            pupil_magnification=self.pupil_magnification.uncertain(),
            identifiable=self.pupil_magnification.identifiable,
            residual_waves={
                channel: tuple(map(_number, rest))
                for channel, rest in self.residual_waves.items()
            },
            residual_std_waves={
                channel: tuple(map(_number, std))
                for channel, std in self.residual_std_waves.items()
            },
            covariance=None if self.covariance is None else _numbers(self.covariance),
            chi2_per_freedom=self.chi2_per_freedom,
        )


class LensEntry(Entry):
    """The lens that all fits have in common."""

    focal_length_mm: PositiveEntry
    f_number: PositiveEntry
    pupil_magnification: PositiveEntry
    range_zero_mm: NumberEntry

    def lens(self) -> Lens:
        """Return the lens."""
        return Lens(
            **{
                field: getattr(self, name).uncertain(unit)
                for name, (field, unit) in LENS.items()
            }
        )


class PartTriedEntry(Entry):
    """A part of the camera that the photographs were asked about."""

    part: Name
    gain: Maybe
    adopted: bool


class Content(Entry):
    """The whole of results.json."""

    model_config = ConfigDict(protected_namespaces=())  # a key is called model_parts

    schema_: int = Field(alias="schema")
    labkit_version: Text
    created: Text
    plan_sha256: Text
    plan: Any = None
    wavefronts: tuple[WavefrontEntry, ...]
    focus: FocusEntry | None
    lens: LensEntry | None = None
    budget: dict[Name, dict[Name, Finite]] = {}
    joint: dict[Name, Finite] = {}
    model_parts: dict[Name, NumberEntry] = {}
    parts_tried: tuple[PartTriedEntry, ...] = ()
    widest_light_nm: dict[Name, Finite] = {}
    findings: tuple[FindingEntry, ...] | None = None
    warnings: tuple[Text, ...]
    unanswered: Text | None = None

    @classmethod
    def of(cls, content: str) -> Content:
        """Read the text of a file. Raises ValueError that names the first key that is not as it must be."""
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            where = ".".join(str(step)[:LONGEST] for step in first["loc"])
            held = first["input"] if first["type"] != "missing" else None
            found = "" if held is None or isinstance(held, dict) else f" = {shown(held)}"
            raise ValueError(f"{where}{found}: {first['msg']}") from None

    def fields(self, plan: Plan) -> dict[str, Any]:
        """Return the fields of results, but for their plan, folder and residuals. Raises ValueError."""
        return {
            "plan_sha256": self.plan_sha256,
            "wavefronts": tuple(w.wavefront(plan) for w in self.wavefronts),
            "focus": None if self.focus is None else self.focus.focus(),
            "lens": None if self.lens is None else self.lens.lens(),
            "budget": self.budget,
            "joint": self.joint,
            "model_parts": {
                name: number.uncertain(UNITS.get(name.rpartition("_")[2], ""))
                for name, number in self.model_parts.items()
            },
            "parts_tried": tuple(
                PartTried(one.part, _number(one.gain), one.adopted)
                for one in self.parts_tried
            ),
            "widest_light_nm": self.widest_light_nm,
            "findings": self._findings(),
            "unanswered": self.unanswered,
            "created": self.created,
            "labkit_version": self.labkit_version,
        }

    def _findings(self) -> tuple[Finding, ...]:
        """Return all findings; of results before schema 3, which had none, their warnings."""
        if self.schema_ < FIRST_WITH_FINDINGS:
            return tuple(Finding(NOTE, None, {}, text) for text in self.warnings)
        if self.findings is None:
            raise ValueError("findings are missing")
        return tuple(
            Finding(
                one.code, one.where.key, one.numbers, one.text, one.text in self.warnings
            )
            for one in self.findings
        )


def _test(test: OptimumEntry, model: OptimumEntry | ModelEntry) -> OptimumTest:
    """Return the test of the optimum. model: what says whether the model explains the data."""
    others = (
        OtherOptimum(_numbers(one.waves_rms), _number(one.log_likelihood_below))
        for one in test.others
    )
    return OptimumTest(
        name=test.name,
        accepted=test.accepted,
        p_value=_number(test.p_value),
        starts=test.starts,
        undetermined=test.undetermined,
        others=tuple(others),
        explains=model.accepted,
    )


def _number(value: float | None) -> float:
    return nan if value is None else value


def _numbers(values: Any) -> Floats:
    """Return an array; nan for None. Raises ValueError for rows of different lengths."""
    return np.array(values, dtype=float)
