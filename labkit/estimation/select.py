"""Select the right optimum of each observation, its sign, and the observations that belong to the session.

Given the session's parameters, each observation is one discrete choice; given the choices, the parameters follow by least
squares. Coordinate ascent alternates between the two: the penalised log-likelihood never falls.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import (
    Candidate,
    Measured,
    Observed,
    Reading,
    poor_model,
)
from labkit.estimation.focus_line import crossing, focus_slope
from labkit.estimation.laws import Laws
from labkit.estimation.lens_fit import (
    LensFit,
    Measurements,
    fit_families,
    fit_lens,
)
from labkit.estimation.lens_model import LensModel
from labkit.estimation.mistakes import possible_mistakes, with_mistakes
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.estimation.tilted_target import foreshortenings
from labkit.key import Key
from labkit.types import Bools, Floats, Indices

OUT = -1

UNFINISHED = SETTINGS.converged_stds**2
"""Log-likelihood that climbs of the selection may leave, twice over: the chosen lens is fitted again, to its end."""

SAME_MISFIT = 1e-9
"""Difference of misfits by rounding: of signs that fit alike, the first are chosen."""


@dataclass(frozen=True)
class Options:
    """All candidates of n observations and their twins, padded to the same number.

    Attributes
    ----------
    values : (n, options, values)
    covariance : (n, options, values, values)
    gain : (n, options) log-likelihood relative to the observation's best candidate; -inf for padding
    cost : (n,) penalty, in log-likelihood, for leaving an observation out
    foreshortening : (n, options, 2), see `Measured`; 0 where the model has the target's tilt
    """

    values: Floats
    covariance: Floats
    gain: Floats
    cost: Floats
    foreshortening: Floats

    @property
    def fitted(self) -> Bools:
        """(n,) whether the observation has a candidate."""
        return np.asarray(np.isfinite(self.gain).any(axis=1), bool)

    @classmethod
    def of(cls, observed: Sequence[Observed], model: LensModel) -> Options:
        """Stack all candidates, with the values of the model's observations."""
        size = model.values
        most = 2 * max(len(one.candidates) for one in observed)
        n = len(observed)
        options = cls(
            np.zeros((n, most, size)),
            np.broadcast_to(np.eye(size), (n, most, size, size)).copy(),
            np.full((n, most), -np.inf),
            np.full(n, SETTINGS.outlier_cost),
            np.zeros((n, most, 2)),
        )
        growth = SETTINGS.poor_errors**2 if poor_model(observed) else 1.0
        for k, one in enumerate(observed):
            best = max((c.log_likelihood for c in one.candidates), default=0.0)
            for choice in range(2 * len(one.candidates)):
                candidate = one.candidate(choice)
                at = (k, choice)
                measured = candidate.measured.labelled(model.parts)
                options.values[at] = measured.values
                options.covariance[at] = measured.covariance
                options.covariance[at] *= 1.0 if candidate.explained else growth
                options.gain[at] = candidate.log_likelihood - best
                if not model.field_order:
                    options.foreshortening[at] = measured.foreshortening
        return options


@dataclass(frozen=True)
class Selection:
    """The choice for every observation, and the resulting lens.

    Attributes
    ----------
    observed : all observations
    choice : (n,) 2 k for candidate k of an observation, 2 k + 1 for its twin, -1 without a candidate
    members : (n,) whether the observation belongs to the session
    lens : the session's estimate from the members
    objective : penalised log-likelihood of the choice
    """

    observed: tuple[Observed, ...]
    choice: Indices
    members: Bools
    lens: LensFit
    objective: float
    _choices: _Choices = field(repr=False)

    @cached_property
    def open_signs(self) -> Bools:
        """(n,) whether the ranges leave open which of two twins an observation has.

        The test fits a lens for each change of signs, so it is made only if it is asked for.
        """
        return _open_signs(self._choices, self.choice, self.members, self.objective)

    @cached_property
    def turned(self) -> LensFit | None:
        """The lens with the other sign of all members, if the ranges leave it open; it predicts all others otherwise."""
        other = np.where(self.members, self.choice ^ 1, self.choice)
        lens, value = self._choices.fit(other, self.members)
        return lens if value > self.objective - SETTINGS.clear_gain else None

    @property
    def outliers(self) -> list[Key]:
        """Keys of fitted observations that do not belong to the session."""
        fitted = self.choice != OUT
        return [
            self.observed[k].reading.key for k in np.flatnonzero(fitted & ~self.members)
        ]

    def candidate(self, k: int) -> Candidate:
        """Return the chosen candidate of observation k, or its twin."""
        return self.observed[k].candidate(int(self.choice[k]))


