"""The plan's [[channel]]: a colour, and its light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from labkit.plan.fields import Allowed, Name, Number, Takes, one_of, or_fit, problem
from labkit.plan.table import Error, Table, refuse_larger, stated
from labkit.spectra import COLOURS, LIGHT_KINDS, TYPICAL, ChannelLight, channel_light
from labkit.uncertain import Uncertain

FILTER_WAVELENGTH = 0.005
"""Relative standard error of a colour's wavelength that a plan states without one."""

WITHIN_CHANNEL = 0.05
"""Of a channel's wavelength: as far the mean of its spectrum may lie from it."""

WIDEST_LIGHT = 0.08
"""Largest width of a spectrum, as a share of the wavelength, without samples in the plan."""

SPECTRUM = "[[nm, weight], ...] with weights from 0, some above"
ALLOWED_WAVELENGTH_NM = Allowed(100, 20_000)

Noise = Annotated[Number, AfterValidator(Allowed(1e-6, 1e5))]
NOISE_KEYS = {"gain_counts_per_e": "gain_std", "read_noise_counts": "read_noise_std"}
STATED_GAIN, STATED_READ_NOISE = 0.01, 0.02
"""Relative standard errors of a camera's noise that a plan states without one."""


def _mean_nm(stated: Mapping[str, Any]) -> float:
    """Return the mean wavelength of a channel's light by its name; nan where no light is named for one of the colours."""
    light, name = stated.get("light"), str(stated.get("name"))
    if light is None or name not in COLOURS:
        return math.nan
    mean = channel_light(light, TYPICAL, name).mean
    return round(mean.value, 1)


