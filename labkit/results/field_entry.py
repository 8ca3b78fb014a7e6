"""The wavefront over the field in results.json; its covariance is an array in a file of its own."""

from __future__ import annotations

from itertools import product
from typing import Annotated

import numpy as np
from pydantic import Field

from labkit.optics.field import FieldFrame, FieldModel
from labkit.results.kept import (
    Entry,
    Finite,
    FNumber,
    Name,
    Nanometres,
    Noll,
    NumberEntry,
    Size,
    StdNumber,
    array,
)
from labkit.types import Floats


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


class FieldEntry(Entry):
    """The wavefront over the field."""

    photograph_px: tuple[Size, Size]
    f_number: FNumber
    f_number_std: StdNumber
    wavelengths_nm: Annotated[dict[Name, Nanometres], Field(min_length=1)]
    terms: Annotated[tuple[TermEntry, ...], Field(min_length=1, max_length=100_000)]
    sensor_tilt_um_per_mm: PairEntry | None = None
    curvature_per_mm: NumberEntry | None = None

    @classmethod
    def of_model(cls, field: FieldModel) -> FieldEntry:
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
        return cls(
            photograph_px=field.frame.shape_px,
            f_number=field.f_number,
            f_number_std=field.f_number_std,
            wavelengths_nm=dict(zip(field.channels, field.wavelengths_nm, strict=True)),
            terms=tuple(terms),
            sensor_tilt_um_per_mm=tilt,
            curvature_per_mm=curvature,
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
        waves = np.array([term.waves.value for term in self.terms], float)
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
        )
