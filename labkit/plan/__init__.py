"""The plan of a session: a TOML file, checked before anything happens."""

from labkit.plan.channel import Channel
from labkit.plan.field_tables import FieldSettings, Limits, Mount
from labkit.plan.plan import Plan, leading_channel
from labkit.plan.sensor import MeasuredTone, Sensor
from labkit.plan.table import Table
from labkit.plan.tables import (
    About,
    CameraSettings,
    DisplaySettings,
    FitSettings,
    Lens,
    NoiseSettings,
    RailSettings,
    TargetPixels,
    TargetSpec,
)

__all__ = [
    "About",
    "CameraSettings",
    "Channel",
    "DisplaySettings",
    "FieldSettings",
    "FitSettings",
    "Lens",
    "Limits",
    "MeasuredTone",
    "Mount",
    "NoiseSettings",
    "Plan",
    "RailSettings",
    "Sensor",
    "Table",
    "TargetPixels",
    "TargetSpec",
    "leading_channel",
]