@dataclass(frozen=True)
class _Choices:
    """The choice problem under one set of laws."""

    observed: tuple[Observed, ...]
    options: Options
    model: LensModel

    def measured(self, choice: Indices, members: Bools) -> Measurements:
        """Return the chosen measurements; the parts of their covariances are left out, for no choice depends on them."""
        n = np.arange(len(choice))
        at = np.maximum(choice, 0)
        none = np.zeros_like(self.options.covariance[n, at])
        values = self.options.values[n, at].copy()
        values[:, -1] += self.options.foreshortening[n, at, 0]
        return Measurements(values, self.options.covariance[n, at], none, none, members)

    def fit(
        self, choice: Indices, members: Bools, start: Point | None = None
    ) -> tuple[LensFit, float]:
        """Estimate the lens of a choice; return the lens and the penalised log-likelihood."""
        measured = self.measured(choice, members)
        lens = fit_lens(self.model, measured, start, SETTINGS.converged_stds)
        n = np.flatnonzero(members)
        gained = float(
            self.options.gain[n, choice[n]].sum()
        ) + 0.5 * self.model.values * len(n)
        left_out = self.options.fitted & ~members
        return lens, gained - 0.5 * lens.chi2 - float(self.options.cost[left_out].sum())

    def occam(self, choice: Indices, members: Bools) -> float:
        """Return the Occam factor: log-likelihood that members lose because the laws are looser than the strictest.

        The rarity of mistakes is included.
        """
        noise = self.options.covariance[np.flatnonzero(members), choice[members]]
        strict = replace(self.model, laws=Laws().rough()).scatter()
        spread = np.linalg.slogdet(noise + np.diag(self.model.scatter()))[1]
        scattered = float(np.sum(spread - np.linalg.slogdet(noise + np.diag(strict))[1]))
        rare = -np.log(SETTINGS.mistake_odds) if self.model.laws.mistaken else 0.0
        return 0.5 * scattered + float(rare)

    def ascend(
        self, choice: Indices, members: Bools, start: Point | None = None
    ) -> tuple[Indices, Bools, LensFit, float]:
        """Change choices while the penalised log-likelihood rises.

        In each round every group of observations changes its most promising choice. If all changes together do not raise the
        objective, the most promising changes are tried alone.
        """
        lens, value = self.fit(choice, members, start)
        while True:
            wanted, promise = self._proposals(lens, choice, members)
            for places in self._batches(promise):
                changed = choice.copy()
                inside = members.copy()
                inside[places] = wanted[places] != OUT
                changed[places] = np.where(inside[places], wanted[places], choice[places])
                if not inside.any():
                    continue
                trial, reached = self.fit(changed, inside, start)
                if reached > value + UNFINISHED:
                    choice = changed
                    members = inside
                    lens = trial
                    value = reached
                    break
            else:
                break
        return choice, members, lens, value

    def _batches(self, promise: Floats) -> Iterator[Indices]:
        """Yield observations to change: the most promising of each group at once, then single ones by promise."""
        order = np.argsort(-promise)
        order = order[promise[order] > 0]
        _, first = np.unique(self.model.groups[order], return_index=True)
        best = order[np.sort(first)]
        if len(best) > 1:
            yield best
        yield from (order[k : k + 1] for k in range(min(len(order), 8)))

    def _proposals(
        self, lens: LensFit, choice: Indices, members: Bools
    ) -> tuple[Indices, Floats]:
        """Return the best option of each observation, (n,), by leave-one-out prediction, and its promised gain, (n,)."""
        predicted, covariance = lens.predictions
        rest = self.options.values - predicted[:, None]
        rest[..., -1] += self.options.foreshortening[..., 0]
        chi2 = np.empty_like(self.options.gain)
        for at in range(chi2.shape[1]):
            noise = self.options.covariance[:, at] + covariance
            chi2[:, at] = np.einsum(
                "nv,nv->n",
                rest[:, at],
                np.linalg.solve(noise, rest[:, at, :, None])[..., 0],
            )
        net_gain = self.options.gain - 0.5 * (chi2 - self.model.values)
        best = np.argmax(net_gain, axis=1)
        n = np.arange(len(best))
        stays = np.where(members, net_gain[n, np.maximum(choice, 0)], -self.options.cost)
        inside = net_gain[n, best] >= -self.options.cost
        wanted = np.where(inside, best, OUT)
        promise = np.maximum(net_gain[n, best], -self.options.cost) - stays
        promise[~self.options.fitted] = 0.0
        same = np.where(members, wanted == choice, wanted == OUT)
        return wanted, np.where(same, 0.0, promise)


