"""Parts of the camera that blur, one a file. A new part is a file and a place in `KNOWN`."""

from labkit.imaging.parts.diffusion import Diffusion
from labkit.imaging.parts.low_pass import LowPass
from labkit.imaging.parts.part import Part
from labkit.imaging.parts.smear import Smear
from labkit.imaging.parts.spectrum import SpectrumWidth
from labkit.imaging.parts.veil import Veil

__all__ = ["KNOWN", "Diffusion", "LowPass", "Part", "Smear", "SpectrumWidth", "Veil"]

KNOWN: dict[str, Part] = {
    part.name: part
    for part in (
        LowPass(),
        Diffusion(),
        Veil(),
        Smear(),
        LowPass(turned=True),
        SpectrumWidth(),
    )
}
"""Parts that a camera may have, by name, the commonest first; each does nothing yet."""
