"""Measure a camera's noise by photon transfer: read the session's series, and write the numbers with their page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from math import log2, log10
from pathlib import Path
from typing import Any

from labkit.errors import DataError
from labkit.noise.emva import ChannelNoise, camera_model
from labkit.noise.levels import Level, read_series
from labkit.session.session import Session
from labkit.storage.files import refuse_links, write_atomically, writing
from labkit.types import Progress, no_progress
from labkit.uncertain import Uncertain
from labkit.version import __version__

NOISE_SCHEMA = 1

QUANTITIES = {
    "gain_counts_per_e": ("system gain K", "counts/e⁻"),
    "read_noise_counts": ("read noise", "counts"),
    "read_noise_e": ("read noise (temporal dark noise)", "e⁻"),
    "saturation_e": ("saturation capacity", "e⁻"),
    "dynamic_range": ("dynamic range", ""),
    "snr_max": ("largest signal-to-noise ratio", ""),
    "threshold_e": ("absolute sensitivity threshold", "e⁻"),
    "linearity_error_percent": ("linearity error", "%"),
    "prnu_percent": ("PRNU", "%"),
    "prnu_whole_percent": ("PRNU with slow changes", "%"),
    "dsnu_e": ("DSNU", "e⁻"),
    "dsnu_whole_e": ("DSNU with slow changes", "e⁻"),
    "dark_current_e_per_s": ("dark current, from means", "e⁻/s"),
    "dark_current_from_noise_e_per_s": ("dark current, from variances", "e⁻/s"),
    "quantum_efficiency_percent": ("quantum efficiency", "%"),
    "threshold_photons": ("absolute sensitivity threshold", "photons"),
    "saturation_photons": ("saturation capacity", "photons"),
}
"""Names of the numbers in words, with their units."""


@dataclass(frozen=True, slots=True)
class Noise:
    """A camera's noise in each channel, as `labkit.measure_noise` returns it.

    channels: by name; each holds the numbers of `QUANTITIES` as attributes. iso: of the
    frames, None if they differ or do not state it.
    """

    channels: Mapping[str, ChannelNoise]
    iso: int | None

    def __getitem__(self, channel: str) -> ChannelNoise:
        return self.channels[channel]

    def rows(self) -> list[list[str]]:
        """Return the table that the command prints: a column for each channel."""
        heading = ["quantity", "unit", *self.channels]
        return [heading, *(self._row(name) for name in self._determined())]

    def _row(self, name: str) -> list[str]:
        words, unit = QUANTITIES[name]
        numbers = [getattr(noise, name) for noise in self.channels.values()]
        return [
            words,
            unit,
            *(f"{number}{_in_decibels(name, number)}" for number in numbers),
        ]

    def _determined(self) -> list[str]:
        """Return the quantities that at least one channel determines, and saturation."""
        return [
            name
            for name in QUANTITIES
            if name == "saturation_e"
            or any(
                getattr(n, name).value == getattr(n, name).value
                for n in self.channels.values()
            )
        ]

    def notes(self) -> list[str]:
        """Return remarks on what the series does not determine, each once."""
        notes = [note for noise in self.channels.values() for note in noise.notes]
        return list(dict.fromkeys(notes))

    def to_toml(self) -> str:
        """Return gain and read noise as a plan states them, in its [[channel]] tables."""
        where = "" if self.iso is None else f"  # at ISO {self.iso}"
        return "\n".join(
            line
            for name, noise in self.channels.items()
            for line in (
                f'# [[channel]] name = "{name}"{where}',
                f"gain_counts_per_e = {noise.gain_counts_per_e.value:.6g}",
                f"gain_std = {noise.gain_counts_per_e.std:.2g}",
                f"read_noise_counts = {noise.read_noise_counts.value:.6g}",
                f"read_noise_std = {noise.read_noise_counts.std:.2g}",
            )
        )

    def as_json(self) -> dict[str, Any]:
        """Return everything as noise.json has it; numbers that are not determined are null."""
        return {
            "schema": NOISE_SCHEMA,
            "labkit_version": __version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "iso": self.iso,
            "channels": {name: _entry(noise) for name, noise in self.channels.items()},
            "notes": self.notes(),
        }

    def write(self, session: Session | Path | str) -> Path:
        """Write noise.json and noise.html to SESSION/results, each whole; return the page's path.

        Raises InputError where the folder cannot be written to, SessionError for links in it.
        """
        from labkit.noise.page import page  # matplotlib takes a second to load

        opened = session if isinstance(session, Session) else Session.open(session)
        folder = opened.results_folder("noise").parent
        html = page(self, opened.folder.name)
        with writing(folder):
            folder.mkdir(exist_ok=True)
        refuse_links(folder)
        content = json.dumps(self.as_json(), indent=1, allow_nan=False)
        write_atomically(folder / "noise.json", content.encode())
        write_atomically(folder / "noise.html", html.encode(errors="replace"))
        return folder / "noise.html"


def measure_noise(session: Session | Path | str, progress: Progress = no_progress) -> Noise:
    """Measure gain, read noise, saturation and non-uniformity of a camera by photon transfer.

    By EMVA Standard 1288, Release 4.0 Linear, with a standard error for each number.

    Parameters
    ----------
    session : with two or more flats, and darks, at each of five or more exposure times
        (or levels of light), best captured by a plan with a [noise] table
    progress : called with each step

    Returns
    -------
    `Noise`: for each channel `gain_counts_per_e` (K), `read_noise_e` and
    `read_noise_counts` (without the rounding), `saturation_e`, `linearity_error_percent`,
    `prnu_percent`, `dsnu_e`, `dark_current_e_per_s` and others, `Uncertain`; nan where the
    series does not determine a number

    Raises
    ------
    DataError
        levels or pairs are missing, all flats are clipped, the light changed, or darks
        differ in temperature
    RawError, SessionError, PlanError
        as their names say

    Notes
    -----
    Slow changes over more than 11 pixels of a colour count as uneven light, not as
    non-uniformity; numbers "with slow changes" contain them. DSNU and PRNU are of all
    pixels, as the standard has it; all other numbers leave hot pixels out. Quantum
    efficiency, and thresholds in photons, need a column `photons` in the imported list.

    >>> noise = labkit.measure_noise("flats")
    >>> print(noise["G"].gain_counts_per_e)
    """
    opened = session if isinstance(session, Session) else Session.open(session)
    plan = opened.plan
    names = [channel.name for channel in plan.channel]
    series = read_series(opened.frames, plan.sensor, names, progress)
    channels = {}
    for name in names:
        try:
            channels[name] = camera_model(series[name])
        except DataError as error:
            where = f", channel {name}" if len(names) > 1 else ""
            raise DataError(f"{opened.folder}{where}: {error}") from error
    isos = {frame.meta.get("iso") for frame in opened.frames}
    iso = isos.pop() if len(isos) == 1 else None
    return Noise(channels, iso)


def _in_decibels(name: str, number: Uncertain) -> str:
    """Return a ratio in dB and bits as the standard also states it."""
    if name not in ("dynamic_range", "snr_max") or not number.value > 0:
        return ""
    return f" ({20 * log10(number.value):.1f} dB, {log2(number.value):.1f} bit)"


def _entry(noise: ChannelNoise) -> dict[str, Any]:
    series = noise.series
    return {
        **{name: getattr(noise, name).as_json() for name in QUANTITIES},
        "flats": [
            _level(flat) | {"deviation_percent": float(deviation)}
            for flat, deviation in zip(series.flats, noise.deviations_percent, strict=True)
        ],
        "darks": [_level(dark) for dark in series.darks],
    }


def _level(level: Level) -> dict[str, Any]:
    return {
        "exposure_s": level.exposure_s,
        "photons": level.photons,
        "frames": len(level.means),
        "pixels": level.pixels,
        "signal_counts": {"value": level.signal, "std": level.signal_std},
        "variance_counts2": {"value": level.variance, "std": level.variance_std},
        "clipped": level.clipped,
    }
