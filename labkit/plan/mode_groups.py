"""Groups of Zernike modes beyond the usual ones, which a session adds to its model where photographs show them."""

from __future__ import annotations

from dataclasses import dataclass

USUAL_NOLL = (4, 15)
"""First and last mode of every session: defocus, and radial orders 2 to 4."""
MOST_NOLL = 37
"""Last mode that a session adds, unless its plan says otherwise."""


@dataclass(frozen=True, slots=True)
class ModeGroup:
    """Zernike modes that join a model together: a radial order, or a part of one.

    Parameters
    ----------
    first, last : Noll's numbers of the first and the last mode
    """

    first: int
    last: int

    @property
    def name(self) -> str:
        """Key in results."""
        return f"modes_{self.first}_{self.last}"

    @property
    def noll(self) -> tuple[int, ...]:
        """The modes, by Noll's numbers."""
        return tuple(range(self.first, self.last + 1))

    @property
    def title(self) -> str:
        """Name for a table."""
        if self.first == self.last:
            return f"Zernike mode {self.first}"
        return f"Zernike modes {self.first} to {self.last}"

    @property
    def words(self) -> str:
        """Name for a sentence."""
        return self.title


MODE_GROUPS: dict[str, ModeGroup] = {
    group.name: group
    for group in (
        ModeGroup(16, 21),
        ModeGroup(22, 28),
        ModeGroup(29, 36),
        ModeGroup(37, 37),
        ModeGroup(38, 45),
    )
}
"""Radial orders 5, 6 and 7, and of order 8 first the spherical mode, by name, the lowest first."""
