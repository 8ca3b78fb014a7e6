"""One lens for a session: least squares over what its fits measure and what its plan states, with all their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.optimize import least_squares
from scipy.special import chdtrc

from labkit.analysis.lens_model import EXACT, GEOMETRY, OPEN, LensModel, Member, Stated
from labkit.estimation.errors import covariance_with_bias
from labkit.types import Floats

MODEL_FLOOR_WAVES = 2e-4  # RMS error beyond the bound of nine defocus values from an independent simulator
LEAST_MAGNIFICATION, MOST_MAGNIFICATION = 0.05, 20.0  # pupil magnifications that are tried
SIGNIFICANCE = 1e-4  # chance of a misfit as large, for all members together
CONTRADICTION = 1e-3  # chance of a chi2 as large, below which a law is given up
FEW = 0.25  # share of the members that are let go rather than a law
LOOSER: tuple[dict[str, bool], ...] = ({"paraxial": False}, {"shared": False}, {"paraxial": False, "shared": False})
MATERIAL_WAVES = 0.01  # RMS: what departs by less is no other optimum


@dataclass(frozen=True)
class LensFit:
    """A session's estimate. theta: (columns,); pull: (columns, rows) what the estimate moves by for each whitened row.

    Rows are those of the members one after another, whitened by `roots`, then the columns' prior values.
    residuals: (rows,) whitened. lean: (columns,) by which what the model of the members lacks would move it, where it
    lacks something.
    """

    model: LensModel
    theta: Floats
    covariance: Floats
    residuals: Floats
    jacobian: Floats
    roots: tuple[Floats, ...]
    lean: Floats | None = None

    @property
    def errors(self) -> Floats:
        """(columns, columns) covariance of all that is known to be uncertain."""
        return self.errors_of(np.eye(len(self.theta)))

    def errors_of(self, combinations: Floats) -> Floats:
        """(n, n) of combinations (n, columns) of the estimate."""
        noise = combinations @ self.covariance @ combinations.T * self.widening**2
        return noise if self.lean is None else covariance_with_bias(noise, combinations @ self.lean)

    def leaning(self, shifts: Sequence[Floats]) -> LensFit:
        """The same, where something would move what the members measure. shifts: (values,) of each.

        What they disagree by is then what they would after it: the shifts are no chance, and widen nothing.
        """
        whitened = [solve_triangular(root, of, lower=True) for root, of in zip(self.roots, shifts, strict=True)]
        rows = np.concatenate([*whitened, np.zeros(len(self.model.columns))])
        lean = self.covariance @ self.jacobian.T @ rows
        return replace(self, lean=lean, residuals=self.residuals + rows - self.jacobian @ lean)

    @property
    def chi2(self) -> float:
        return float(self.residuals @ self.residuals)

    @property
    def freedom(self) -> int:
        """Rows beyond columns; a column's prior value is a row where it is a measurement, and none where it says nothing."""
        rows, columns = self.jacobian.shape
        return int(rows - columns) - sum(c.kind in OPEN for c in self.model.columns)

    @property
    def typical(self) -> float:
        """chi2 for each degree of freedom."""
        return self.chi2 / self.freedom if self.freedom else 1.0

    @property
    def p_value(self) -> float:
        """Chance of a chi2 as large."""
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom else 1.0

    @property
    def widening(self) -> float:
        """By how much the errors must grow where the members disagree beyond chance; 1 where they do not."""
        return float(np.sqrt(self.typical)) if self.p_value < 1e-3 else 1.0

    def rows(self, k: int) -> slice:
        """Of member k."""
        sizes = [len(m.measured.values) for m in self.model.members]
        return slice(sum(sizes[:k]), sum(sizes[: k + 1]))

    def value(self, kind: str, *of: str | float) -> float:
        return float(self.theta[self.model.index(kind, *of)])

    def std(self, kind: str, *of: str | float) -> float:
        k = self.model.index(kind, *of)
        return float(np.sqrt(self.errors[k, k]))

    def posterior(self, k: int) -> tuple[Floats, Floats]:
        """What member k would measure by the whole session, in light as stated, and its covariance."""
        slope = self.model.jacobian(self.theta)[k]
        slope[:, self.model.index("wavelength", self.model.members[k].channel)] = 0.0
        return self.model.true(self.theta)[k], self.errors_of(slope)

    def misfit(self, k: int) -> float:
        """chi2 of member k against all others: as many degrees of freedom as it has values."""
        rows = self.rows(k)
        here, rest = self.jacobian[rows], self.residuals[rows]
        left = np.eye(len(rest)) - here @ self.covariance @ here.T
        values, vectors = np.linalg.eigh(left)
        kept = values > 1e-9  # the others say nothing of the rest
        return float(np.sum((vectors[:, kept].T @ rest) ** 2 / values[kept]))

    def contributions(self, gradient: Floats) -> dict[str, float]:
        """Standard errors of a combination (columns,) of the estimate, by source: photons, calibration, geometry, model."""
        pull = gradient @ self.covariance @ self.jacobian.T
        shares = dict.fromkeys(("photons", "calibration", "geometry", "model"), 0.0)
        for k, member in enumerate(self.model.members):
            here = solve_triangular(self.roots[k], pull[self.rows(k)], trans="T", lower=True)
            calibration = float(here @ member.measured.calibration @ here)
            poor = float(here @ member.measured.model @ here) if member.measured.model.size else 0.0
            shares["model"] += poor + float(MODEL_FLOOR_WAVES * here[member.measured.noll.index(4)]) ** 2
            shares["calibration"] += calibration
            shares["geometry"] += float(self.model.size_error(k) * here[-1]) ** 2
            shares["photons"] += float(here @ member.measured.covariance @ here) - calibration - poor
        prior = pull[-len(self.model.columns) :] ** 2
        shares["geometry"] += sum(
            share for share, c in zip(prior, self.model.columns, strict=True) if c.kind in (*GEOMETRY, "lateral colour")
        )
        shares["model"] += sum(
            share for share, c in zip(prior, self.model.columns, strict=True) if c.kind in ("wavelength", "cone")
        )
        total = sum(shares.values())
        shares["model"] += float(self.errors_of(gradient[None])[0, 0]) - total
        return {name: float(np.sqrt(max(share, 0.0))) for name, share in shares.items()}


