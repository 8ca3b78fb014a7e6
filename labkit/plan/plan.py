"""The plan as a whole: made from a file or in Python, checked at once, written as TOML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from labkit.errors import PlanError
from labkit.plan.channel import Channel
from labkit.plan.field_tables import FieldSettings, Limits, Mount
from labkit.plan.fields import Takes, joined, problem, repeated
from labkit.plan.sensor import Sensor
from labkit.plan.table import Table
from labkit.plan.tables import (
    About,
    CameraSettings,
    DisplaySettings,
    FitSettings,
    Lens,
    NoiseSettings,
    RailSettings,
    TargetSpec,
)
from labkit.plan.text import plain, read_tables, read_text, write_tables
from labkit.spectra import ChannelLight

DEFAULT_REFERENCE_NM = 450.0

CAMERA_COLOURS = ("R", "G", "B")
"""LibRaw's names of a camera's filter colours."""

LEADING = "G"
"""Green: a filter array has most pixels of it, and photometry's weight is greatest."""

COLOUR_WORDS = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"}
"""Names, in small letters, that cannot be meant for anything else."""


def leading_channel(names: Sequence[str]) -> str:
    """Return the channel that represents all others: green, or the first."""
    return LEADING if LEADING in names else names[0]


class Plan(Table):
    """The facts of a session that the photographs do not state.

    `load`, `parse` and `from_tables` make a plan, `replace` changes a copy. All raise
    PlanError, one line naming every wrong field.

    >>> plan = labkit.Plan.load("plan.toml").replace(fit={"zernike_noll": (4, 22)})
    """

    lens: Lens
    sensor: Sensor
    channel: Annotated[
        tuple[Channel, ...], Field(min_length=1), Takes("one or more [[channel]] tables")
    ]
    target: TargetSpec
    fit: FitSettings = FitSettings()
    field: FieldSettings = FieldSettings()
    limits: Limits = Limits()
    mount: Mount = Mount()
    about: About = About()
    camera: CameraSettings | None = None
    rail: RailSettings | None = None
    noise: NoiseSettings | None = None
    display: DisplaySettings | None = None

    @classmethod
    def load(cls, path: Path | str) -> Plan:
        """Load the plan in a TOML file.

        Raises
        ------
        PlanError
            the file is missing or holds no plan
        """
        path = Path(path)
        try:
            return cls.parse(read_text(path), path.parent)
        except PlanError as error:
            raise PlanError(f"plan {path}: {error}") from error

    @classmethod
    def parse(cls, text: str, folder: Path | str = ".") -> Plan:
        """Parse a plan in TOML; a target's file is relative to `folder`.

        Raises
        ------
        PlanError
            the text holds no plan
        """
        return cls.from_tables(read_tables(text), folder)

    def replace(self, **tables: Any) -> Plan:
        """Return a copy with some tables changed, checked like a file.

        A dict changes its table, key by key; None removes a key, or a whole table. A list
        of channels replaces the list: ``plan.replace(fit={"zernike_noll": (4, 22)},
        channel=[{"name": "G", "wavelength_nm": 550}])``.

        Raises
        ------
        PlanError
            the changed plan is wrong
        """
        changed = self._tables()
        for name, given in tables.items():
            kept = changed.get(name)
            changed[name] = (
                {**kept, **given}
                if isinstance(kept, dict) and isinstance(given, Mapping)
                else given
            )
        return type(self).from_tables(changed)

    def to_toml(self) -> str:
        """Return the plan as TOML, without defaults; `parse` reads an equal plan."""
        return write_tables(plain(self._tables()))

    def _tables(self) -> dict[str, Any]:
        return self.model_dump(exclude_unset=True)

    @property
    def reference_wavelength_nm(self) -> float:
        """Wavelength of the unit "waves": as [fit] states; else 450 nm, or the wavelength of a single channel."""
        if self.fit.reference_wavelength_nm is not None:
            return self.fit.reference_wavelength_nm
        return (
            self.channel[0].wavelength_nm
            if len(self.channel) == 1
            else DEFAULT_REFERENCE_NM
        )

    @property
    def capture_camera(self) -> CameraSettings | None:
        """The camera's settings for a capture; None where the plan states no more than its body."""
        return self.camera if self.camera is not None and self.camera.captures else None

    def named_light(self, channel: str) -> ChannelLight | None:
        """The light of a channel by its name and by the sensor's filters; None where the plan names none."""
        of = next((one for one in self.channel if one.name == channel), None)
        return None if of is None else of.named_light(self.sensor.filters)

    @model_validator(mode="after")
    def _consistent(self) -> Plan:
        problems = [
            *self._channel_problems(),
            *self._range_problems(),
            *self._tile_problems(),
        ]
        if problems:
            raise problem(joined(problems))
        return self

    def _channel_problems(self) -> Iterator[str]:
        names = [channel.name for channel in self.channel]
        pattern = self.sensor.cfa_pattern
        for name in repeated(names):
            yield f'channel.name = "{name}" stands twice: allowed is each name once'
        if pattern == "mono":
            if len(names) > 1:
                yield f'{len(names)} [[channel]] tables: allowed is exactly one for cfa_pattern = "mono"'
            return
        # files that state their own filter array may be mono, whose one channel has any name
        alone = pattern is None and len(names) == 1
        colours: tuple[str, ...] = CAMERA_COLOURS
        words = "R, G or B; the one channel of a mono sensor has any name"
        if pattern is not None:
            colours = tuple(pattern)
            words = f'a colour of cfa_pattern = "{pattern}"'
        for name in names:
            if name not in colours and (name.lower() in COLOUR_WORDS or not alone):
                meant = COLOUR_WORDS.get(name.lower())
                yield f'channel.name = "{name}": allowed is {words}' + (
                    f"; did you mean {meant}?" if meant else ""
                )

    def _range_problems(self) -> Iterator[str]:
        focal_mm = self.lens.focal_length_mm
        for range_mm in self.rail.ranges_mm if self.rail else ():
            if range_mm <= focal_mm:
                yield f"rail.ranges_mm has {range_mm:g} mm: allowed is more than the focal length, {focal_mm:g} mm"

    def _tile_problems(self) -> Iterator[str]:
        if not self.target.of_many:
            return
        if self.field.pitch_px is not None:
            yield "field.pitch_px: target.grid makes the tiles, leave out field.pitch_px"
        if self.field.tiles not in (None, self.target.grid):
            yield (
                f"field.tiles = {list(self.field.tiles or ())}: target.grid = {list(self.target.grid or ())} makes the tiles, "
                "leave out field.tiles"
            )
