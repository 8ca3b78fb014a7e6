"""results.json: one definition of what each key holds, by which files are checked, read and written.

A field is named as the attribute that it keeps; its alias is the key in the file, and its type says how the value is kept.
Files of schema 1 to 3 are read, and 3 is written. An altered file ends in a line with the key's name. Bounds are
those of the plan where it has them, or far beyond any lens: no number in a file makes a report or a restoration take the
machine's memory.
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import nan
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from labkit.errors import LONGEST_VALUE, shown
from labkit.findings.findings import NOTE, Finding
from labkit.key import Key
from labkit.optics.rim import ROUND
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.results.agreement import refuse_disagreement
from labkit.results.entries import Common, KeptRim, LensEntry, RecordOfInputs
from labkit.results.field_entry import FieldEntry
from labkit.results.kept import (
    Corners,
    Entry,
    Finite,
    FNumber,
    Kept,
    KnownStd,
    Matrix,
    Maybe,
    Millimetres,
    Name,
    Nanometres,
    Noll,
    Number,
    NumberEntry,
    Place,
    Pose,
    PositiveEntry,
    PositiveNumber,
    Powers,
    Probability,
    Range,
    Size,
    Std,
    StdNumber,
    Tenths,
    Text,
    Thousandths,
    Waves,
    array,
    listed,
    null,
    number,
    table,
    uncertain,
)
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
from labkit.results.verdicts import confirmed
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results

SCHEMA = 3
READABLE = (1, 2, 3)
FIRST_WITH_FINDINGS = 3

MOST_OTHERS = 5
"""Number of other optima in results, the likeliest first."""

QUANTITY_UNITS = {"px": "px", "px2": "px²", "nm": "nm", "deg": "deg"}
"""Units of the camera's numbers, by the end of their names."""


class WhereEntry(Entry):
    """The identity of a wavefront, or of all of a channel, or of the session."""

    range_mm: Range | None
    channel: Name | None
    tile: tuple[Place, Place] | None = None

    @property
    def key(self) -> Key | None:
        """The identity; None for the session."""
        return None if self.channel is None else Key(self.range_mm, self.channel, self.tile)


def _where(key: Key | None) -> dict[str, Any]:
    no_channel = {"range_mm": None, "channel": None, "tile": None}
    return no_channel if key is None else key.as_json()


Where = Annotated[Key | None, Kept(WhereEntry, lambda entry: entry.key, _where)]


class FindingEntry(Entry):
    """A finding."""

    code: Name
    key: Where = Field(alias="where")
    numbers: dict[str, Any]
    text: Text


class OtherEntry(Entry):
    """Another optimum."""

    waves: Annotated[Floats, array(tuple[Waves | None, ...])] = Field(alias="waves_rms")
    log_likelihood_below: Tenths


Other = Annotated[OtherOptimum, table(OtherEntry, OtherOptimum)]


class TestEntry(Entry):
    """The test of the optimum."""

    name: Text = ""
    p_value: Probability = nan
    accepted: bool
    undetermined: tuple[Text, ...] = ()
    starts: int | None = None
    others: tuple[Other, ...] = ()


class OptimumEntry(Entry):
    """The test of the optimum in short, which is not read."""

    accepted: Any = None
    p_value: Any = None
    others: Any = None


class ResidualSpectrumEntry(Entry):
    """Residuals by frequency."""

    cycles_per_px: Annotated[Floats, array(tuple[Finite, ...])]
    power: Powers
    without_parts: Powers | None = Field(default=None, alias="power_without_parts")


def _residual_spectrum(entry: ResidualSpectrumEntry) -> ResidualSpectrum:
    """Return the spectrum. Raises ValueError for columns of different lengths."""
    columns = (entry.cycles_per_px, entry.power, entry.without_parts)
    if len({column.size for column in columns if column is not None}) != 1:
        raise ValueError("residual_spectrum has columns of different lengths")
    return entry.made(ResidualSpectrum)


