"""The joint fit of all edges at one place of the frame, in one channel: one wavefront, a defocus for each photograph.

An edge shows defocus and astigmatism along its normal only, and of both together the size: a place starts from each
pattern of signs that the widths of its edges allow, and the likeliest end is kept. Edges are fitted as profiles
(`labkit.charts.edge_profile`): photographs of a whole frame have a thousand of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from labkit.charts.edge_profile import EdgeProfile, edge_profile
from labkit.charts.patterns import Cell
from labkit.charts.spread_table import SpreadTable
from labkit.edges.box_fit import MOST_LEFT, BoxTask
from labkit.edges.camera import Camera
from labkit.edges.comparison import Comparison, compare, pixels_of
from labkit.edges.edge_fit import LensPrior
from labkit.edges.esfr import Esfr
from labkit.edges.first_fits import likely_defocus
from labkit.edges.other_blur import Measured, find_blur
from labkit.edges.response import Response, response_along
from labkit.errors import DataError
from labkit.estimation.climb import NoisePrior
from labkit.imaging.optics import Optics
from labkit.optics.zernike import noll_to_nm
from labkit.types import Floats, Indices

ASTIGMATIC = (5, 6)
FIELD_MODE_STD = {2: 0.2, 3: 0.1}
"""Waves RMS by radial order, of the prior at a place of the field; USUAL_MODE_STD for higher orders."""

START_STEPS = 21  # of each number that starts a fit
MODEL_WAVES = 0.05  # RMS that an edge's defocus by its width may be wrong by, its other modes being unknown
MODEL_SHARE = 0.15  # the same, relative
MOST_PATTERNS = 3
UNLIKELY = 50.0  # chi-squared above the best start's
EXPLAINED = 1.3  # of chi-squared for each degree of freedom, after the first steps

ALIKE_RAD = 0.02  # between edges whose spreads are read from one, turned to first order
NUISANCES = 4  # numbers of an edge beside the wavefront: its shift, its two sides, and the light's slope across
ROUGH_STEPS, MOST_FIT_STEPS = 3, 12
SETTLED_PLACE = 0.05  # standard errors, of the last step
MOST_WAVES = 0.4  # RMS, of a step
MOST_SHIFT_PX = 3.0  # of an edge in the fit
DAMPED = 5  # times that a step may be shortened
NOISE_STEPS = 12


@dataclass(frozen=True)
class PlaceTask:
    """The edges of a place in one channel.

    Attributes
    ----------
    cell, camera : the place in the grid, and the camera in this channel
    boxes : the edges
    photograph : of each edge
    sample_px : distance of neighbouring pixels of the channel
    law_waves : (photographs,) defocus of each by the lens's law, of a common zero
    """

    cell: Cell
    camera: Camera
    boxes: tuple[BoxTask, ...]
    photograph: tuple[int, ...]
    sample_px: float
    law_waves: Floats


@dataclass(frozen=True)
class EdgeResponse:
    """An edge of the place.

    Attributes
    ----------
    photograph : its number
    middle_px : (row, column)
    angle_deg : of its normal, from x (right) towards y (down)
    length_px : of the line within its region
    fitted, iso : responses by the fit and by ISO 12233
    chi2_per_pixel : of the fit
    comparison : of its response by ISO 12233 with the joint fit's, where they contradict each other; None otherwise
    cause : of a blur that no lens makes, in words, empty without one
    """

    photograph: int
    middle_px: tuple[float, float]
    angle_deg: float
    length_px: float
    fitted: Response
    iso: Esfr | None
    chi2_per_pixel: float
    comparison: Comparison | None = None
    cause: str = ""


@dataclass(frozen=True)
class PlaceFit:
    """A fitted place, or why its edges could not be fitted.

    Attributes
    ----------
    cell, optics, channel : the place in the grid, and the camera there
    edges : fitted edges
    rejected : a sentence for each edge without a fit
    photographs : (depths,) numbers of those with fitted edges
    law_waves : (depths,) defocus of each by the lens's law
    waves, covariance : (depths + modes,) defoci and the other modes, waves RMS; its covariance
    """

    cell: Cell
    optics: Optics
    channel: str
    edges: tuple[EdgeResponse, ...] = ()
    rejected: tuple[str, ...] = ()
    photographs: tuple[int, ...] = ()
    law_waves: Floats = field(default_factory=lambda: np.zeros(0))
    waves: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def wavefront(self, depth: int) -> tuple[Floats, Floats]:
        """Return the modes (modes,) of one photograph, defocus first, and their covariance."""
        at = np.r_[depth, len(self.photographs) : self.waves.size]
        return self.waves[at], self.covariance[np.ix_(at, at)]


def place_prior(noll: Sequence[int]) -> LensPrior:
    """Return the prior of the modes but defocus (Noll's numbers) of an unknown lens away from its axis."""
    usual = LensPrior.unknown(len(noll))
    std = [
        FIELD_MODE_STD.get(noll_to_nm(j)[0], usual.covariance[k, k] ** 0.5)
        for k, j in enumerate(noll)
    ]
    return LensPrior(usual.mean, np.diag(np.square(std)))


def fit_place(task: PlaceTask) -> PlaceFit:
    """Fit all edges of a place together."""
    used: list[int] = []
    profiles: list[EdgeProfile] = []
    rejected: list[str] = []
    for k, box in enumerate(task.boxes):
        assert box.place.found is not None
        try:
            profiles.append(edge_profile(box.regions[0], box.place.found, task.sample_px))
            used.append(k)
        except (DataError, np.linalg.LinAlgError) as error:
            rejected.append(str(error))
    while used:
        photographs = sorted({task.photograph[k] for k in used})
        depths = [photographs.index(task.photograph[k]) for k in used]
        fit = _likeliest(_Edges.of(task, profiles, depths), task.law_waves[photographs])
        rough = [share > MOST_LEFT for share in fit.left]
        if not any(rough):
            return _place(task, used, photographs, fit, rejected)
        rejected += [
            f"it holds no straight edge between two even sides: what the fit leaves varies by {share:.0%} of the step, at "
            f"most {MOST_LEFT:.0%} is allowed"
            for share, bad in zip(fit.left, rough, strict=True)
            if bad
        ]
        used = [k for k, bad in zip(used, rough, strict=True) if not bad]
        profiles = [of for of, bad in zip(profiles, rough, strict=True) if not bad]
    return PlaceFit(
        task.cell, task.camera.optics, task.camera.channel, rejected=tuple(rejected)
    )


def _place(
    task: PlaceTask,
    used: Sequence[int],
    photographs: Sequence[int],
    fit: _End,
    rejected: Sequence[str],
) -> PlaceFit:
    """Return a fitted place."""
    edges = fit.edges
    count = edges.lens
    covariance = fit.covariance[:count, :count]
    place = PlaceFit(
        task.cell,
        task.camera.optics,
        task.camera.channel,
        rejected=tuple(rejected),
        photographs=tuple(photographs),
        law_waves=task.law_waves[photographs],
        waves=fit.numbers[:count],
        covariance=covariance,
    )
    means = {j: mean for j, mean, _, _ in edges.means(fit.numbers)}
    responses = tuple(
        _compared(
            EdgeResponse(
                task.photograph[k],
                edges.profiles[j].middle_px,
                float(np.degrees(edges.profiles[j].azimuth)),
                edges.profiles[j].length_px,
                response_along(
                    place.optics,
                    *place.wavefront(edges.depths[j]),
                    edges.profiles[j].azimuth,
                ),
                task.boxes[k].measured()[0],
                fit.chi2_per_pixel[j],
            ),
            task.boxes[k],
            edges.profiles[j],
            means[j],
            edges.prior,
            float(place.waves[edges.depths[j]]),
        )
        for j, k in enumerate(used)
    )
    return replace(place, edges=responses)


def _compared(
    edge: EdgeResponse,
    box: BoxTask,
    profile: EdgeProfile,
    mean: Floats,
    prior: LensPrior,
    defocus_waves: float,
) -> EdgeResponse:
    """Return an edge with what its response by ISO 12233 has more than the place's lens, where it contradicts the lens.

    What no lens makes is in no direction but its own: the place has the lens, and each edge what it shows more.
    """
    if edge.iso is None:
        return edge
    optics = box.camera.optics
    drawn = profile.drawn(mean, *pixels_of(box.place.slices))
    comparison = compare(box.planes, edge.iso, drawn, optics.pitch_um)
    if comparison is None or not comparison.contradicts:
        return edge
    measured = Measured.along(optics, prior, profile.azimuth, edge.fitted, comparison)
    other = find_blur(measured, defocus_waves)
    return replace(
        edge,
        fitted=comparison.corrected(edge.fitted),
        comparison=comparison,
        cause="" if other is None else other.cause,
    )


@dataclass(frozen=True, eq=False)
class _Edges:
    """Profiles of a place, and what is known of them.

    Attributes
    ----------
    optics, prior : of the channel; of the modes but defocus
    profiles, depths : edges, and the photograph of each among those of the place
    noise : (depths, 2) gain and read variance
    """

    optics: Optics
    prior: LensPrior
    profiles: tuple[EdgeProfile, ...]
    depths: tuple[int, ...]
    noise: Floats

    @classmethod
    def of(
        cls, task: PlaceTask, profiles: Sequence[EdgeProfile], depths: Sequence[int]
    ) -> _Edges:
        """Return the edges of a place, with the noise of each photograph."""
        camera = task.camera
        noise = [
            _noise(
                [of for of, d in zip(profiles, depths, strict=True) if d == depth],
                camera.noise,
            )
            for depth in range(max(depths) + 1)
        ]
        prior = place_prior(camera.optics.noll[1:])
        return cls(camera.optics, prior, tuple(profiles), tuple(depths), np.array(noise))

    @property
    def lens(self) -> int:
        """Number of defoci and modes, the first of all numbers."""
        return len(self.noise) + len(self.prior.mean)

    @cached_property
    def groups(self) -> list[tuple[int, SpreadTable, list[int]]]:
        """Edges of one photograph that are nearly parallel, either side bright: the photograph, their table, and numbers."""
        reach_px = max(float(np.abs(of.distance_px).max()) for of in self.profiles)
        reach_um = self.optics.pitch_um * np.ceil((reach_px + MOST_SHIFT_PX) / 8) * 8
        tables: list[SpreadTable] = []
        groups: dict[tuple[int, int], list[int]] = {}
        for j, (of, depth) in enumerate(zip(self.profiles, self.depths, strict=True)):
            apart = [abs(np.sin(of.azimuth - table.azimuth)) for table in tables]
            if min(apart, default=1.0) > ALIKE_RAD:
                apart.append(0.0)
                azimuth = float(np.round(of.azimuth / ALIKE_RAD)) * ALIKE_RAD
                tables.append(SpreadTable(self.optics, azimuth, reach_um))
            groups.setdefault((depth, int(np.argmin(apart))), []).append(j)
        return [(depth, tables[k], members) for (depth, k), members in groups.items()]

    def start(self, defoci: Floats, modes: Floats) -> Floats:
        """Return all numbers, those of the edges as their profiles have them."""
        own = [[0.0, of.near, of.far, of.light_per_px] for of in self.profiles]
        return np.concatenate([defoci, modes, np.ravel(own)])

    def means(self, numbers: Floats) -> Iterator[tuple[int, Floats, Floats, Indices]]:
        """Yield each edge with its mean counts (bins,), slopes (numbers, bins), and places (numbers,) of these."""
        modes = np.arange(len(self.noise), self.lens)
        pitch_um = self.optics.pitch_um
        for depth, table, members in self.groups:
            own = [self.lens + NUISANCES * j + np.arange(NUISANCES) for j in members]
            waves = np.append(depth, modes)
            away = [
                self.profiles[j].distance_px - numbers[at[0]]
                for j, at in zip(members, own, strict=True)
            ]
            turns = [self.profiles[j].azimuth - table.azimuth for j in members]
            signs = np.sign(np.cos(turns))
            backwards = [sign * r * pitch_um for sign, r in zip(signs, away, strict=True)]
            rows = table.read(numbers[waves], np.concatenate(backwards))
            every = np.split(rows, np.cumsum([of.size for of in away])[:-1], axis=1)
            for j, at, r, turn, sign, read in zip(
                members, own, away, turns, signs, every, strict=True
            ):
                # an edge with its other side bright is the same one read backwards
                step, line, *slopes_by_waves, turning = read
                step = step + np.arcsin(sign * np.sin(turn)) * turning
                step = 0.5 + sign * (step - 0.5)
                by_waves = sign * np.array(slopes_by_waves)
                _, near, far, sloped = numbers[at]
                light = 1 + sloped * r
                dark = near + (far - near) * step
                by_shift = -(far - near) * line * pitch_um * light - dark * sloped
                slopes = [
                    *((far - near) * light * by_waves),
                    by_shift,
                    (1 - step) * light,
                    step * light,
                    dark * r,
                ]
                yield j, dark * light, np.array(slopes), np.append(waves, at)

    def scored(self, numbers: Floats) -> _End:
        """Return the fit at some numbers."""
        size = len(numbers)
        gradient = np.zeros(size)
        normal = np.zeros((size, size))
        chi2 = np.zeros(len(self.profiles))
        left = np.zeros(len(self.profiles))
        within = np.zeros(len(self.profiles))
        for j, mean, slopes, at in self.means(numbers):
            of = self.profiles[j]
            gain, read = self.noise[self.depths[j]]
            variance = gain * np.maximum(of.counts, 0) + read
            weight = of.number / variance
            off = of.counts - mean
            gradient[at] += slopes @ (weight * off)
            normal[np.ix_(at, at)] += (slopes * weight) @ slopes.T
            chi2[j] = float(weight @ off**2)
            within[j] = float(np.sum(of.scatter / variance))
            beyond = of.number @ off**2 - variance.sum()
            left[j] = np.sqrt(max(beyond, 0.0) / of.number.sum()) / abs(of.far - of.near)
        known = slice(len(self.noise), self.lens)
        away = numbers[known] - self.prior.mean
        gradient[known] -= self.prior.precision @ away
        normal[known, known] += self.prior.precision
        return _End(
            self,
            numbers,
            chi2,
            within,
            left,
            float(away @ self.prior.precision @ away),
            gradient,
            normal,
        )

    def climbed(self, end: _End, steps: int) -> _End:
        """Return the fit after some damped steps of Gauss and Newton, fewer if they become small."""
        damping = 0.0
        for _ in range(steps):
            for _ in range(DAMPED):
                normal = end.normal + damping * np.diag(np.diag(end.normal))
                change = np.linalg.solve(normal, end.gradient)
                waves = change[: self.lens]
                change = change * min(
                    1.0, MOST_WAVES / max(float(np.abs(waves).max()), 1e-12)
                )
                after = self.scored(end.numbers + change)
                if after.objective < end.objective:
                    break
                damping = max(10 * damping, 1e-3)
            else:
                return end
            small = float(change @ end.normal @ change) < SETTLED_PLACE**2
            end = after
            damping /= 10
            if small:
                break
        return end


@dataclass(frozen=True, eq=False)
class _End:
    """A fit at some numbers.

    Attributes
    ----------
    chi2, within : (edges,) of bins, and of pixels about their bins
    left : (edges,) residuals that bins share, over the step
    prior : chi-squared of the modes
    gradient, normal : of half of all chi-squared
    """

    edges: _Edges
    numbers: Floats
    chi2: Floats
    within: Floats
    left: Floats
    prior: float
    gradient: Floats
    normal: Floats

    @property
    def objective(self) -> float:
        """Chi-squared, the prior's included."""
        return float(self.chi2.sum()) + self.prior

    @property
    def covariance(self) -> Floats:
        """Covariance of all numbers, enlarged where bins scatter about the model by more than noise."""
        return np.asarray(np.linalg.inv(self.normal) * max(self.scatter, 1.0))

    @property
    def scatter(self) -> float:
        """Chi-squared of the bins over their degrees of freedom."""
        bins = sum(of.counts.size for of in self.edges.profiles)
        return float(self.chi2.sum()) / max(bins - len(self.numbers), 1)

    @property
    def chi2_per_pixel(self) -> list[float]:
        """Chi-squared of each edge over its pixels."""
        pixels = [of.number.sum() for of in self.edges.profiles]
        return [float(of) for of in (self.chi2 + self.within) / pixels]


def _noise(profiles: Sequence[EdgeProfile], prior: NoisePrior) -> Floats:
    """Return gain and read variance (2,) by the scatter of pixels within bins, and the prior."""
    number, mean, scatter = (
        np.concatenate([getattr(of, name) for of in profiles])
        for name in ("number", "counts", "scatter")
    )
    used = number > 1
    freedom = number[used] - 1
    square = scatter[used] / freedom
    signal = np.maximum(mean[used], 0)
    logs = prior.centre
    for _ in range(NOISE_STEPS):
        slopes = np.exp(logs)[:, None] * np.stack([signal, np.ones_like(signal)])
        variance = slopes.sum(axis=0)
        relative = slopes / variance
        information = (relative * freedom / 2) @ relative.T + np.diag(prior.precision)
        score = (relative * freedom / 2) @ (square / variance - 1)
        change = np.linalg.solve(
            information, score - prior.precision * (logs - prior.centre)
        )
        logs = logs + np.clip(change, -1, 1)
    return np.exp(logs)


def _likeliest(edges: _Edges, law: Floats) -> _End:
    """Return the likeliest end of the joint fit over the patterns of signs."""
    ends = []
    noll = edges.optics.noll
    for defoci, astigmatism in _starts(edges, law):
        modes = edges.prior.mean.copy()
        for mode, waves in zip(ASTIGMATIC, astigmatism, strict=True):
            if mode in noll:
                modes[noll.index(mode) - 1] = waves
        ends.append(edges.climbed(edges.scored(edges.start(defoci, modes)), ROUGH_STEPS))
        # several ranges leave no second pattern that explains all widths
        if law.any() and ends[-1].scatter < EXPLAINED:
            break
    return edges.climbed(min(ends, key=lambda end: end.objective), MOST_FIT_STEPS)


def _starts(edges: _Edges, law: Floats) -> list[tuple[Floats, Floats]]:
    """Return defoci (depths,) and astigmatism (2,) of the likeliest patterns of signs, by the edges' widths."""
    own = np.array([likely_defocus(edges.optics, of.width_px) for of in edges.profiles])
    error = np.hypot(MODEL_WAVES, MODEL_SHARE * own)
    angle = np.array([of.azimuth for of in edges.profiles])
    depth = [*edges.depths]
    most = own.max() + np.ptp(law) + MODEL_WAVES
    trial = np.linspace(-most, most, START_STEPS)
    numbers = np.stack(np.meshgrid(trial, trial, trial, indexing="ij")).reshape(3, -1)
    # Noll 5 and 6 along an azimuth act as a defocus
    astigmatic = np.sqrt(0.5) * np.array([np.sin(2 * angle), np.cos(2 * angle)])
    rows = np.vstack([np.ones_like(angle), astigmatic])
    signed = law[depth] + numbers.T @ rows
    misfit = (((np.abs(signed) - own) / error) ** 2).sum(axis=1)
    misfit += (numbers[1:] ** 2).sum(axis=0) / FIELD_MODE_STD[2] ** 2
    if not law.any():  # of one photograph the reverse is the same
        misfit = np.where(numbers[0] < 0, np.inf, misfit)
    found: dict[bytes, tuple[Floats, Floats]] = {}
    for k in np.argsort(misfit):
        if len(found) == MOST_PATTERNS or misfit[k] > misfit.min() + UNLIKELY:
            break
        pattern = (signed[k] > 0).tobytes()
        offset = numbers[0, k]
        defoci = law + np.where(offset == 0, MODEL_WAVES, offset)
        found.setdefault(pattern, (defoci, numbers[1:, k]))
    return [*found.values()]