def fit_session_lens(members: Sequence[Member], stated: Stated) -> tuple[list[int], LensFit]:
    """Members that do not belong to their session, worst first, and the session's estimate from the others.

    It is made under the strictest laws that the members do not contradict. A few that do are let go rather than a law; where
    many do, the laws of cone and scale are given up, or that modes are the same at all ranges, or both.
    """
    strict = fit_lens(members, stated)
    out, fit = outliers(strict)
    few = len(out) <= len(members) * FEW
    if len({m.stop for m in members}) < 2 or (few and fit.p_value >= CONTRADICTION):
        return out, fit
    others = [fit_lens(members, stated, **looser) for looser in LOOSER]
    fewest = next((fit for fit in others if fit.p_value >= CONTRADICTION), None)
    return outliers(fewest or min([strict, *others], key=lambda fit: fit.chi2))


def fit_lens(
    members: Sequence[Member],
    stated: Stated,
    *,
    shared: bool = True,
    paraxial: bool = True,
    extra_waves: float = 0.0,
) -> LensFit:
    """The session's estimate from its members, whose twins have been chosen; shared, paraxial: as `LensModel` has them.

    extra_waves: RMS, an error of every mode beyond the measured ones, for rough comparisons.
    """
    model = LensModel(tuple(members), stated, shared, paraxial)
    centre = np.array([c.value for c in model.columns])
    prior = np.array([max(c.std, EXACT * c.scale) for c in model.columns])
    scale = np.array([min(c.scale, p) for c, p in zip(model.columns, prior, strict=True)])
    roots = tuple(_root(m, extra_waves, model.size_error(k)) for k, m in enumerate(members))
    rows = _Rows.of(model, roots, centre, prior)
    solved = least_squares(
        rows.residuals,
        _start(model, centre),
        rows.slopes,
        x_scale=scale,
        bounds=_bounds(model, centre),
        xtol=1e-9,
        ftol=1e-9,
        gtol=1e-10,
    )
    jacobian = rows.slopes(solved.x)
    inverse = np.linalg.inv(np.linalg.qr(jacobian * scale, mode="r")) * scale[:, None]
    return LensFit(model, solved.x, inverse @ inverse.T, rows.residuals(solved.x), -jacobian, roots)


