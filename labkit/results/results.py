"""All estimates from a session: by range and channel, as a file, as tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from math import inf, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.errors import DataError
from labkit.findings.findings import Finding
from labkit.key import Key, same_range
from labkit.optics.field import FieldModel
from labkit.optics.lens import ThinLens
from labkit.plan import Plan
from labkit.results import storage, tables, verdicts
from labkit.results.arrays import Mapped
from labkit.results.entries import MadeFrom
from labkit.results.geometry import ImageGeometry
from labkit.results.model import CommonNumbers, Focus, Lens, PartTried, Wavefront
from labkit.results.tables import (
    ChannelSummary,
    ColourShift,
    channel_summary,
    focus_slopes,
    longitudinal_colour,
)
from labkit.spectra import ChannelLight
from labkit.uncertain import Uncertain
from labkit.version import __version__

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Results:
    """All estimates from a session.

    plan: what it was estimated with, plan_sha256 its checksum. lens: None where ranges or defocus are missing. budget: of every
    number that leads the results, its standard error by source, in the number's unit. joint: by how many standard errors each
    number moved in a climb over all frames at once, where there was one. model_parts: what was fitted of the camera, such as
    ``low_pass_filter.spread_px``; parts_tried: which parts the photographs were asked about. widest_light_nm: the largest
    standard deviation that they allow each channel's light, with 95 % confidence, where the plan states no spectrum or names a
    kind of light.
    findings: remarks on the numbers; `warnings` are the texts of warning findings.
    common: numbers of the lens with their joint covariance, for comparison with another session; None without a lens.
    unanswered: requested quantities not determined by the frames; findings say so too. made_from: inputs,
    settings and failed fits; None where an earlier labkit made the results. folder: its place. field: the wavefront over
    the frame, where there are tiles; else None. geometry: distortion and lateral colour by the places of a grid's tiles, or
    None.

    >>> results = labkit.Results.load("night-3")
    >>> print(results.focus["G"])
    3024.00 ± 0.40 mm
    """

    plan: Plan
    plan_sha256: str
    wavefronts: tuple[Wavefront, ...]
    focus: Focus | None
    lens: Lens | None = None
    budget: dict[str, dict[str, float]] = field(default_factory=dict)
    joint: dict[str, float] = field(default_factory=dict)
    model_parts: dict[str, Uncertain] = field(default_factory=dict)
    parts_tried: tuple[PartTried, ...] = ()
    widest_light_nm: dict[str, float] = field(default_factory=dict)
    common: CommonNumbers | None = None
    findings: tuple[Finding, ...] = ()
    unanswered: str | None = None
    created: str = field(
        default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds")
    )
    labkit_version: str = __version__
    made_from: MadeFrom | None = None
    folder: Path | None = None
    geometry: ImageGeometry | None = None
    field: FieldModel | None = None  # last: it hides dataclasses.field

    def __post_init__(self) -> None:
        """Tell every wavefront how broad its light may be."""
        told = tuple(
            replace(w, widest_light_nm=self.widest_light_nm.get(w.channel, 0.0))
            for w in self.wavefronts
        )
        object.__setattr__(self, "wavefronts", told)

    def __getitem__(self, place: Key | tuple[float | None, str]) -> Wavefront:
        """The wavefront of a key, or of a range (mm, or None where the frames have none) and channel.

        Raises KeyError where there is none.
        """
        key = place if isinstance(place, Key) else Key(*place)
        for wavefront in self.wavefronts:
            if wavefront.key == key:
                return wavefront
        known = ", ".join(w.key.label for w in self.wavefronts)
        raise KeyError(f"no wavefront of {key.label}: there are {known}")

    def __iter__(self) -> Iterator[Wavefront]:
        return iter(self.wavefronts)

    def __len__(self) -> int:
        return len(self.wavefronts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The texts of warning findings."""
        return tuple(finding.text for finding in self.findings if finding.warns)

    @property
    def named_lights(self) -> dict[str, ChannelLight]:
        """The light of each channel whose plan names it, by labkit's tables."""
        named = {name: self.plan.named_light(name) for name in self.channels}
        return {name: light for name, light in named.items() if light is not None}

    @property
    def reference_wavelength_nm(self) -> float:
        """Wavelength of the unit of waves."""
        return self.plan.reference_wavelength_nm

    @property
    def ranges_mm(self) -> tuple[float | None, ...]:
        """Each range once, ascending; wavefronts without a range come first."""
        ranges = {w.range_mm for w in self.wavefronts}
        return tuple(sorted(ranges, key=lambda r: -inf if r is None else r))

    @property
    def channels(self) -> tuple[str, ...]:
        """Each channel once, in the order of the wavefronts."""
        return tuple(dict.fromkeys(w.channel for w in self.wavefronts))

    def at_range(self, range_mm: float | None) -> tuple[Wavefront, ...]:
        """The wavefronts of a range."""
        return tuple(w for w in self.wavefronts if same_range(w.range_mm, range_mm))

    def of_channel(self, channel: str) -> tuple[Wavefront, ...]:
        """The wavefronts of a channel."""
        return tuple(w for w in self.wavefronts if w.channel == channel)

    def best_known(self, channel: str) -> Wavefront:
        """Return a channel's wavefront with the least variance of all modes but defocus; accepted ones first.

        Raises DataError for a channel not fitted.
        """
        return min(
            self._of(channel),
            key=lambda w: (not w.accepted, float(np.trace(w.at_focus().covariance))),
        )

    def nearest_focus(self, channel: str) -> Wavefront:
        """Return a channel's wavefront of least defocus; accepted ones first. The report shows its `best`.

        Raises DataError for a channel not fitted.
        """
        return min(self._of(channel), key=lambda w: (not w.accepted, _defocus(w)))

    def longitudinal_colour(self) -> tuple[ColourShift, ...]:
        """Best focus of each channel less that of G, in mm of range and um on the sensor; empty without two channels."""
        return longitudinal_colour(self.focus, self.lens)

    def focus_slopes(self) -> dict[str, float]:
        """Slopes of defocus by wavelength, waves RMS of Noll 4 per nm, for each channel; empty without two
        channels.

        They follow from the channels' longitudinal colour.
        """
        return focus_slopes(self.wavefronts)

    def _of(self, channel: str) -> tuple[Wavefront, ...]:
        of = self.of_channel(channel)
        if not of:
            raise DataError(
                f"the session has no wavefront of channel {channel}: it has {', '.join(self.channels)}"
            )
        return of

    @property
    def thin_lens(self) -> ThinLens:
        """The estimated lens; without an estimate as the plan states it, its pupils from best focus."""
        if self.lens is not None:
            return self.lens.thin
        stated = self.plan.lens
        pupils = 1.0 if self.focus is None else self.focus.pupil_magnification.value
        return ThinLens(
            stated.focal_length_mm, stated.f_number, pupils if pupils > 0 else 1.0
        )

    @property
    def range_zero_mm(self) -> float:
        """True ranges less stated ones, mm: 0 where no lens was estimated."""
        return 0.0 if self.lens is None else self.lens.range_zero.value

    @classmethod
    def load(
        cls, folder: Path | str, name: str = "latest", *, residuals: bool = True
    ) -> Results:
        """The results of that name in a session's folder, or those in a results folder itself.

        residuals: whether to read the residuals too, most of the files' size. Raises DataError where there are no results, or
        they cannot be read.
        """
        return cls(**storage.read(Path(folder), name, residuals=residuals))

    def write(self, folder: Path, mapped: Mapped = map) -> Path:
        """Write results.json and its arrays into a folder; returns the path of results.json. Raises InputError.

        mapped: draws the PSFs, as `map` or by several processes
        """
        return storage.write(folder, self, mapped)

    def as_json(self) -> dict[str, Any]:
        """The content of results.json."""
        return storage.entry(self)

    def at_best_focus(self) -> tuple[ChannelSummary, ...]:
        """The lens at best focus: a summary of each channel."""
        return tuple(channel_summary(self, channel) for channel in self.channels)

    @property
    def holds(self) -> bool:
        """Return whether every optimum is found and the model explains all photographs: then all numbers hold."""
        return all(w.accepted and verdicts.explained(w) for w in self.wavefronts)

    @property
    def headline(self) -> str:
        """A sentence that says which numbers hold."""
        return verdicts.headline(self.wavefronts, self.findings)

    def lens_rows(self) -> tables.Rows:
        """A heading, and a row of text for each channel: performance of the optics at best focus."""
        return tables.lens_rows(self.at_best_focus())

    def colour_rows(self) -> tables.Rows:
        """A heading, and a row of text for each channel but the reference: longitudinal colour. Empty without two channels."""
        return tables.colour_rows(self.longitudinal_colour())

    def wavefront_rows(self) -> tables.Rows:
        """A heading, and a row of text for each wavefront."""
        return tables.wavefront_rows(self.wavefronts, self.reference_wavelength_nm)

    def focus_rows(self) -> tables.Rows:
        """A heading, and rows of text for best focus and the lens."""
        return tables.focus_rows(self.focus, self.lens)

    def budget_rows(self) -> tables.Rows:
        """A heading, and a row for each number with its standard error by source."""
        return tables.budget_rows(self.budget)

    def part_rows(self) -> tables.Rows:
        """A heading, and a row for each part of the camera that the photographs were asked about; empty where none was."""
        return tables.part_rows(self.parts_tried)

    def to_dataframe(self) -> pandas.DataFrame:
        """A pandas table with a row for each coefficient. Needs the extra "pandas".

        Columns: range_mm, channel, noll, waves, std, errors_known, sign_open, twin_waves, optimum, model. Where sign_open is
        true, the coefficient may as well be twin_waves, together with those of all other modes of the wavefront. Where
        errors_known is false, std does not hold: see optimum and model.
        """
        import pandas

        return pandas.DataFrame(
            {
                "range_mm": w.range_mm,
                "channel": w.channel,
                "noll": noll,
                "waves": w[noll].value,
                "std": w[noll].std,
                "errors_known": verdicts.confirmed(w, self.wavefronts),
                "sign_open": w[noll].sign_open,
                "twin_waves": w.twin[noll].value if w.sign_open else nan,
                "optimum": verdicts.optimum_word(w.test),
                "model": verdicts.model_word(w.test),
            }
            for w in self.wavefronts
            for noll in w.noll
        )

    def summary(self) -> pandas.DataFrame:
        """A pandas table with a row for each channel: the lens at best focus. Needs the extra "pandas".

        Columns: channel, wavelength_nm, range_mm of the wavefront nearest to focus; strehl, rms_nm, rms_waves at the channel's
        own wavelength, mtf50_x_per_mm, mtf50_y_per_mm, all without defocus; best_focus_mm; colour_mm and colour_um, which are
        best focus less that of G, by range and on the sensor; each with its standard error, such as strehl_std; optimum, model.
        """
        import pandas

        return pandas.DataFrame(one.as_row() for one in self.at_best_focus())

    def _repr_html_(self) -> str:
        title = f"{self.folder or 'Results'}: {len(self)} wavefronts"
        shown = (
            self.lens_rows(),
            self.colour_rows(),
            self.focus_rows(),
            self.wavefront_rows(),
        )
        notes = [finding.text for finding in self.findings]
        return tables.as_html(title, self.headline, shown, notes)


def _defocus(wavefront: Wavefront) -> float:
    return abs(wavefront.defocus.value) if wavefront.defocus else 0.0
