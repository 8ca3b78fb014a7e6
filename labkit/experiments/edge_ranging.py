"""Ranges from edges: the experiment of thesis §5.2.5 and Figures 5.4 and 5.5, on images independent of the
model.

A 70 mm f/2.8 lens focused at 5.012 m, one plane of a D7000's Bayer array at 450 nm, an edge
of paper before an envelope at 5 m and one at 7.7 m; a lens of 0.1 waves that a session
knows to 0.002 waves a mode.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import kstest

from labkit.edges.defocus_sides import near_focus, side_of
from labkit.edges.edge_fit import EdgeProblem, EdgeState, LensPrior, fit_edges
from labkit.edges.first_fits import fit_depth, rough_edge
from labkit.edges.ranges import FocusLaw, edge_range
from labkit.edges.region import Region
from labkit.estimation.climb import NoisePrior
from labkit.experiments.conditions import NOLL
from labkit.experiments.edge_camera import EdgeCamera
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.figure_style import SOFT_INK
from labkit.imaging.optics import Optics
from labkit.optics.lens import ThinLens, defocus_waves
from labkit.types import Floats
from labkit.uncertain import Uncertain

WAVELENGTH_NM = 450.0
FOCUS_MM = 5012.0
RANGES_MM = (5000.0, 7700.0)
THESIS_ERRORS_MM = (21.0, 71.0)  # 5.021 m and 7.771 m
LENS = ThinLens(70.0, 2.8, 0.985)
EDGE_PITCH_UM, EDGE_STEP, EDGE_FRAME = (
    4.78,
    2,
    40,
)  # one plane of four, 40 x 40 of its pixels around each edge
EDGE_CAMERA = EdgeCamera(
    WAVELENGTH_NM * 1e-3,
    float(LENS.working_f_number(FOCUS_MM)),
    EDGE_PITCH_UM,
    step=EDGE_STEP,
    frame=EDGE_FRAME,
    reach_px=80,
)
SIDES_E = (
    9_000.0,
    23_000.0,
)  # electrons of envelope and paper: the thesis states none; those of its bench frames
EDGE_GAIN, EDGE_READ_NOISE = 0.4, 1.5  # counts per electron, counts
LENS_WAVES = 0.1
KNOWN_WAVES = 0.002
DEFOCUS_WAVES = 0.01  # what the thesis's figures take for granted

OTHER_CAMERAS = {
    "D7000, 70 mm f/2.8": ThinLens(70.0, 2.8),
    "full frame, 85 mm f/1.8": ThinLens(85.0, 1.8),
    "APS-C, 35 mm f/1.8": ThinLens(35.0, 1.8),
    "four thirds, 45 mm f/1.8": ThinLens(45.0, 1.8),
    "1-inch compact, 8.8 mm f/1.8": ThinLens(8.8, 1.8),
    "telephone, 5.7 mm f/1.6": ThinLens(5.7, 1.6),
}


@dataclass(frozen=True)
class Lens:
    """One lens and its scenes. seed: of its modes and of the scenes."""

    seed: int
    scenes: int


@dataclass(frozen=True)
class Ranged:
    """An edge of a scene, as the command reports it.

    Range, its estimate and standard error, mm, then estimate and error on the other side of
    best focus, nan if the image excludes this side.
    """

    range_mm: float
    found_mm: float
    std_mm: float
    other_mm: float
    other_std_mm: float

    @property
    def nearest(self) -> tuple[float, float]:
        """Error and standard error, mm, of the side nearer to the truth."""
        sides = [
            (self.found_mm - self.range_mm, self.std_mm),
            (self.other_mm - self.range_mm, self.other_std_mm),
        ]
        return min(sides, key=lambda side: abs(side[0]) if np.isfinite(side[0]) else np.inf)

    @property
    def row(self) -> dict[str, float]:
        """Row of the table."""
        return {field.name: round(getattr(self, field.name), 6) for field in fields(self)}


def law() -> FocusLaw:
    """Return the thesis's law of focus: the lens is known exactly."""
    return FocusLaw(LENS, ("B",), np.array([FOCUS_MM]), np.zeros((5, 5)), WAVELENGTH_NM)


