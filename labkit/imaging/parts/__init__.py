"""Parts of camera and lens that blur, in a file for each kind. A new part is a class and an entry in `KNOWN`."""

from labkit.imaging.estimated import Estimated
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts.blur import Diffusion, LowPass, Smear, Veil
from labkit.imaging.parts.field_rim import UnevenField, Vignetted
from labkit.imaging.parts.part import Part, rim_of
from labkit.imaging.parts.rim import Blades, CatsEye, Obstruction, UnevenRim
from labkit.imaging.parts.spectrum import SpectrumWidth
from labkit.plan.mode_groups import MODE_GROUPS, ModeGroup

__all__ = [
    "ESTIMATED",
    "KNOWN",
    "OPTIONAL_PARTS",
    "Aperture",
    "Blades",
    "CatsEye",
    "Diffusion",
    "LowPass",
    "Obstruction",
    "Part",
    "Smear",
    "SpectrumWidth",
    "UnevenField",
    "UnevenRim",
    "Veil",
    "Vignetted",
    "rim_of",
]

KNOWN: dict[str, Part] = {
    part.name: part
    for part in (
        LowPass(),
        Diffusion(),
        Veil(),
        Smear(),
        LowPass(turned=True),
        SpectrumWidth(),
        *(Blades(number) for number in range(3, 21)),
        Obstruction(),
        UnevenRim(),
        CatsEye(),
        UnevenField(),
        Vignetted(),
    )
}
"""Parts that camera and lens may have, by name, the commonest first; each does nothing yet."""

ESTIMATED: dict[str, Estimated] = {**KNOWN, Aperture.name: Aperture()}
"""Groups of numbers that results may hold, by name."""

OPTIONAL_PARTS: dict[str, Part | ModeGroup] = {**KNOWN, **MODE_GROUPS}
"""Parts and groups of modes that a session may add to its model, by name."""
