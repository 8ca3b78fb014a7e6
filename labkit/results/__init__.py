"""Results: what a session's photographs amount to, kept in SESSION/results/NAME."""

from labkit.results.best_focus import BestFocus
from labkit.results.model import (
    Focus,
    Lens,
    OptimumTest,
    OtherOptimum,
    Placement,
    Residuals,
    ResidualSpectrum,
    Wavefront,
)
from labkit.results.results import Results
from labkit.results.tables import ColourShift

__all__ = [
    "BestFocus",
    "ColourShift",
    "Focus",
    "Lens",
    "OptimumTest",
    "OtherOptimum",
    "Placement",
    "ResidualSpectrum",
    "Residuals",
    "Results",
    "Wavefront",
]