def optics() -> Optics:
    """Return the camera as the estimator knows it."""
    return Optics(
        wavelength_nm=WAVELENGTH_NM,
        reference_nm=WAVELENGTH_NM,
        f_number=EDGE_CAMERA.f_number,
        pitch_um=EDGE_PITCH_UM,
        active_um=EDGE_PITCH_UM,
        noll=NOLL,
    )


def range_scenes(lens: Lens) -> list[Ranged]:
    """Range scenes of two edges each, both fitted jointly from their boxes alone."""
    rng = np.random.default_rng(lens.seed)
    modes = rng.normal(size=len(NOLL) - 1)
    modes *= LENS_WAVES / np.linalg.norm(modes)
    known = LensPrior(rng.normal(modes, KNOWN_WAVES), KNOWN_WAVES**2 * np.eye(len(modes)))
    true = [float(defocus_waves(LENS, r, FOCUS_MM, WAVELENGTH_NM)) for r in RANGES_MM]
    poses = [
        (rng.uniform(-np.pi, np.pi), rng.uniform(-4, 4))
        for _ in range(lens.scenes * len(true))
    ]
    means = [  # all of one range first: its PSF is made once
        EDGE_CAMERA.mean(
            *poses[k * lens.scenes + s], SIDES_E, np.concatenate([[waves], modes]), NOLL
        )
        for k, waves in enumerate(true)
        for s in range(lens.scenes)
    ]
    return [
        each
        for s in range(lens.scenes)
        for each in _ranged(
            [means[k * lens.scenes + s] for k in range(len(true))], true, known, rng
        )
    ]


def _ranged(
    means: list[Floats], true: list[float], known: LensPrior, rng: np.random.Generator
) -> list[Ranged]:
    """Range one scene."""
    noise = NoisePrior(EDGE_GAIN, 2.0, EDGE_READ_NOISE**2, 2.0)
    regions = tuple(_region(mean, depth, rng) for depth, mean in enumerate(means))
    problem = EdgeProblem((optics(),), regions, (noise,), known)
    ends = [
        fit_depth(problem.alone(k), [rough_edge(region)])
        for k, region in enumerate(regions)
    ]
    start = problem.start(
        [of[0].defocus()[0] for of in ends], [of[0].state.edge(0) for of in ends]
    )
    joint = fit_edges(
        problem,
        EdgeState(start.modes, ends[0][0].state.log_noise, start.defoci, start.edges),
    )
    found = []
    for depth, (range_mm, of) in enumerate(zip(RANGES_MM, ends, strict=True)):
        sides = near_focus(joint, depth) or (
            replace(side_of(joint, depth), log_likelihood=of[0].objective),
            *map(side_of, of[1:]),
        )
        where = edge_range(law(), [("B", sides)])
        other = where.other or Uncertain(np.nan, np.nan)
        found.append(
            Ranged(
                range_mm, where.range_mm.value, where.range_mm.std, other.value, other.std
            )
        )
    return found


def _region(mean_e: Floats, depth: int, rng: np.random.Generator) -> Region:
    counts = EDGE_GAIN * rng.poisson(mean_e) + rng.normal(0, EDGE_READ_NOISE, mean_e.shape)
    places = EDGE_STEP * np.arange(float(EDGE_FRAME))
    rows, columns = (a.ravel() for a in np.meshgrid(places, places, indexing="ij"))
    middle = (EDGE_FRAME * EDGE_STEP - 1) / 2
    return Region(rows, columns, counts.ravel(), (middle, middle), 0, depth)


def uncertainty_mm(lens: ThinLens, range_mm: Floats | float) -> Floats:
    """Return the uncertainty of a range at best focus for a defocus known to DEFOCUS_WAVES. Thesis Figure 5.5."""
    at = np.asarray(range_mm, float)
    step = 1e-4 * at
    change = defocus_waves(lens, at + step, at, WAVELENGTH_NM) - defocus_waves(
        lens, at - step, at, WAVELENGTH_NM
    )
    return np.asarray(DEFOCUS_WAVES / (change / (2 * step)))