@dataclass(frozen=True)
class _Rows:
    """Members and prior values as whitened rows. whitening: (rows, rows) of the members'; centre, prior: (columns,)."""

    model: LensModel
    whitening: Floats
    measured: Floats
    centre: Floats
    prior: Floats

    @classmethod
    def of(cls, model: LensModel, roots: Sequence[Floats], centre: Floats, prior: Floats) -> _Rows:
        """roots: lower triangular, of the members' covariances."""
        whitening = block_diag(*(solve_triangular(root, np.eye(len(root)), lower=True) for root in roots))
        measured = np.concatenate([m.measured.values for m in model.members])
        return cls(model, whitening, measured, centre, prior)

    def residuals(self, theta: Floats) -> Floats:
        """(rows,) measured less predicted."""
        rest = self.whitening @ (self.measured - self.model.all_predicted(theta))
        return np.concatenate([rest, (self.centre - theta) / self.prior])

    def slopes(self, theta: Floats) -> Floats:
        """(rows, columns) of the residuals."""
        return -np.concatenate([self.whitening @ self.model.whole_jacobian(theta), np.diag(1 / self.prior)])


def outliers(fit: LensFit) -> tuple[list[int], LensFit]:
    """Members that do not belong to their session under its laws, worst first, and the fit without them.

    Judged by the others, whose own misfit is allowed for: real lenses keep no law to the last photon.
    """
    left, out = list(range(len(fit.model.members))), list[int]()
    while len(left) > 2:
        sizes = np.array([len(fit.model.members[k].measured.values) for k in range(len(left))])
        misfits = np.array([fit.misfit(k) for k in range(len(left))])
        worst = int(np.argmax(misfits / sizes))
        without = _like(fit, [m for k, m in enumerate(fit.model.members) if k != worst])
        typical = max(1.0, min(float(np.median(misfits / sizes)), without.typical))
        chance = chdtrc(sizes[worst], misfits[worst] / typical) * len(left)
        if chance > SIGNIFICANCE or _departure(without, fit.model.members[worst]) < MATERIAL_WAVES:
            break
        out.append(left.pop(worst))
        fit = without
    return out, fit


def belongs(fit: LensFit, member: Member) -> bool:
    """Whether a member that was not in it agrees with a session."""
    if member.channel not in fit.model.channels:
        return False
    whole = _like(fit, [*fit.model.members, member])
    last = len(fit.model.members)
    size = len(member.measured.values)
    chance = chdtrc(size, whole.misfit(last) / max(1.0, fit.typical))
    return bool(chance > SIGNIFICANCE or _departure(fit, member) < MATERIAL_WAVES)


def _departure(fit: LensFit, member: Member) -> float:
    """Of a member's modes from those that the others, of whom a fit is made, predict, waves RMS: from the mean of theirs where
    each has its own."""
    if member.channel not in fit.model.channels:
        return np.inf
    return float(np.linalg.norm(member.measured.waves - predict(fit, member)[: len(member.measured.noll)]))


def _like(fit: LensFit, members: Sequence[Member]) -> LensFit:
    """The estimate of other members under the same laws."""
    return fit_lens(members, fit.model.stated, shared=fit.model.shared, paraxial=fit.model.paraxial)