def select(
    observed: Sequence[Observed], stated: Stated, *, everyone: bool = False
) -> Selection:
    """Choose candidate, sign and membership of every observation, and estimate the lens.

    Parameters
    ----------
    observed : observations of known range with their candidates; observations without candidates are predicted
    stated : the plan's numbers
    everyone : whether all observations belong under the strictest laws, at any cost

    Returns
    -------
    The likeliest choice. Laws that members contradict beyond chance are loosened if the evidence favours looser laws.

    Raises
    ------
    ValueError : no observation has a candidate, or two observations have the same key
    """
    observed = tuple(observed)
    known = [candidate.measured for one in observed for candidate in one.candidates]
    if not known:
        raise ValueError("no observation has a candidate: there is nothing to select from")
    parts = tuple(dict.fromkeys(label for one in known for label in one.parts))
    readings = tuple(one.reading for one in observed)
    model = LensModel(readings, known[0].noll, parts, stated)
    options = Options.of(observed, model)
    if everyone:
        options.cost[:] = np.inf
    strict = _Choices(observed, options, replace(model, laws=Laws().rough()))
    start = _started(strict)
    ends = [(strict, *strict.ascend(*start))]
    left_out = options.fitted & ~ends[0][2]
    if np.count_nonzero(left_out) > SETTINGS.few * np.count_nonzero(options.fitted):
        mistakes = possible_mistakes(model.channels)
        for laws in [*_looser(observed), *(Laws(mistaken=one) for one in mistakes)]:
            one = replace(strict, model=replace(model, laws=laws.rough()))
            ends.append((one, *one.ascend(*start)))
    choices, choice, members, _, value = max(
        ends, key=lambda end: end[4] - end[0].occam(end[1], end[2])
    )
    chosen = [
        None if at == OUT else one.candidate(int(at)).measured
        for one, at in zip(observed, choice, strict=True)
    ]
    lens = exact_lens(readings, chosen, members, stated, laws=Laws() if everyone else None)
    return Selection(observed, choice, members, lens, value, choices)


def _looser(observed: Sequence[Observed]) -> list[Laws]:
    """Return laws to try in place of the strictest; defocus leaves its law only if the model is incomplete for all."""
    if poor_model(observed):
        return [*Laws.looser(), Laws.loosest()]
    return [
        laws for laws in Laws.looser() if laws.defocus_scatter == Laws().defocus_scatter
    ]


