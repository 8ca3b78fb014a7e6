"""The wavefront over the field in results.json; its covariance is an array in a file of its own."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from labkit.optics.field import FieldFrame, FieldModel
from labkit.optics.rim import ROUND, ROUND_EVERYWHERE, FieldRim, Vignetting
from labkit.results.agreement import WRITTEN_ROUNDING
from labkit.results.entries import KeptRim
from labkit.results.geometry import Distortion, ImageGeometry, LateralColour
from labkit.results.kept import (
    Entry,
    Finite,
    FNumber,
    Kept,
    Name,
    Nanometres,
    Noll,
    NumberEntry,
    PositiveEntry,
    Size,
    StdNumber,
    array,
    table,
    uncertain,
)
from labkit.results.model import refuse_no_covariance
from labkit.types import Floats
from labkit.uncertain import Uncertain


class TermEntry(Entry):
    """A coefficient of the double Zernike expansion."""

    field: Noll
    pupil: Noll
    channel: Name
    waves: NumberEntry


class PairEntry(Entry):
    """Two numbers, along the rows' and the columns' direction, with their covariance."""

    value: Annotated[Floats, array(tuple[Finite, Finite])]
    covariance: Annotated[
        Floats, array(tuple[tuple[Finite, Finite], tuple[Finite, Finite]])
    ]

    @model_validator(mode="after")
    def _checked(self) -> Self:
        refuse_no_covariance("the covariance of two numbers", self.covariance)
        return self


class DistortionEntry(Entry):
    """Radial distortion."""

    k1_per_mm2: Annotated[Uncertain, uncertain("/mm²")]
    k2_per_mm4: Annotated[Uncertain, uncertain("/mm⁴")] | None = None
    centre_px: PairEntry | None = None
    residual_px: Finite


def _distortion(entry: DistortionEntry) -> Distortion:
    centre = entry.centre_px
    place = None if centre is None else (centre.value, centre.covariance)
    return entry.made(Distortion, centre_px=place)


class LateralColourEntry(Entry):
    """The image of a channel against the reference channel's."""

    scale: Annotated[Uncertain, uncertain()]
    shift_um: PairEntry


def _lateral(entry: LateralColourEntry) -> LateralColour:
    shift = entry.shift_um
    return LateralColour(entry.scale, shift.value, shift.covariance)


class VignettingEntry(Entry):
    """A circle that cuts the pupil off the middle of the frame."""

    along: Annotated[Finite, Field(ge=-5, le=5)] = Field(alias="shift")
    right: Annotated[Finite, Field(ge=-5, le=5)] = 0.0
    down: Annotated[Finite, Field(ge=-5, le=5)] = 0.0
    size: Annotated[Finite, Field(gt=0, le=10)] = Field(alias="radius")


class FieldPupilEntry(Entry):
    """The rim of the pupil over the frame."""

    middle: KeptRim = ROUND
    vignetting: Annotated[Vignetting, table(VignettingEntry, Vignetting)] | None = None
    uneven: tuple[Finite, Finite] = (0.0, 0.0)