class ModelEntry(Entry):
    """Verdict on the model: whether it explains the data."""

    accepted: bool
    p_value: Probability = nan
    missing: tuple[Name, ...] = ()
    residual_spectrum: (
        Annotated[
            ResidualSpectrum,
            Kept(
                ResidualSpectrumEntry,
                _residual_spectrum,
                lambda left: ResidualSpectrumEntry.of(left).written(),
            ),
        ]
        | None
    ) = None


class WavefrontEntry(Entry):
    """A wavefront. Before schema 3 its identity is its range and channel."""

    key: Where = None
    range_mm: Range | None
    measured_range_mm: Range | None = None
    channel: Name
    wavelength_nm: Nanometres
    spectrum: (
        Annotated[tuple[tuple[Nanometres, Finite], ...], Field(min_length=1, max_length=99)]
        | None
    ) = None
    rim: KeptRim | None = Field(default=None, alias="pupil")
    f_number: FNumber | None = None
    working_f_number: Annotated[Uncertain, uncertain("", PositiveEntry)] | None = Field(
        default=None, alias="f_number_working"
    )
    lambda_n: Annotated[Uncertain, uncertain("um", PositiveEntry)] | None = Field(
        default=None, alias="lambda_n_um"
    )
    blur: Annotated[Uncertain, uncertain("um")] | None = Field(
        default=None, alias="blur_um"
    )
    noll: Annotated[tuple[Noll, ...], Field(max_length=1000)]
    waves: Annotated[Floats, array(tuple[Waves, ...])] = Field(alias="waves_rms")
    sign_open: bool = False
    twin_waves: Any = Field(default=None, alias="twin_waves_rms")
    std: Annotated[Floats, array(tuple[Std, ...])]
    errors_known: bool = True
    covariance: Matrix | None = None
    pose: Annotated[Floats, array(Pose)] | None = None
    poses: (
        Annotated[Floats, array(Annotated[tuple[Pose, ...], Field(min_length=1)])] | None
    ) = None
    gain: PositiveNumber = nan
    read_noise: StdNumber = nan
    chi2_per_pixel: StdNumber = nan
    test: Annotated[OptimumTest, table(TestEntry, OptimumTest)] | None = Field(
        default=None, alias="global_test"
    )
    optimum: OptimumEntry | None = None
    model: ModelEntry | None = None
    seconds: Thousandths = nan
    frames: tuple[Text, ...] = ()
    origin_px: tuple[Place, Place] = (0, 0)
    shape_px: tuple[Size, Size] | None = None
    tile: Any = None
    pulls: Annotated[Floats, array(tuple[Maybe, ...], 3)] | None = None
    centre_px: Any = None
    corners_px: (
        Annotated[Floats, array(Annotated[tuple[Corners, ...], Field(min_length=1)])] | None
    ) = None

    @property
    def identity(self) -> Key:
        """The wavefront's key. Raises ValueError for an entry without a channel."""
        if "key" not in self.model_fields_set:
            return Key(self.range_mm, self.channel)
        if self.key is None:
            raise ValueError("a wavefront's key has no channel")
        return self.key

    @classmethod
    def of_wavefront(cls, w: Wavefront, results: Results) -> WavefrontEntry:
        """Return the entry of a wavefront of some results."""
        return cls.of(
            w,
            spectrum=None
            if w.spectrum == Spectrum()
            else tuple(map(tuple, w.spectrum.lines(w.wavelength_nm))),
            rim=None if w.rim.is_round else w.rim,
            twin_waves=listed(w.twin.waves) if w.sign_open else None,
            errors_known=confirmed(w, results.wavefronts),
            pose=w.poses[0],
            test=w.test and replace(w.test, others=w.test.others[:MOST_OTHERS]),
            **_place(w),
            **_verdicts(w),
            **({} if w.placement is None else _attributes(w.placement)),
        )

    def wavefront(self, plan: Plan) -> Wavefront:
        """Return the wavefront, without its residuals. Raises ValueError."""
        key, model, working = self.identity, self.model, self.working_f_number
        measured_mm = self.measured_range_mm
        if "measured_range_mm" not in self.model_fields_set:
            measured_mm = key.range_mm
        lines = self.spectrum or ((self.wavelength_nm, 1.0),)
        return self.made(
            Wavefront,
            range_mm=key.range_mm,
            measured_range_mm=measured_mm,
            channel=key.channel,
            tile=key.tile,
            reference_wavelength_nm=plan.reference_wavelength_nm,
            f_number=self.f_number or plan.lens.f_number,
            f_number_std=nan if working is None else working.std,
            covariance=np.diag(self.std**2) if self.covariance is None else self.covariance,
            poses=self._poses(),
            test=self._test(),
            missing=() if model is None else model.missing,
            spectrum=Spectrum.of_lines(lines, self.wavelength_nm),
            rim=self.rim or ROUND,
            residual_spectrum=None if model is None else model.residual_spectrum,
            placement=None if self.shape_px is None else self._placement(self.shape_px),
        )

    def _poses(self) -> Floats:
        """Return (frames, 8) poses; before schema 3 there may be only that of the first photograph."""
        if self.poses is not None:
            return self.poses
        if self.pose is None:
            raise ValueError(f"{self.identity.label} has no pose")
        return self.pose[np.newaxis]

    def _test(self) -> OptimumTest | None:
        """Return the test; before schema 2 it is that of the model too."""
        if self.test is None:
            return None
        explains = self.test.accepted if self.model is None else self.model.accepted
        return replace(self.test, explains=explains)

    def _placement(self, shape_px: tuple[int, int]) -> Placement | None:
        if self.corners_px is None:
            return None
        return Placement(self.origin_px, shape_px, self.corners_px)


