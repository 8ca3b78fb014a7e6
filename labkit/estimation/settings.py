"""All numerical settings of the estimate, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.plan.tables import ENGRAVED_F_NUMBER


@dataclass(frozen=True)
class Settings:
    """Constants of the session's estimate, in the order of its steps.

    Modes and defocus are in waves RMS, unless said otherwise at the reference wavelength; windows of a PSF in lambda N;
    standard errors of f-numbers and sizes are relative; costs and gains are log-likelihoods.
    """

    # starts: where to climb from
    sketch_band: float = 0.2
    """Share of the pass band in a sweep: its optima differ by 0.001 to 0.002 waves from optima of the whole band."""
    swept_waves: tuple[float, ...] = (0.1, 0.25, 0.45, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
    """Defocus values of a sweep, at the light's own wavelength: each less than twice the value before, or the sweep would step
    over an optimum; the twin covers negative values."""
    tried: int = 3
    """Number of best items of a ranked list tried: values of a sweep, which included the right value on every session;
    fits with the most significant camera part, before all are refitted with it; predictions of one wavefront."""
    plausible_share: float = 0.005
    """Largest share of a sweep's excess variance that right optima leave in part of the band."""
    near_waves: float = 0.5
    """Defocus, at the light's own wavelength, below which other modes dominate a picture."""
    near_window_airy: float = 48.0
    """PSF window of a search below `near_waves`: geometric blur of 0.5 waves RMS is 14 lambda N wide."""
    start_waves: tuple[float, float] = (0.05, 0.4)
    """RMS of random starts, and of random wavefronts for PSF components, at the light's own wavelength: larger wavefronts are
    far from focus, where a sweep finds them."""
    most_steps: int = 25
    """Largest number of steps of a climb: climbs to the best optimum of a search take 10 to 20. With a free f-number two to six
    suffice; on `corner-open`, with forty numbers, climbs took 3 to 24, and three of eighteen ended at this limit."""
    least_damping: float = 1e-5
    """Damping after the first step that led down, over 8, in a climb over all parameters. A trial takes a quarter of the time
    of slopes. With 1e-3 a climb of 25 steps in the curved valley of cut pupil and modes, on `corner-open`, ended 44 lower."""
    most_starts: int = 40
    """Largest number of starts of one search: 40 starts miss an optimum to which 5 % lead with a probability of 0.13."""
    enough_returns: int = 8
    """Number of starts that return to the best optimum before a search ends. A better optimum to which as many starts lead was
    missed with a probability of 1 in 2^8."""
    same_optimum: float = 0.5
    """Difference of log-likelihood, one standard error, below which two ends are one optimum."""

    # together: several stations at once, from nothing
    contrary_waves: float = 0.15
    """RMS difference between modes of two unexplained optima, except defocus, or between their defocus and the lens's steps,
    beyond which stations are searched together. A model without blades, an obstruction of 0.42 or higher modes left 0.006 to
    0.09 in the modes; half a wave in 34 modes left 0.11 to 0.27, and defocus up to 0.6 out of step."""
    stations: int = 3
    """Number of stations: the nearest, the farthest and the middle one."""
    coarse_airy: tuple[float, float] = (12.0, 6.0)
    """Widths of coarse pixels, lambda N: in these pictures one wave RMS blurs as much as a quarter and half a wave do in whole
    ones."""
    coarse_pixel_airy: float = 6.0
    """Width of a coarse pixel, in its own lambda N: a wider one is given light of a longer wavelength."""
    strong_starts: int = 16
    """Largest number of starts: with one wave RMS in 34 modes, of six sessions the right optimum was reached from the first to
    the tenth start."""
    strong_start_waves: float = 0.05
    """RMS of each mode beyond defocus of a start."""
    other_coarse_waves: float = 0.05
    """RMS over the modes: a smaller difference between ends in coarse pictures is no other optimum."""
    first_damping: float = 1.0
    """Damping of the first step: with 1e-3, climbs jumped to other optima where modes have one wave RMS."""
    strong_steps: int = 30
    """Largest number of steps: climbs to the right optimum took 16 to 30 in the coarsest pictures, others more."""

    # small_problem: one frame, its pose held
    small_window_airy: float = 32.0
    """Window of PSFs: light farther out hardly depends on the wavefront."""
    psf_components: int = 300
    """Number of PSF components: 1 % of a PSF's departure from the perfect PSF remains."""
    worth_misfit: float = 1.1
    """Largest ratio of an optimum's misfit to the least misfit for a climb over the whole likelihood."""
    pixels_at_once: int = 8192
    """Number of pixels whose rows are factorised together: the rows of a large target take 500 MB."""

    # climb, expansion: from a start to an optimum
    converged_stds: float = 0.05
    """Standard errors, all parameters together: a climb ends if the remaining distance is shorter."""
    settled_stds: float = 0.3
    """Standard errors: a shorter step moves an optimum by less than 1e-5 waves beyond second order."""
    narrow_window: float = 0.8
    """Least share of a wavefront's required window: twice as much light falls outside a smaller window."""
    blocks: int = 10
    """Blocks of pixels along each side of a cut, for the sandwich covariance: wider than correlations by one wrong kernel."""
    tilt_draws: int = 200
    """Number of random poses to estimate the error of a tilt to 5 %."""
    rounded_light: float = 5e-4
    """Relative error of an exact wavelength stated to the nanometre: 0.29 nm of 580."""
    exact: float = 1e-6
    """Relative error of exact numbers: no photograph measures a number so precisely."""

    # residual_tests: whether residuals are noise alone
    model_error: float = 0.01
    """Allowed relative error of the residuals' variance due to the model, for flats and PSFs have such errors. Ends of the
    small problem whose misfits differ by less are one optimum."""
    unmeasured: float = 0.25
    """Standard error above which a combination of modes (waves), or the variance of the noise (relative), is undetermined."""

    # stray_pixels: pixels that no model explains
    stray_stds: float = 8.0
    """Standard deviations of noise that a stray pixel departs at least: noise does by chance once in 10^15."""
    stray_ratio: float = 3.0
    """Least ratio to the usual largest residual, that of the rank below. In first fits of eight golden sessions, with chi2 per
    pixel up to 21, the largest of all was up to 1.7 times that."""
    stray_share: float = 0.002
    """Largest share of stray pixels in a photograph: more residuals alike show what the model lacks."""
    least_strays: int = 8
    """Number of stray pixels that any photograph may have: the track of a cosmic ray."""
    cleanings: int = 3
    """Number of times that stray pixels are looked for anew: a fit without the largest shows smaller ones."""

    # lens_model: what is known of every lens, camera and rail before a session
    usual_waves: float = 0.15
    """Standard deviation of each mode beyond defocus before any photograph. It holds what light does not tell: in sketches of
    strong wavefronts, and behind a cat's eye, where modes have errors of several waves together."""
    mistake_odds: float = 0.1
    """Odds, before any photograph, that a stated number is a mistake, and probability of a plan without mistakes below which
    the results assume the likeliest mistake. With lower odds a pitch that is 5 % off at close range, which photographs hardly
    tell, would be more than four errors away."""
    magnification_bounds: tuple[float, float] = (0.05, 20.0)
    """Bounds of the pupil magnification: no lens is outside."""
    defocus_floor_waves: float = 2e-4
    """Error of every defocus in addition to its bound: RMS over nine fits of an independent simulator's frames."""
    size_floor: float = 3e-5
    """Relative error of every size in the picture, and of its change with tilt: targets are as flat, pictures as free of
    distortion."""
    colour_std: float = 0.05
    """Relative difference of best focus and of size between a colour and the reference colour: simple lenses have 0.02."""
    colour_modes_std: float = 0.1
    """Difference of modes between a colour and all colours: light passes the same glass."""
    field_order: int = 4
    """Largest radial order of the field's expansion tried unless the plan states one: a commercial lens's modes leave
    0.025 of 0.9 waves RMS beyond a polynomial of that degree."""
    field_waves: float = 0.3
    """Standard deviation of a mode's change over the field before the session: fast lenses have as much at the corners."""
    unknown: float = 10.0
    """Prior standard error of an unknown mode or part's number, in its own unit."""
    loose: float = 0.1
    """Relative error of a stated number that is a mistake, and of a working f-number or size that does not follow from the
    lens's conjugates. Larger departures are plain in any case."""
    mode_scatter_waves: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1)
    """Scatter of each mode from range to range, in half decades; the likeliest is chosen. While optima are selected every mode,
    and ln of f-number and scale, scatter by the least: over twelve modes 0.01, and no other optimum is so near."""

    # select: which candidate, which sign, which observations belong
    outlier_cost: float = 25.0
    """Penalty for leaving out an observation, exceeded by chance once in 10^8."""
    poor_errors: float = 30.0
    """Factor on errors while optima are selected if the model is incomplete for all: each observation then has a bias of its
    own. In 18 fits of two lenses, with blades and with modes beyond the model, modes departed by up to 39 sandwich errors."""
    few: float = 0.25
    """Largest share of observations to leave out before a law is loosened; least share of the unexplained log-likelihood that a
    camera part must explain, for a smaller share may have another cause."""
    clear_gain: float = 4.5
    """Difference between two choices of a channel's signs, three standard errors, below which the signs are open; extra gain
    that a rarer camera part must have over a more common part of similar blur; net gain that a further part promises,
    below which a choice that explains the fits is compared with no others."""
    contradiction_chance: float = 1e-3
    """Probability of a misfit at least as large below which a law is loosened, errors grow by the Birge ratio, or residuals
    are not noise."""
    parted_chi2: float = 5.0
    """Factor by which chi2 must fall if a session is split: with a touched lens, misfits are hundreds of standard errors."""

    # camera: which of its parts are fitted
    part_chance: float = 5e-5
    """Probability of the gain that a part, or modes, must have, if they are absent: once in 20 000 sessions."""
    deciding_tiles: int = 9
    """Number of tiles of each photograph that decide about parts and modes: middle, corners and sides of a frame."""

    # session: what is fitted next
    sure_waves: float = 0.05
    """Standard error of a predicted defocus, of a tile's whole wavefront, below which a climb starts from the prediction, and
    RMS departure of the other modes below which an optimum agrees with its prediction: wrong optima are farther away."""
    other_optimum_waves: float = 0.01
    """RMS over the modes: a smaller difference is no other optimum."""
    shared_f_number_std: float = 0.01
    """Relative error of a working f-number that other frames of the session measured."""
    known_waves: float = 0.03
    """Standard deviation of each mode beyond defocus about what explained fits tell, behind a cat's eye: wider than errors of
    predictions and differences between colours."""

    @property
    def f_number_margin(self) -> float:
        """Relative change of the f-number, two standard errors of an engraving, without a new model."""
        return 2 * ENGRAVED_F_NUMBER


SETTINGS = Settings()
