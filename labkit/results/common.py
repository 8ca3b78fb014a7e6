"""Numbers of the lens that all ranges of a session have in common, with their joint covariance.

Another session of the lens must agree with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from labkit.results.model import refuse_no_covariance
from labkit.types import Floats

FOCAL_LENGTH_MM = "focal_length_mm"
F_NUMBER_AT_INFINITY = "f_number"
LN_MAGNIFICATION = "ln_pupil_magnification"
BEST_FOCUS_MM = "best_focus_mm"
COLOUR_UM = "colour_um"
MODE_WAVES = "waves"
"""Names of numbers. `waves.G.7`: Noll mode 7 of G; `colour_um.R`: focal length of R less that of the leading channel;
`best_focus_mm.G`: that of the leading channel."""


@dataclass(frozen=True, slots=True, eq=False)
class StatedNumber:
    """A number that was known before the session, and its part in the errors.

    value, std: as known before. moves: (n,) changes of the common numbers for a change of
    this number by one standard error.
    """

    value: float
    std: float
    moves: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CommonNumbers:
    """Numbers of the lens with their joint covariance.

    Attributes
    ----------
    names : n names, such as `waves.G.7`
    values : (n,)
    covariance : (n, n) with all errors
    stated : numbers known before the session, by name, such as `f_number` or `wavelength_nm.G`

    Raises
    ------
    ValueError
        sizes differ, or the covariance is none
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    stated: Mapping[str, StatedNumber] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.names)
        sizes = {self.values.shape, *(one.moves.shape for one in self.stated.values())}
        if sizes != {(n,)} or self.covariance.shape != (n, n) or len(set(self.names)) != n:
            raise ValueError(f"{n} common numbers differ in number from their errors")
        refuse_no_covariance("the covariance of the common numbers", self.covariance)
