"""Every number that steers the estimate, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Constants of the session's estimate. Lengths of modes are in waves RMS at the reference wavelength.

    Attributes are grouped by the module that reads them.
    """

    # lens_model: what is known of every lens, camera and rail before a session
    magnification_bounds: tuple[float, float] = (0.05, 20.0)
    """Pupil magnifications that are tried: no lens lies beyond."""
    defocus_floor_waves: float = 2e-4
    """Error of every defocus beyond its bound: the RMS over nine fits of an independent simulator's frames."""
    size_floor: float = 3e-5
    """Relative error of every size in the picture: targets are as flat, pictures as free of distortion."""
    lateral_colour_std: float = 0.01
    """Relative size of a colour's picture against the reference colour's."""
    axial_colour_std: float = 0.05
    """Best focus of a colour against the reference colour's, relative: simple lenses have 0.02."""
    colour_modes_std: float = 0.1
    """Modes of a colour against those of all colours: the path is the same glass."""
    mode_std: float = 10.0
    """A mode before it is measured: nothing is known."""
    part_std: float = 10.0
    """A number of a camera's part before it is measured, in its own unit: nothing is known."""
    same_tilt_chance: float = 1e-3
    """Chance of tilts of the target that differ as much, below which each range has its own."""
    tilt_floor: float = 1e-5
    """Relative change of a size by a carriage that tips: 0.3 degrees."""

    # select: which candidate, which sign, which observations belong
    rough_waves: float = 0.003
    """Error added to every mode while optima are told apart: twelve of it are 0.01, and no other optimum is so near."""
    rough_cone: float = 3e-3
    """The same for ln of the f-number: the standard error of one clear frame."""
    rough_size: float = 1e-3
    """The same for ln of the scale: a target that was touched between ranges."""
    outlier_cost: float = 25.0
    """Log-likelihood that leaving out an observation costs whose residuals are noise: chance exceeds it once in 10^8."""
    doubtful_cost: float = 10.0
    """The same where residuals are not noise alone: once in 500."""
    poor_share: float = 0.5
    """Share of the observations whose residuals are not noise, above which the model is poor for all."""
    poor_errors: float = 30.0
    """Factor by which errors grow, where the model is poor for all, while optima are told apart: what is missing moves every
    observation its own way. On lenses with modes, blades or an obstruction beyond the model, moves were up to 25 errors."""
    few_outliers: float = 0.25
    """Share of the observations that is left out rather than a law loosened."""
    clear_gain: float = 4.5
    """Log-likelihood between two choices of a channel's signs, below which the signs are open: three standard errors."""

    # select: laws that the members contradict are loosened
    contradiction_chance: float = 1e-3
    """Chance of a misfit as large, below which a law is loosened, or all errors widened."""
    loose_cone: float = 0.1
    """Relative error of the cone where it does not follow from the lens's conjugates."""
    loose_size: float = 0.03
    """Relative error of every size, the same."""
    mode_scatter_waves: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1)
    """Scatter of each mode from range to range, half decades: the likeliest is taken."""

    # session: what is fitted next
    sure_waves: float = 0.05
    """Standard error of a predicted defocus, below which a climb starts there: wrong optima are farther."""
    other_optimum_waves: float = 0.01
    """RMS over the modes: what departs by less is no other optimum."""
    most_predictions: int = 4
    """Climbs of one observation from predictions: after that the session has not settled on one."""
    shared_cone_std: float = 0.01
    """Relative error of a cone that other frames of the session measured."""


SETTINGS = Settings()