def exact_lens(
    readings: Sequence[Reading],
    chosen: Sequence[Measured | None],
    members: Bools,
    stated: Stated,
    *,
    laws: Laws | None = None,
    weak: Mapping[int, float] | None = None,
) -> LensFit:
    """Estimate the lens under given laws, or under the strictest laws that the measurements do not contradict.

    Parameters
    ----------
    readings : rail positions of n observations
    chosen : measurement of each, None if there is none
    members : (n,) whether the observation counts
    stated : the plan's numbers
    laws : tolerances of the laws; None to choose them
    weak : standard deviations of weak modes, see `LensModel`
    """
    known = [one for one in chosen if one is not None]
    parts = tuple(dict.fromkeys(label for one in known for label in one.parts))
    noll = known[0].noll
    model = LensModel(tuple(readings), noll, parts, stated, laws or Laws(), weak=weak or {})
    n, size = len(readings), model.values
    values = np.zeros((n, size))
    tilts = foreshortenings(readings, chosen, members, tiled=model.field_order > 0)
    covariance = np.broadcast_to(np.eye(size), (n, size, size)).copy()
    calibration = np.zeros((n, size, size))
    surplus = np.zeros((n, size, size))
    for k, one in enumerate(chosen):
        if one is not None:
            one = one.labelled(parts)
            values[k] = one.values
            covariance[k] = one.covariance
            calibration[k] = one.calibration
            surplus[k] = one.model
    common = _common_tilt(tilts[members])
    tilt, tilt_std = common or (tilts[:, 0], 0.0)
    values[:, -1] += tilt
    if common is None:
        covariance[:, -1, -1] += tilts[:, 1] ** 2
    measured = Measurements(values, covariance, calibration, surplus, members)
    lens = fit_families(replace(model, tilt_std=tilt_std), measured)
    model = lens.model
    stations = {
        one.station for one, member in zip(readings, members, strict=True) if member
    }
    if (
        laws is not None
        or lens.p_value >= SETTINGS.contradiction_chance
        or len(stations) < 2
    ):
        return lens
    fits = [
        fit_lens(replace(model, laws=one), measured, lens.solved.point)
        for one in Laws.looser()
    ]
    likeliest = max([lens, *fits], key=lambda fit: fit.log_evidence)
    mistaken = max(with_mistakes(lens), key=lambda fit: fit.log_evidence)
    gain = mistaken.log_evidence - likeliest.log_evidence
    return mistaken if gain > -np.log(SETTINGS.mistake_odds) else likeliest


def lens_of(measured: Mapping[int, Measured], like: LensFit) -> LensFit:
    """Return the lens of new measurements of an earlier lens's members, by their rows, under the earlier lens's laws."""
    model = like.model
    chosen = [measured.get(row) for row in range(len(model.readings))]
    members = like.measured.used
    return exact_lens(
        model.readings, chosen, members, model.stated, laws=model.laws, weak=model.weak
    )


def _common_tilt(tilts: Floats) -> tuple[float, float] | None:
    """Return the most precise of m foreshortenings, (m, 2), if all agree, else None."""
    best, error = min(tilts.tolist(), key=lambda tilt: tilt[1])
    misfit = float(
        np.sum(
            (tilts[:, 0] - best) ** 2
            / (tilts[:, 1] ** 2 + error**2 + SETTINGS.size_floor**2)
        )
    )
    return (
        (best, error)
        if chdtrc(len(tilts), misfit) > SETTINGS.contradiction_chance
        else None
    )


def _started(choices: _Choices) -> tuple[Indices, Bools]:
    """Return a start: each observation's likeliest candidate with the sign that the ranges favour."""
    fitted = choices.options.fitted
    groups = choices.model.groups
    choice = np.where(fitted, np.argmax(choices.options.gain, axis=1), OUT)
    every = [np.flatnonzero(fitted & (groups == one)) for one in np.unique(groups[fitted])]
    known = list[Floats]()
    for places in sorted(every, key=lambda part: -part.size):
        like = np.median(known, axis=0) if known else None
        choice[places] += _signs(choices, places, choice, like)
        values = choices.options.values[places, choice[places]]
        known.append(np.median(values, axis=0))
    return choice, fitted


