"""Spectra of typical lights and of cameras' colour filters, by name."""

from labkit.spectra.channel_light import LIGHT_KINDS, ChannelLight, channel_light
from labkit.spectra.tables import TYPICAL, Tables, body_of, tables

__all__ = [
    "LIGHT_KINDS",
    "TYPICAL",
    "ChannelLight",
    "Tables",
    "body_of",
    "channel_light",
    "tables",
]
