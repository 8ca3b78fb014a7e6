"""A lens over time: its best focus and modes in every session of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from labkit.catalogue.entry import Entry
from labkit.errors import DataError
from labkit.uncertain import Uncertain

MOST_NAMED_LENSES = 20
"""Number of lenses in a message."""


@dataclass(frozen=True, slots=True)
class History:
    """A lens's sessions in the order of their time, in one channel.

    Attributes
    ----------
    lens : the lens with its serial number
    channel : name of the channel
    entries : the sessions
    left_out : sessions that cannot be read, whichever lens they are of
    """

    lens: str
    channel: str
    entries: tuple[Entry, ...]
    left_out: tuple[Entry, ...] = ()

    def number(self, entry: Entry, quantity: str) -> Uncertain | None:
        """Return a session's number, such as `best_focus_mm` or `waves.7`; None if it has none."""
        return entry.numbers.get((quantity, self.channel))

    @property
    def modes(self) -> tuple[int, ...]:
        """Noll's modes that any session has, the lowest first."""
        quantities = {
            quantity
            for entry in self.entries
            for quantity, channel in entry.numbers
            if channel == self.channel and quantity.startswith("waves.")
        }
        return tuple(sorted(int(quantity.split(".")[1]) for quantity in quantities))

    def as_json(self) -> dict[str, Any]:
        """Return the history for programs."""
        sessions = [
            {
                **{
                    key: getattr(entry, key)
                    for key in ("folder", "taken", "camera", "state")
                },
                **{
                    quantity: number.as_json()
                    for (quantity, channel), number in entry.numbers.items()
                    if channel in ("", self.channel)
                },
            }
            for entry in self.entries
        ]
        return {
            "schema": 1,
            "lens": self.lens,
            "channel": self.channel,
            "sessions": sessions,
            "left_out": {entry.folder: entry.problem for entry in self.left_out},
        }


def history_of(
    entries: Sequence[Entry], lens: str, channel: str | None = None, name: str = "latest"
) -> History:
    """Select a lens's sessions.

    Parameters
    ----------
    entries : of the catalogue
    lens : name, serial number, or a part of both together
    channel : name of the channel; None for green, or the first
    name : of the results

    Returns
    -------
    The sessions that have numbers in this channel

    Raises
    ------
    DataError
        no lens, or more than one, is called so, or none of its sessions has this channel
    """
    fitted = [entry for entry in entries if entry.name == name and entry.numbers]
    every = list(dict.fromkeys(e.lens_label for e in fitted if e.lens_label))
    named = [label for label in every if lens.lower() in label.lower()]
    exact = [e.lens_label for e in fitted if lens in (e.lens_label, e.lens, e.serial)]
    if len(found := list(dict.fromkeys(exact)) or named) != 1:
        known = ", ".join((found or every)[:MOST_NAMED_LENSES]) or "none"
        words = "several lenses are" if found else "no lens with results is"
        raise DataError(
            f"--lens {lens}: {words} called so; give one of: {known} (lens.name and lens.serial in the plan)"
        )
    own = [entry for entry in fitted if entry.lens_label == found[0]]
    channels = list(dict.fromkeys(c for entry in own for c in entry.channels))
    chosen = channel or ("G" if "G" in channels else channels[0])
    if chosen not in channels:
        raise DataError(
            f"--channel {chosen}: sessions of {found[0]} have {', '.join(channels)}"
        )
    of = [entry for entry in own if chosen in entry.channels]
    return History(found[0], chosen, tuple(sorted(of, key=lambda entry: entry.taken)))
