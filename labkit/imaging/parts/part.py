"""What the parts of a camera have in common: a transfer function of a few numbers that multiplies lens and pixel's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol, Self

from labkit.types import AnyFloats


class Part(Protocol):
    """A part whose numbers are such that all is regular where they are 0 and the part does nothing: variances, not widths.

    labels: of its numbers, which may be below 0 on the way to an estimate; usual: standard deviations of
    them among cameras, far beyond what a frame leaves open.
    """

    labels: ClassVar[tuple[str, ...]]
    usual: ClassVar[tuple[float, ...]]

    @property
    def name(self) -> str:
        """In results."""
        ...

    @property
    def values(self) -> tuple[float, ...]:
        """Its numbers, one for each label."""
        ...

    def at(self, values: Sequence[float]) -> Self:
        """The same part of other numbers."""
        ...

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        """The transfer function at frequencies along rows (m, 1) and along columns (1, n), cycles a pixel: (m, n), in
        their precision."""
        ...

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        """Its derivatives (m, n) by each of its numbers."""
        ...