def _place(w: Wavefront) -> dict[str, Any]:
    """Return the entries that say where a tile is in the frame; none of wavefronts of the whole frame."""
    if w.tile is None or w.placement is None:
        return {}
    return {"centre_px": w.placement.centre_px}


def _attributes(placement: Placement) -> dict[str, Any]:
    return {field.name: getattr(placement, field.name) for field in fields(placement)}


def _verdicts(w: Wavefront) -> dict[str, Any]:
    """Return the entries that say whether the optimum is found, and whether the model explains the photographs."""
    if w.test is None:
        return {"optimum": None, "model": None}
    p_value, left = w.test.p_value, w.residual_spectrum
    optimum = OptimumEntry(
        accepted=w.test.accepted, p_value=null(p_value), others=len(w.test.others)
    )
    model = {"accepted": w.test.explains, "p_value": p_value, "missing": w.missing}
    model |= {} if left is None else {"residual_spectrum": left}
    return {"optimum": optimum, "model": ModelEntry.model_construct(None, **model)}


class MagnificationEntry(NumberEntry):
    """The pupil magnification, and whether the ranges determine it."""

    identifiable: bool = True


class FocusEntry(Entry):
    """Best focus."""

    best_focus_mm: Annotated[dict[Name, Millimetres], Field(min_length=1)]
    pupil_magnification: MagnificationEntry
    residual_waves: dict[Name, tuple[Number, ...]] = Field(default_factory=dict)
    residual_std_waves: dict[Name, tuple[StdNumber, ...]] = Field(default_factory=dict)
    covariance: Matrix | None = None
    chi2_per_freedom: Maybe = None


def _focus(entry: FocusEntry) -> Focus:
    pupils = entry.pupil_magnification
    return entry.made(
        Focus,
        pupil_magnification=Uncertain(number(pupils.value), number(pupils.std)),
        identifiable=pupils.identifiable,
    )


def _focus_entry(focus: Focus) -> dict[str, Any]:
    pupils = MagnificationEntry(
        **focus.pupil_magnification.as_json(), identifiable=focus.identifiable
    )
    return FocusEntry.of(focus, pupil_magnification=pupils).written()


def _field_entry(results: Results) -> FieldEntry | None:
    field = results.field
    return None if field is None else FieldEntry.of_model(field, results.geometry)


class PartTriedEntry(Entry):
    """A tested part of the camera."""

    name: Name = Field(alias="part")
    gain: Tenths
    adopted: bool