def run(setting: Setting) -> Outcome:
    """Measure errors of ranges at 5 m and 7.7 m over their standard errors, and predict other cameras."""
    lenses = [
        Lens(seed, 1 if setting.quick else 6) for seed in range(1 if setting.quick else 18)
    ]
    answers = all_answers(setting, range_scenes, lenses, lambda lens: f"lens {lens.seed}")
    every = [ranged for answer in answers for ranged in answer]
    claims = []
    for range_mm, thesis in zip(RANGES_MM, THESIS_ERRORS_MM, strict=True):
        claims += _claims(
            [r for r in every if r.range_mm == range_mm],
            f"at {range_mm / 1000:g} m",
            thesis,
        )
    reference = float(uncertainty_mm(LENS, 5000.0))
    for name, lens in list(OTHER_CAMERAS.items())[1:]:
        ratio = float(uncertainty_mm(lens, 5000.0)) / reference
        claims.append(
            Claim(f"range uncertainty over the D7000's, {name}", None, ratio, "", 1)
        )
    return Outcome(claims, [r.row for r in every], lambda: _drawn(every))


def _claims(of: list[Ranged], at: str, thesis: float) -> list[Claim]:
    """Return the claims of one range.

    If both sides of best focus are reported, errors are of the nearer side.
    """
    error, std = np.array([r.nearest for r in of]).T
    both = float(np.mean([np.isfinite(r.other_mm) for r in of]))
    pull = error / std
    return [
        Claim(f"both sides of best focus are reported {at}", None, both, "of all", len(of)),
        Claim(
            f"range error {at}, 95 % are below",
            thesis,
            float(np.quantile(np.abs(error), 0.95)),
            "mm",
            len(of),
        ),
        Claim(f"standard error {at}, median", None, float(np.median(std)), "mm", len(of)),
        Claim(
            f"error over standard error {at}, mean", None, float(pull.mean()), "", len(of)
        ),
        Claim(
            f"error over standard error {at}, standard deviation",
            None,
            float(pull.std()),
            "",
            len(of),
        ),
        Claim(
            f"Kolmogorov-Smirnov p of these {at}",
            None,
            float(kstest(pull, "norm").pvalue),
            "",
            len(of),
        ),
    ]


def _drawn(every: list[Ranged]) -> Figure:
    """Plot Figure 5.4 (b), errors over range, and Figure 5.5."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = np.linspace(4000, 9000, 200)
    slope = np.gradient(defocus_waves(LENS, at, FOCUS_MM, WAVELENGTH_NM), at)
    left.plot(
        at / 1000, DEFOCUS_WAVES / slope, color=SOFT_INK, label="0.01 waves RMS of defocus"
    )
    for range_mm, thesis, colour in zip(
        RANGES_MM, THESIS_ERRORS_MM, ("#0072b2", "#d55e00"), strict=True
    ):
        errors = [abs(r.nearest[0]) for r in every if r.range_mm == range_mm]
        jitter = np.linspace(-90, 90, len(errors))
        left.plot(
            (range_mm + jitter) / 1000,
            errors,
            ".",
            color=colour,
            markersize=4,
            label=f"{len(errors)} edges at {range_mm / 1000:g} m",
        )
        left.plot(
            [range_mm / 1000],
            [thesis],
            "*",
            color=colour,
            markersize=10,
            markeredgecolor="black",
            zorder=3,
        )
    left.set(
        xlabel="range, m",
        ylabel="|error|, mm",
        title="Ranges from edges (5.4b); stars: the thesis",
        yscale="log",
        ylim=(0.05, 1000),
    )
    left.legend()
    at = np.geomspace(500, 20_000, 60)
    for (name, lens), line in zip(
        OTHER_CAMERAS.items(), ("-", "--", "-.", ":", "-", "--"), strict=True
    ):
        right.loglog(at / 1000, uncertainty_mm(lens, at), linestyle=line, label=name)
    right.set(
        xlabel="range in focus, m",
        ylabel="range uncertainty, mm",
        title="0.01 waves of defocus in other cameras (5.5)",
    )
    right.legend(fontsize=7)
    return figure