class FieldEntry(Entry):
    """The wavefront over the field, and where the lens puts the image."""

    photograph_px: tuple[Size, Size]
    f_number: FNumber
    f_number_std: StdNumber
    wavelengths_nm: Annotated[dict[Name, Nanometres], Field(min_length=1)]
    lambda_n_um: dict[Name, Annotated[Uncertain, uncertain("um", PositiveEntry)]] | None = (
        None
    )
    rim: Annotated[FieldRim, table(FieldPupilEntry, FieldRim)] | None = Field(
        default=None, alias="pupil"
    )
    terms: Annotated[tuple[TermEntry, ...], Field(min_length=1, max_length=100_000)]
    sensor_tilt_um_per_mm: PairEntry | None = None
    curvature_per_mm: NumberEntry | None = None
    distortion: (
        Annotated[Distortion, Kept(DistortionEntry, _distortion, Distortion.as_json)] | None
    ) = None
    lateral_colour: (
        dict[
            Name,
            Annotated[
                LateralColour, Kept(LateralColourEntry, _lateral, LateralColour.as_json)
            ],
        ]
        | None
    ) = None

    @property
    def geometry(self) -> ImageGeometry | None:
        """Distortion and lateral colour; None where the tiles were no grid of equal targets."""
        if self.distortion is None:
            return None
        return ImageGeometry(self.distortion, self.lateral_colour or {})

    @classmethod
    def of_model(
        cls, field: FieldModel, geometry: ImageGeometry | None = None
    ) -> FieldEntry:
        """Return the entry of a field."""
        std = np.sqrt(np.diag(field.covariance)).reshape(field.waves.shape)
        names = product(field.channels, field.field, field.noll)
        terms = [
            TermEntry(
                field=k, pupil=j, channel=channel, waves=NumberEntry(value=value, std=error)
            )
            for (channel, k, j), value, error in zip(
                names, field.waves.ravel().tolist(), std.ravel().tolist(), strict=True
            )
        ]
        # few tiles determine a mean and a tilt alone, or the mean
        tilt = curvature = None
        if {2, 3} <= set(field.field):
            value, covariance = field.sensor_tilt
            tilt = PairEntry.of(None, value=value, covariance=covariance)
        if 4 in field.field:
            curvature = NumberEntry(**field.curvature.as_json())
        return cls.of(
            None,
            photograph_px=field.frame.shape_px,
            f_number=field.f_number,
            f_number_std=field.f_number_std,
            wavelengths_nm=dict(zip(field.channels, field.wavelengths_nm, strict=True)),
            lambda_n_um=_lambda_n(field),
            rim=None if field.rim == ROUND_EVERYWHERE else field.rim,
            terms=tuple(terms),
            sensor_tilt_um_per_mm=tilt,
            curvature_per_mm=curvature,
            distortion=None if geometry is None else geometry.distortion,
            lateral_colour=None if geometry is None else geometry.lateral_colour,
        )

    def model(self, covariance: Floats, pitch_um: float, reference_nm: float) -> FieldModel:
        """Return the field. Raises ValueError where terms are missing, or arrays have other shapes.

        Parameters
        ----------
        covariance : of all coefficients, in the order of the terms
        pitch_um : pitch of the raw's pixels
        reference_nm : wavelength of the unit of waves
        """
        channels = tuple(self.wavelengths_nm)
        field = tuple(dict.fromkeys(term.field for term in self.terms))
        noll = tuple(dict.fromkeys(term.pupil for term in self.terms))
        names = [(term.channel, term.field, term.pupil) for term in self.terms]
        if names != list(product(channels, field, noll)):
            raise ValueError(
                "field.terms are not of every channel, field and pupil in turn"
            )
        lambda_n = self.lambda_n_um or {}
        if lambda_n and set(lambda_n) != set(channels):
            raise ValueError("field.lambda_n_um is not of every channel")
        waves = np.array([term.waves.value for term in self.terms], float)
        std = np.array([term.waves.std for term in self.terms], float)
        refuse_no_covariance("the covariance of field.terms", covariance)
        if not np.array_equal(covariance.shape, (std.size, std.size)) or not np.allclose(
            std**2, np.diag(covariance), rtol=WRITTEN_ROUNDING, atol=0
        ):
            raise ValueError("field.terms have other standard errors than their covariance")
        return FieldModel(
            FieldFrame(self.photograph_px, pitch_um),
            channels,
            field,
            noll,
            waves.reshape(len(channels), len(field), len(noll)),
            covariance,
            tuple(self.wavelengths_nm.values()),
            reference_nm,
            self.f_number,
            self.f_number_std,
            tuple(lambda_n[c].std / lambda_n[c].value for c in channels if lambda_n),
            self.rim or ROUND_EVERYWHERE,
        )


def _lambda_n(field: FieldModel) -> dict[str, Uncertain] | None:
    """Return lambda N of each channel; None for a field that has no errors of it."""
    if not field.scale_std:
        return None
    values = [1e-3 * nm * field.f_number for nm in field.wavelengths_nm]
    return {
        channel: Uncertain(value, value * std, "um")
        for channel, value, std in zip(field.channels, values, field.scale_std, strict=True)
    }
