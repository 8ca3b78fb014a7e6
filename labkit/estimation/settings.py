"""Every number that steers the estimate, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Constants of the session's estimate, in the order of its steps.

    Modes and defocus are in waves RMS, unless said otherwise at the reference wavelength; windows of a PSF in lambda N;
    standard errors of f-numbers and sizes are relative; costs and gains are log-likelihoods.
    """

    # starts: where to climb from
    sketch_band: float = 0.2
    """Share of the pass band in a sweep: optima of that part are 0.001 to 0.002 waves from those of the whole band."""
    swept_waves: tuple[float, ...] = (0.1, 0.25, 0.45, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
    """Defocus that a sweep tries, at the light's own wavelength: each less than twice the one before, or it would step over
    an optimum; the twin covers negative ones."""
    tried: int = 3
    """Best of a ranked list that are tried: values of a sweep, among which the right one was on every session; fits that show
    most of a camera part, before all are fitted with it; predictions of one wavefront."""
    plausible_share: float = 0.005
    """Share of a sweep's excess variance that right optima of part of the band leave, at most."""
    near_waves: float = 0.5
    """Defocus, at the light's own wavelength, below which other modes decide what a picture looks like."""
    near_window_airy: float = 48.0
    """Window of a search's PSF there: geometric blur of 0.5 waves RMS is 14 lambda N wide."""
    start_waves: tuple[float, float] = (0.05, 0.4)
    """RMS of random starts, and of what components of PSFs are drawn from, at the light's own wavelength: larger wavefronts are
    far from focus, where a sweep finds them."""
    search_steps: int = 25
    """Steps of a climb while searching: those that end in the best optimum take 10 to 20."""
    most_starts: int = 40
    """Starts of one search: an optimum to which 5 % of the starts lead is missed by 40 with a chance of 0.13."""
    enough_returns: int = 8
    """Starts that come back to the best optimum before a search ends. A better one to which as many starts lead has escaped
    them with a chance of 1 in 2^8."""
    same_optimum: float = 0.5
    """Difference of log-likelihood, one standard error, below which two ends are one optimum."""

    # small_problem: one frame, its pose held
    small_window_airy: float = 32.0
    """Window of its PSFs: what reaches farther hardly depends on the wavefront."""
    psf_components: int = 300
    """Components that PSFs are made of: they leave 1 % of a PSF's departure from the perfect one."""
    worth_misfit: float = 1.1
    """Misfit over the least one, up to which an optimum is worth a climb over the whole likelihood."""
    pixels_at_once: int = 8192
    """Pixels whose rows are factorised together: those of a large target take 500 MB."""

    # climb, expansion: from a start to an optimum
    converged_stds: float = 0.05
    """Standard errors: a climb ends where what is left to go is shorter, all numbers together."""
    settled_stds: float = 0.3
    """Standard errors: a shorter step moves an optimum by less than 1e-5 waves beyond second order."""
    slopes_stds: float = 1.0
    """Standard errors: the picture after a last step as short lies on the slopes, and is not drawn."""
    newton_rounds: int = 12
    """Steps of Newton's: six do where the cone is 12 % off, and two or three where it is 3 % off."""
    cone_margin: float = 0.06
    """Relative change of the cone, two of an engraving's errors, up to which a model serves without being built anew."""
    narrow_window: float = 0.8
    """Share of the window that a wavefront should have, below which twice as much light strays beyond it."""
    blocks: int = 10
    """Blocks of pixels along each side of a cut, for the sandwich covariance: wider than what one wrong kernel makes alike."""
    tilt_draws: int = 200
    """Poses drawn to see how well a tilt is known: its error is right to 5 %."""
    exact: float = 1e-6
    """Relative error of what is held exact, and relative step of differences: no photograph knows a number so well."""

    # residual_tests: whether residuals are noise alone
    model_error: float = 0.01
    """Relative error of the residuals' variance that a model may have: flats and PSFs are right to as much. Of the small
    problem, ends whose misfits differ by less are one optimum."""
    unmeasured: float = 0.25
    """Standard error above which a combination of modes (waves), or the variance of the noise (relative), was not measured."""

    # lens_model: what is known of every lens, camera and rail before a session
    magnification_bounds: tuple[float, float] = (0.05, 20.0)
    """Pupil magnifications that are tried: no lens lies beyond."""
    defocus_floor_waves: float = 2e-4
    """Error of every defocus beyond its bound: the RMS over nine fits of an independent simulator's frames."""
    size_floor: float = 3e-5
    """Relative error of every size in the picture, and of its change where the target tips: targets are as flat, pictures as
    free of distortion."""
    colour_std: float = 0.05
    """Best focus, and size of the picture, of a colour against the reference colour's, relative: simple lenses have 0.02."""
    colour_modes_std: float = 0.1
    """Modes of a colour against those of all colours: the path is the same glass."""
    unknown: float = 10.0
    """Standard error of a mode, or a part's number, of which nothing is known, in its own unit."""
    loose: float = 0.1
    """Relative error of a cone, and of a size, that do not follow from the lens's conjugates."""
    mode_scatter_waves: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1)
    """Scatter of each mode from range to range, half decades: the likeliest is taken."""

    # select: which candidate, which sign, which observations belong
    rough: float = 0.003
    """Error added to every mode, and to ln of f-number and scale, while optima are told apart: twelve of it are 0.01, and no
    other optimum is so near."""
    outlier_cost: float = 25.0
    """Cost of leaving out an observation: chance exceeds it once in 10^8."""
    poor_errors: float = 30.0
    """Factor by which errors grow where the model is poor for all, while optima are told apart: what is missing moves every
    observation its own way, by up to 25 errors on lenses with modes, blades or an obstruction beyond the model."""
    few: float = 0.25
    """Share of the observations up to which they are left out rather than a law loosened; share of what residuals leave
    unexplained that a part of the camera must explain, or it stands for another lack."""
    clear_gain: float = 4.5
    """Gain between two choices of a channel's signs, three standard errors, below which the signs are open; gain that a rarer
    part of the camera must have beyond that of a commoner one that blurs alike."""
    contradiction_chance: float = 1e-3
    """Chance of a misfit as large, below which a law is loosened, errors are widened, or residuals are not noise."""
    parted_chi2: float = 5.0
    """Factor by which chi2 must fall where a session is parted: a touched lens leaves hundreds of times its errors."""

    # camera: which of its parts are fitted
    part_cost: float = 10.0
    """Gain that a part must have: chance gains as much once in 20 000 sessions."""

    # session: what is fitted next
    sure_waves: float = 0.05
    """Standard error of a predicted defocus, below which a climb starts there, and RMS of the other modes' departure from a
    prediction, below which an end is as predicted: wrong optima are farther."""
    other_optimum_waves: float = 0.01
    """RMS over the modes: what departs by less is no other optimum."""
    shared_cone_std: float = 0.01
    """Relative error of a cone that other frames of the session measured."""


SETTINGS = Settings()
