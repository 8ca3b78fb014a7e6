"""Parts of camera and lens that blur, each in a file. A new part is a file and an entry in `KNOWN`."""

from labkit.imaging.parts.blades import Blades
from labkit.imaging.parts.cats_eye import CatsEye
from labkit.imaging.parts.diffusion import Diffusion
from labkit.imaging.parts.low_pass import LowPass
from labkit.imaging.parts.obstruction import Obstruction
from labkit.imaging.parts.part import Part, rim_of
from labkit.imaging.parts.smear import Smear
from labkit.imaging.parts.spectrum import SpectrumWidth
from labkit.imaging.parts.uneven_rim import UnevenRim
from labkit.imaging.parts.veil import Veil

__all__ = [
    "KNOWN",
    "Blades",
    "CatsEye",
    "Diffusion",
    "LowPass",
    "Obstruction",
    "Part",
    "Smear",
    "SpectrumWidth",
    "UnevenRim",
    "Veil",
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
    )
}
"""Parts that camera and lens may have, by name, the commonest first; each does nothing yet."""