class Channel(Table):
    """A colour of the filter array, and the wavelength that represents this colour. One table, in double
    brackets, for each colour.
    """

    name: Name
    """Colour of the filter array: `"R"`, `"G"` or `"B"`, or a letter of `sensor.cfa_pattern`; `"G"` is both
    green planes together. The single channel of a mono sensor may have any name.
    """
    light: Annotated[str, one_of(LIGHT_KINDS)] | None = None
    """Kind of light on the target, or of the panel. The mean spectrum of typical lights of the kind, times the
    filter of {confval}`sensor.filters`, takes the place of a measured spectrum, for channels R, G and B.
    Default: not known.
    """
    wavelength_nm: Annotated[
        Number, AfterValidator(ALLOWED_WAVELENGTH_NM), Field(default_factory=_mean_nm)
    ]
    """Mean wavelength of the light times the filter. Default: none, it is required, except with `light`: then
    the mean by the tables. A stated wavelength shifts the tables' spectrum.
    """
    wavelength_std_nm: Error | None = None
    """Standard error of the wavelength. Default: 0.5 %, or 0.05 % if the photographs call all wavelengths exact; by
    the tables, the standard deviation among lights and bodies.
    """
    spectrum: Annotated[tuple[tuple[Number, Number], ...] | None, Takes(SPECTRUM)] = None
    """Spectrum of the light times the filter, if known; its mean lies within 5 % of the wavelength. Default: a
    single wavelength; `labkit fit` tests for a width.
    """

    width_nm: Annotated[
        float | Literal["fit"] | None, or_fit(0, 1000), Takes('0 to 1000, or "fit"')
    ] = None
    """Standard deviation of the light's wavelengths, in place of a spectrum: 0.42 of a Gaussian's width at half
    maximum; `"fit"` estimates it.
    """

    gain_counts_per_e: Noise | None = None
    """System gain at the session's ISO, counts per electron, as `labkit noise` measures it; a fit uses it in addition
    to the session's own flats. Default: as the flats show.
    """
    gain_std: Noise | None = None
    """Standard error of `gain_counts_per_e`. Default: 1 %."""
    read_noise_counts: Noise | None = None
    """Read noise in counts, without the rounding to whole counts, as `labkit noise` measures it. Default: as the darks
    show.
    """
    read_noise_std: Noise | None = None
    """Standard error of `read_noise_counts`. Default: 2 %."""

    @property
    def stated_gain(self) -> Uncertain | None:
        """System gain with its error; None if the plan does not state it."""
        gain = self.gain_counts_per_e
        return None if gain is None else stated(gain, self.gain_std, STATED_GAIN)

    @property
    def stated_read_noise(self) -> Uncertain | None:
        """Read noise with its error, counts; None if the plan does not state it."""
        read = self.read_noise_counts
        return (
            None if read is None else stated(read, self.read_noise_std, STATED_READ_NOISE)
        )

    @property
    def samples(self) -> tuple[list[float], list[float]]:
        """Wavelengths, nm, and weights of the spectrum. Raises ValueError where there is none."""
        if self.spectrum is None:
            raise ValueError(f"channel {self.name} has no spectrum")
        return [nm for nm, _ in self.spectrum], [weight for _, weight in self.spectrum]

    def named_light(self, filters: str | None) -> ChannelLight | None:
        """Return the light that the channel names, through a body's filters or typical ones; None where it names none."""
        if self.light is None:
            return None
        named = channel_light(self.light, filters or TYPICAL, self.name)
        return named.about(self.wavelength_nm) if self._states_wavelength else named

    @property
    def stated_wavelength(self) -> Uncertain:
        """Wavelength, with its error."""
        relative = FILTER_WAVELENGTH
        if self._by_tables:
            mean = channel_light(self.light, TYPICAL, self.name).mean
            relative = mean.std / mean.value
        return stated(self.wavelength_nm, self.wavelength_std_nm, relative, "nm")

    @property
    def may_be_exact(self) -> bool:
        """Return whether the wavelength is stated without an error: it has the usual one, or that of rounding."""
        return self.wavelength_std_nm is None and not self._by_tables

    @property
    def _by_tables(self) -> bool:
        return self.light is not None and not self._states_wavelength

    @property
    def _states_wavelength(self) -> bool:
        return "wavelength_nm" in self.model_fields_set

    @model_validator(mode="after")
    def _possible(self) -> Channel:
        self._check_light()
        refuse_larger(self, "wavelength_nm", "wavelength_std_nm")
        for name, error in NOISE_KEYS.items():
            if getattr(self, name) is not None:
                refuse_larger(self, name, error)
            elif getattr(self, error) is not None:
                raise problem(f"{error} stands without {name}: state both, or neither")
        widest_nm = WIDEST_LIGHT * self.wavelength_nm
        if self.width_nm is not None and self.spectrum is not None:
            raise problem("width_nm stands beside spectrum: allowed is one of them")
        if (
            self.width_nm is not None
            and self.width_nm != "fit"
            and self.width_nm > widest_nm
        ):
            raise problem(
                f"width_nm = {self.width_nm:g}: allowed is up to {WIDEST_LIGHT:.0%} of the wavelength, {widest_nm:.3g} nm; "
                "give a wider spectrum in samples"
            )
        if self.spectrum is not None:
            nm, weights = self.samples
            if not weights or min(weights) < 0 or not sum(weights) > 0:
                raise problem(
                    f"spectrum has no weight or one below 0: allowed is {SPECTRUM}"
                )
            mean = sum(n * w for n, w in zip(nm, weights, strict=True)) / sum(weights)
            if abs(mean / self.wavelength_nm - 1) > WITHIN_CHANNEL or min(nm) < 100:
                raise problem(
                    f"spectrum lies outside the channel: its mean is {mean:.4g} nm, wavelength_nm is {self.wavelength_nm:g}; "
                    f"allowed is a mean within {WITHIN_CHANNEL:.0%}"
                )
        return self

    def _check_light(self) -> None:
        """Raise a problem for a light that contradicts the other keys, and for a channel without light and wavelength."""
        if self.light is None:
            if math.isnan(self.wavelength_nm):
                raise problem(
                    f"wavelength_nm is missing: needs {ALLOWED_WAVELENGTH_NM}; or name the light"
                )
            return
        if self.name not in COLOURS:
            raise problem(
                f'light = "{self.light}": allowed is a light for channels R, G and B; give the spectrum of {self.name}'
            )
        for key in ("spectrum", "width_nm"):
            if getattr(self, key) is not None:
                raise problem(f"light stands beside {key}: allowed is one of them")
        mean = channel_light(self.light, TYPICAL, self.name).mean.value
        if abs(mean / self.wavelength_nm - 1) > WITHIN_CHANNEL:
            raise problem(
                f'light = "{self.light}" has its mean at {mean:.4g} nm through such a filter, wavelength_nm is '
                f"{self.wavelength_nm:g}: allowed is within {WITHIN_CHANNEL:.0%}; correct one, or leave wavelength_nm out"
            )
