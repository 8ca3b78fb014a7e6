"""What a camera adds to the blur of lens and pixel, and a panel to what is drawn: one part a file."""

from labkit.imaging.parts.aperture import Aperture
from labkit.imaging.parts.diffusion import Diffusion
from labkit.imaging.parts.low_pass import LowPass
from labkit.imaging.parts.part import Part
from labkit.imaging.parts.smear import Smear
from labkit.imaging.parts.veil import Veil

__all__ = ["Aperture", "Diffusion", "LowPass", "Part", "Smear", "Veil"]