def _signs(
    choices: _Choices, places: Indices, choice: Indices, like: Floats | None
) -> Indices:
    """Choose signs, (m,), of one group's observations: 0 for the candidate, 1 for its twin.

    Over range, defocus changes from negative to positive once: the first k of m ranges are negative. Every k is compared
    with the slope of defocus over range, with constancy of the other modes, and with `like`, the usual values of other groups.
    """
    model = choices.model
    ranges = np.array([choices.observed[k].reading.range_mm for k in places])
    both = choices.options.values[
        places[:, None], choice[places][:, None] + [0, 1]
    ]  # each candidate and its twin
    positive = both[:, 0, model.defocus] < 0
    rank = np.argsort(np.argsort(ranges, kind="stable"))
    signs = np.asarray(
        positive ^ (rank < np.arange(len(places) + 1)[:, None]), np.intp
    )  # (k, m)
    costs = _misfits(model, ranges, both[np.arange(len(places)), signs], like)
    return np.asarray(signs[np.flatnonzero(costs < costs.min() + SAME_MISFIT)[0]])


def _misfits(
    model: LensModel, ranges: Floats, values: Floats, like: Floats | None
) -> Floats:
    """Return an approximate chi2 (k,) of a group's values (k, m, values) under the law of defocus and constant other modes.

    Large misfits count by their logarithm, as in Student's t (K. L. Lange et al., J. Am. Stat. Assoc. 84, 881 (1989)): one
    wrong optimum must not decide the signs of all others.
    """
    focus = crossing(ranges, values[..., model.defocus], model)[:, None]
    focal_mm = model.stated.focal_length.value
    line = focus_slope(model) * (1 / (ranges - focal_mm) - 1 / (focus - focal_mm))
    rough = SETTINGS.mode_scatter_waves[0]
    slack = rough**2 + (0.1 * line) ** 2  # the slope is known to some 6 %
    upper = np.flatnonzero(np.arange(len(model.noll)) != model.defocus)
    modes = values[..., upper]
    cost = (values[..., model.defocus] - line) ** 2 / slack
    cost += np.sum((modes - np.median(modes, axis=1)[:, None]) ** 2, axis=2) / rough**2
    if like is not None:
        away = np.sum((modes - like[upper]) ** 2, axis=2)
        cost += away / SETTINGS.colour_modes_std**2
    numbers = model.values
    return np.asarray(numbers * np.sum(np.log1p(cost / numbers), axis=1))


def _open_signs(choices: _Choices, choice: Indices, members: Bools, value: float) -> Bools:
    """Return which observations have the other sign in a choice that is hardly less likely; outliers always count."""
    found = choices.options.fitted & ~members
    for turned in _other_signs(choices, choice, members):
        if found[turned].all():
            continue
        other = choice.copy()
        other[turned] ^= 1
        if choices.fit(other, members)[1] > value - SETTINGS.clear_gain:
            found[turned] = True
    return found


def _other_signs(choices: _Choices, choice: Indices, members: Bools) -> Iterator[Indices]:
    """Yield members to turn together: all, those of one station, and of each channel as many as its law of defocus allows.

    Over range, defocus changes from negative to positive once. Of tiles, all turn together: the field determines the rest.
    """
    every = np.flatnonzero(members)
    readings = [one.reading for one in choices.observed]
    yield every
    if choices.model.tiled:
        return
    for station in dict.fromkeys(readings[k].station for k in every):
        yield np.array([k for k in every if readings[k].station == station])
    for channel in choices.model.channels:
        of = [k for k in every if readings[k].key.channel == channel]
        of.sort(key=lambda k: readings[k].range_mm)
        below = choices.options.values[of, choice[of], choices.model.defocus] < 0
        for negative in range(len(of) + 1):
            turned = np.array(of)[(np.arange(len(of)) < negative) != below]
            if turned.size:
                yield turned
