"""The inputs of results: they say whether results are up to date, and how to make them again."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan
from typing import Annotated, Any

from pydantic import Field

from labkit.results.kept import Entry, Name, Noll, Number, Range, Text, table


@dataclass(frozen=True)
class MadeFrom:
    """Inputs of a fit beside the plan, and what came of them.

    Attributes
    ----------
    frames_sha256 : of the names, kinds, ranges and checksums of the session's photographs
    numerics_sha256 : of the source of labkit's numerics
    own_plan : whether the plan is the session's own
    ranges_mm, channels, noll : as `labkit.fit` has them
    patience_s : processor time of one search; inf without a limit
    joint, split, plain : as `labkit.fit` has them
    failed : for each fit that failed, a sentence with the reason
    failed_accepted : whether the user accepts the results without those fits
    """

    frames_sha256: str
    numerics_sha256: str
    own_plan: bool = True
    ranges_mm: tuple[float, ...] | None = None
    channels: tuple[str, ...] | None = None
    noll: tuple[int, int] | None = None
    patience_s: float = inf
    joint: bool = False
    split: bool = False
    plain: bool = False
    failed: tuple[str, ...] = ()
    failed_accepted: bool = False

    def __post_init__(self) -> None:
        if isnan(self.patience_s):  # as a file states no limit
            object.__setattr__(self, "patience_s", inf)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings to make the results again, by the names that `labkit.fit` gives them; without the plan."""
        names = ("ranges_mm", "channels", "noll", "patience_s", "joint", "split", "plain")
        return {name: getattr(self, name) for name in names}


class MadeFromEntry(Entry):
    """The entry of what results were made from."""

    frames_sha256: Text
    numerics_sha256: Text
    own_plan: bool = True
    ranges_mm: tuple[Range, ...] | None = None
    channels: tuple[Name, ...] | None = None
    noll: tuple[Noll, Noll] | None = None
    patience_s: Number = inf
    joint: bool = False
    split: bool = False
    plain: bool = False
    failed: Annotated[tuple[Text, ...], Field(max_length=10_000)] = ()
    failed_accepted: bool = False


RecordOfInputs = Annotated[MadeFrom, table(MadeFromEntry, MadeFrom)]