def predict(fit: LensFit, member: Member) -> Floats:
    """What a session predicts for a member of one of its channels that was not in it."""
    wider = LensModel((*fit.model.members, member), fit.model.stated, fit.model.shared, fit.model.paraxial)
    theta = np.array([c.value for c in wider.columns])
    known = {(c.kind, c.of): value for c, value in zip(fit.model.columns, fit.theta, strict=True)}
    for k, column in enumerate(wider.columns):
        theta[k] = known.get((column.kind, column.of), theta[k])
        if column.kind == "mode" and (column.kind, column.of) not in known:  # where each has its own: their mean
            channel, j = column.of[0], column.of[-1]
            alike = [of for kind, of in known if kind == "mode" and (of[0], of[-1]) == (channel, j)]
            theta[k] = np.mean([known["mode", of] for of in alike])
    return wider.predicted(theta)[-1]


def _root(member: Member, extra_waves: float, size_error: float) -> Floats:
    """Lower triangular, of a member's covariance."""
    covariance = member.measured.covariance.copy()
    noll = member.measured.noll
    modes = np.arange(len(noll))
    covariance[modes, modes] += extra_waves**2
    covariance[noll.index(4), noll.index(4)] += MODEL_FLOOR_WAVES**2
    covariance[-1, -1] += size_error**2
    return np.asarray(cholesky(covariance, lower=True))


def _start(model: LensModel, centre: Floats) -> Floats:
    """Best focus where each channel's defocus crosses zero; modes as measured on average."""
    theta = centre.copy()
    for channel in model.channels:
        of = [m for m in model.members if m.channel == channel]
        waves = np.array([m.measured.values[m.measured.noll.index(4)] for m in of])
        ranges = np.array([m.range_mm for m in of])
        theta[model.index("best focus", channel)] = crossing(ranges, waves, model.stated)
    for k, column in enumerate(model.columns):
        if column.kind == "mode":
            j = column.of[-1]
            seen = [m.measured.values[m.measured.noll.index(j)] for m in model.members if m.channel == column.of[0]]
            theta[k] = np.mean(seen)
    return theta


def crossing(ranges_mm: Floats, waves: Floats, stated: Stated) -> float:
    """Range of zero defocus: it is nearly a straight line over 1/(range - f), of a slope that the lens gives."""
    f, n = stated.focal_length.value, stated.f_number.value
    reference_mm = stated.reference_nm * 1e-6
    # of the image's distance f^2/(r - f) and the pupil's sagitta in it
    slope = -(f**2) / (8 * n**2 * np.sqrt(12) * reference_mm)
    inverse = np.mean(1 / (ranges_mm - f) - waves / slope)
    if len(set(ranges_mm.tolist())) > 1:
        fitted, offset = np.polyfit(1 / (ranges_mm - f), waves, 1)
        inverse = -offset / fitted if fitted < 0 else inverse
    low, high = 1 / (3 * ranges_mm.max() - f), 1 / max(ranges_mm.min() / 3 - f, 0.5 * f)
    return float(1 / np.clip(inverse, low, high) + f)


def _bounds(model: LensModel, centre: Floats) -> tuple[Floats, Floats]:
    low, high = np.full(len(centre), -np.inf), np.full(len(centre), np.inf)
    f = model.index(GEOMETRY[0])
    low[f], high[f] = 0.6 * centre[f], 1.3 * centre[f]
    n = model.index(GEOMETRY[1])
    low[n], high[n] = 0.5 * centre[n], 2 * centre[n]
    mp = model.index(GEOMETRY[2])
    low[mp], high[mp] = np.log(LEAST_MAGNIFICATION), np.log(MOST_MAGNIFICATION)
    for k, column in enumerate(model.columns):
        if column.kind == "best focus":
            low[k] = 1.05 * centre[f]
    return low, high


def turned(member: Member, signs: Floats) -> Member:
    """The twin of a member."""
    return replace(member, measured=member.measured.twin(signs))