class LightEntry(Entry):
    """The light of a channel by its name."""

    light: Text = Field(alias="name")
    filters: Text
    mean: Annotated[Uncertain, uncertain("", PositiveEntry)] = Field(alias="mean_nm")
    width: Annotated[Uncertain, uncertain()] = Field(alias="width_nm")


class Content(Entry):
    """The whole of results.json."""

    schema_: int = Field(alias="schema")
    labkit_version: Text
    created: Text
    plan_sha256: Text
    plan: Any = None
    convention: Any = None
    reference_wavelength_nm: Nanometres | None = None
    wavefronts: tuple[WavefrontEntry, ...]
    focus: Annotated[Focus, Kept(FocusEntry, _focus, _focus_entry)] | None
    lens: LensEntry | None = None
    field: FieldEntry | None = None
    budget: dict[Name, dict[Name, KnownStd]] = Field(default_factory=dict)
    joint: dict[Name, Finite] = Field(default_factory=dict)
    model_parts: dict[Name, Annotated[Uncertain, uncertain()]] = Field(default_factory=dict)
    parts_tried: tuple[Annotated[PartTried, table(PartTriedEntry, PartTried)], ...] = ()
    common: Common | None = None
    light: dict[Name, LightEntry] = Field(default_factory=dict)
    widest_light_nm: dict[Name, Tenths] = Field(default_factory=dict)
    focus_waves_per_nm: dict[Name, Finite] = Field(default_factory=dict)
    findings: tuple[FindingEntry, ...] | None = None
    warnings: tuple[Text, ...]
    unanswered: Text | None = None
    made_from: RecordOfInputs | None = None

    @classmethod
    def parse(cls, content: str) -> Content:
        """Read the text of a file. Raises ValueError naming the first key that is not as it must be."""
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            where = ".".join(str(step)[:LONGEST_VALUE] for step in first["loc"])
            held = first["input"] if first["type"] != "missing" else None
            found = "" if held is None or isinstance(held, dict) else f" = {shown(held)}"
            raise ValueError(f"{where}{found}: {first['msg']}") from None

    @classmethod
    def of_results(cls, results: Results) -> Content:
        """Return the content of results."""
        plan, lens = results.plan, results.lens
        return cls.of(
            results,
            schema_=SCHEMA,
            plan=plan.model_dump(mode="json", exclude_none=True),
            convention=plan.fit.convention,
            wavefronts=tuple(WavefrontEntry.of_wavefront(w, results) for w in results),
            lens=None if lens is None else LensEntry.of_results(results, lens),
            field=_field_entry(results),
            light={name: LightEntry.of(of) for name, of in results.named_lights.items()},
            focus_waves_per_nm=results.focus_slopes(),
            findings=tuple(map(FindingEntry.of, results.findings)),
        )

    def fields(self, plan: Plan) -> dict[str, Any]:
        """Return the fields of results, but for their plan, folder and residuals. Raises ValueError."""
        refuse_disagreement(self, plan)
        same = (
            *("plan_sha256", "focus", "budget", "joint", "parts_tried", "widest_light_nm"),
            *("common", "unanswered", "created", "labkit_version", "made_from"),
        )
        return {name: getattr(self, name) for name in same} | {
            "wavefronts": tuple(entry.wavefront(plan) for entry in self.wavefronts),
            "lens": None if self.lens is None else self.lens.made(Lens),
            "model_parts": {
                name: replace(number, unit=QUANTITY_UNITS.get(name.rpartition("_")[2], ""))
                for name, number in self.model_parts.items()
            },
            "findings": self._findings(),
            "geometry": None if self.field is None else self.field.geometry,
        }

    def _findings(self) -> tuple[Finding, ...]:
        """Return all findings; of results before schema 3, which had none, their warnings."""
        if self.schema_ < FIRST_WITH_FINDINGS:
            return tuple(Finding(NOTE, None, {}, text) for text in self.warnings)
        if self.findings is None:
            raise ValueError("findings are missing")
        return tuple(
            entry.made(Finding, warns=entry.text in self.warnings)
            for entry in self.findings
        )
