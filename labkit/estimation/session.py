"""The session's estimate, one loop: select, predict, refit observations that are badly predicted, until nothing changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.errors import FitError
from labkit.estimation.camera import CameraChoice, Parts
from labkit.estimation.candidate import poor_model
from labkit.estimation.estimate import Estimate, LocalFit, is_ranged, observed
from labkit.estimation.first_fits import (
    anchors,
    beside,
    best_predicted,
    clearest,
    confirmed,
    first_of,
    in_other_colour,
    known_poses,
    nearest_fitted,
    spread,
    telling,
    wrong_near_focus,
)
from labkit.estimation.laws import Laws
from labkit.estimation.lens_fit import fit_lens, predicted_by_other_stations
from labkit.estimation.local import Found, Guesses, Optimum
from labkit.estimation.observation import Observation
from labkit.estimation.refits import Refits, with_tests
from labkit.estimation.searches import Searches
from labkit.estimation.select import OUT, Selection, select
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated, nominal_f_number, optics_of, wanted_parts
from labkit.estimation.stated_camera import StatedCamera
from labkit.estimation.strong import StrongSearch
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.imaging.warp import Pose
from labkit.jobs.execute import Run
from labkit.optics.field import field_terms
from labkit.plan import Plan
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.target.target import Target
from labkit.types import Floats, Progress


def estimate(
    observations: Sequence[Observation],
    plan: Plan,
    targets: Mapping[str, Target],
    run: Run,
    progress: Progress,
    patience_s: float = np.inf,
    plain: bool = False,
) -> Estimate:
    """Estimate every wavefront of a session, and the lens common to all.

    Parameters
    ----------
    observations : the session's, in order
    plan : lens, camera and target as stated
    targets : the target as shown to each channel
    run : maps the searches
    progress : called with the searches under way
    patience_s : processor time of one search, after which no start is made
    plain : whether camera parts that the plan does not state stay out of the model

    Raises
    ------
    FitError : no observation could be fitted
    """
    searches = Searches(list(observations), targets, run, progress)
    loop = _Loop(searches, plan, patience_s)
    loop.explore()
    return loop.ended(plain)


@dataclass
class _Loop:
    """State of the loop. Observations are named by their places in the session.

    Attributes
    ----------
    search : runs searches
    plan : the session's plan
    patience_s : processor time of one search
    found : optima of each observation, with the present parts in the model
    parts : camera parts and groups of modes in the model that the plan does not state
    anchors : observations searched from nothing
    starts : predictions from which each observation was climbed with the present parts
    expanded : observations whose likelihood was expanded about a prediction, with the parts in the model then
    deep : whether a search without limit was made
    first : optimum of each observation's first fit
    refits : refits from the present optima, with other parts and modes
    """

    search: Searches
    plan: Plan
    patience_s: float
    found: dict[int, Found] = field(default_factory=dict)
    parts: Parts = field(default_factory=Parts)
    anchors: list[int] = field(default_factory=list)
    starts: dict[int, list[Floats]] = field(default_factory=dict)
    expanded: set[tuple[int, Parts]] = field(default_factory=set)
    deep: bool = False
    first: dict[int, Optimum] = field(default_factory=dict)
    _selected: tuple[dict[int, Found], Selection | None] | None = None
    _parts_chosen_by: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.observations = self.search.observations
        self.stated = Stated.of(self.plan)
        places = range(len(self.observations))
        ranged = [k for k in places if is_ranged(self.observations[k], self.plan.fit.noll)]
        self.rows = {k: row for row, k in enumerate(ranged)}
        self.alone = len({self.observations[k].measured_range_mm for k in self.rows}) < 2
        self.nominal_f_number = nominal_f_number(self.plan, self.search.ranges_mm)
        self.refits = Refits(self.search, self.plan)
        channels = [o.channel for o in self.observations]
        wanted = Parts(wanted_parts(self.plan))
        self.camera = CameraChoice(self._with_parts, wanted, channels)

    @property
    def _noll(self) -> tuple[int, ...]:
        """Modes in the model."""
        optics = optics_of(self.plan, self.observations[0].channel)
        return optics.with_parts(self.parts).noll

    @property
    def _camera_parts(self) -> Parts:
        """Camera parts in the model that the plan does not state."""
        return self.parts - MODE_GROUPS.keys()

    @property
    def _of_the_body(self) -> Parts:
        """Camera parts in the model that are not the pupil's: without these the lens would be another."""
        return Parts(one for one in self._camera_parts if not KNOWN[one].of_rim)

    # the loop

    def explore(self) -> None:
        """Fit until every observation has the predicted optimum, or was climbed from the prediction.

        Camera parts and modes are chosen once no fit can gain, since a wrong optimum calls for parts that are not there. If the
        anchors call for parts, the other fits have these from the start.
        """
        choosing = True
        while choosing:
            while guesses := self._next():
                self._fit(guesses)
                self._search_together()
                if len(self.found) == len(self.anchors) < len(self.observations):
                    self._choose_parts(telling(self.found))
                    self._forget(wrong_near_focus(self.found))
            choosing = self._choose_parts(spread(self.observations, self.found))

    def _next(self) -> dict[int, Guesses]:
        """Return the next fits by observation; none once no fit can gain."""
        left = [
            k
            for k, one in enumerate(self.observations)
            if k not in self.found and one.key.label not in self.search.lost
        ]
        if not self.found:
            self.anchors = anchors(self.observations, left) if left else []
            return dict.fromkeys(self.anchors, self._from_nothing(deep=False))
        if doubtful := self._undecided():
            return dict.fromkeys(doubtful, self._from_nothing(deep=True))
        selection = self.selection()
        # a tile at a wrong optimum would lead its neighbours astray
        mends = not left or self.observations[0].tile is not None
        if selection is not None and mends and (refits := self._badly_predicted(selection)):
            return refits
        return self._predicted(left, selection)

    def _undecided(self) -> list[int]:
        """Return the anchors if none is explained or confirmed by the others; none after a search without limit."""
        if (
            self.deep
            or len(self.found) > len(self.anchors)
            or any(found.best.verdict.accepted for found in self.found.values())
            or confirmed(self.found, self.selection())
        ):
            return []
        return list(self.found)

    def _from_nothing(self, *, deep: bool) -> Guesses:
        cone = self.nominal_f_number
        return Guesses(
            cone.std / cone.value,
            deep=deep or self.alone,
            alone=self.alone,
            patience_s=self.patience_s,
        )

    def _predicted(
        self, left: Sequence[int], selection: Selection | None
    ) -> dict[int, Guesses]:
        """Return first fits: from the prediction if it is sure; else the clearest of each channel.

        Far from focus the right optimum is clear. Near focus wrong optima are close, and a fit starts from the prediction. Of
        tiles, the clearest next to fitted ones begin from their wavefront, as many at once as the field's expansion has terms.
        While the anchors leave their sign open, no prediction is sure, and that observation comes first which both signs
        predict far from focus.
        """
        if selection is None:
            waves = first_of(self.found).waves
            return {k: self._guess(self._beside(k), (waves,)) for k in left}
        predicted, covariance = selection.lens.predictions
        modes, at = len(self._noll), selection.lens.model.defocus
        guesses = dict[int, Guesses]()
        stds, defocus = dict[int, float](), dict[int, float]()
        turned = selection.turned if len(self.found) <= len(self.anchors) else None
        other = predicted if turned is None else turned.predictions[0]
        for k in left:
            if (row := self.rows.get(k)) is None:
                guesses[k] = self._guess(modes=(first_of(self.found).waves,))
                continue
            waves = predicted[row, :modes]
            unsure = at if self.observations[k].tile is None else np.arange(modes)
            stds[k] = float(np.sqrt(np.diag(covariance[row])[unsure].sum()))
            if stds[k] < SETTINGS.sure_waves and turned is None:
                poses = known_poses(self.observations, self.found, k)
                guesses[k] = self._guess(starts=(waves,), poses=poses)
            else:
                defocus[k] = min(abs(float(waves[at])), abs(float(other[row, at])))
        stds = {k: stds[k] for k in clearest(self.observations, defocus)}
        terms = len(field_terms(selection.lens.model.field_order))
        for k in best_predicted(self.observations, self.found, stds, terms):
            known = self._beside(k)
            colour = in_other_colour(self.observations, self._fits, k)
            likely = colour.waves if colour else predicted[self.rows[k], :modes]
            guesses[k] = self._guess(starts=known, modes=known or (likely,))
        return guesses

    def _beside(self, k: int) -> tuple[Floats, ...]:
        """Return the wavefront of the nearest fitted tile; none without tiles."""
        nearest = nearest_fitted(self.observations, self.found, k)
        return () if nearest is None else (self.chosen(nearest).waves,)

    def _badly_predicted(self, selection: Selection) -> dict[int, Guesses]:
        """Return refits from the prediction of all others: of outliers, and of members with unexplained residuals.

        A fit that left its prediction is expanded about it: near focus, optima may be far from the truth.

        If modes differ from range to range, every fit is tried with the modes of other ranges, and the likelihood decides.
        If the model is incomplete for all, modes differ for that reason, and no member is refitted.
        Outliers are refitted from the predictions of both signs if the members leave their sign open, and at least once from a
        prediction: their wavefront may be alike, and their pupil not.
        """
        lens = selection.lens
        predicted, _ = lens.predictions
        if not lens.model.laws.shared:
            strict = fit_lens(replace(lens.model, laws=Laws()), lens.measured)
            predicted = predicted_by_other_stations(strict)
        doubted = dict[int, Guesses]()
        poor = poor_model(selection.observed)
        anyone = not poor and any(
            found.best.verdict.accepted for found in self.found.values()
        )
        for k, row in self.rows.items():
            if k not in self.found or selection.choice[row] == OUT:
                continue
            candidate = selection.candidate(row)
            inside = bool(selection.members[row])
            waves = predicted[row, : len(self._noll)]
            away = float(np.linalg.norm(candidate.measured.waves - waves))
            untried = not inside and not self.starts.get(k)
            far = untried or away > SETTINGS.other_optimum_waves
            doubtful = not inside or (anyone and not candidate.explained)
            doubtful = doubtful or not (selection.lens.model.laws.shared or poor)
            if not (far and doubtful):
                continue
            ways = [waves]
            if not inside and selection.turned is not None:
                ways.append(selection.turned.predictions[0][row, : len(self._noll)])
            if new := [one for one in ways if self._new(k, one)]:
                poses = known_poses(self.observations, self.found, k)
                doubted[k] = self._guess(starts=tuple(new), poses=poses)
            elif (k, self.parts) not in self.expanded:
                state = replace(self.chosen(k).state, waves=waves)
                doubted[k] = replace(self._guess(), state=state, held=True)
        return doubted

    def _new(self, k: int, waves: Floats) -> bool:
        """Return whether no climb of an observation began near a wavefront, and further climbs are allowed."""
        before = self.starts.get(k, [])
        far = all(
            np.linalg.norm(waves[: one.size] - one[: waves.size])
            > SETTINGS.other_optimum_waves
            for one in before
        )
        return far and len(before) < SETTINGS.tried

    def _guess(
        self,
        starts: tuple[Floats, ...] = (),
        modes: tuple[Floats, ...] = (),
        poses: tuple[Pose, ...] = (),
    ) -> Guesses:
        unknown = self._from_nothing(deep=False)
        known = first_of(self.found).verdict.accepted
        f_number_std = SETTINGS.shared_f_number_std if known else unknown.f_number_std
        return replace(
            unknown,
            f_number_std=f_number_std,
            starts=starts,
            poses=poses,
            modes=modes,
            known=known,
        )

    # fits

    def _fit(self, guesses: Mapping[int, Guesses]) -> None:
        """Run searches, and add the optima."""
        selection = self.selection() if self.found else None
        wanted = dict[int, tuple[Optics, Guesses]]()
        for k, guess in guesses.items():
            optics = self._optics(k, selection)
            colour = in_other_colour(self.observations, self._fits, k)
            if guess.modes and colour:
                optics = optics.with_rim_of(colour.optics)
            if selection is not None and not (optics.rim.is_round or guess.held):
                likened = beside(self.observations, self.rows, selection, k, optics)
                guess = replace(guess, beside=likened)
            wanted[k] = optics, with_tests(guess, optics, self.plan)
        blind = not any(g.state or g.starts or g.modes for g in guesses.values())
        doing = "searching from nothing" if blind else "fitting"
        self.search.later = None if blind else self._to_come()
        for k, found in self.search(wanted, doing).items():
            self.first.setdefault(k, found.best)
            self.found[k] = self.found[k].joined(found) if k in self.found else found
        for k, guess in guesses.items():
            self.starts.setdefault(k, []).extend(guess.starts)
            if guess.held:
                self.expanded.add((k, self.parts))
            self.deep |= guess.deep

    def _optics(self, k: int, selection: Selection | None) -> Optics:
        """Return the optics where a climb begins: f-number and camera parts by the session's lens or by the clearest fit."""
        observation = self.observations[k]
        optics = optics_of(self.plan, observation.channel, observation.tile_place)
        optics = optics.with_parts(self.parts).begun()
        if not self.found:
            return replace(optics, f_number=self.nominal_f_number.value)
        if selection is not None and k in self.rows:
            predicted, _ = selection.lens.predictions
            numbers = predicted[self.rows[k], len(self._noll) : -1]
            return optics.with_named(selection.lens.model.parts, numbers)
        clearest = first_of(self.found).optics
        return optics.with_named(clearest.camera_labels, clearest.camera_parameters)

    def _search_together(self) -> None:
        """Search several stations at once, with all modes, if the anchors' optima contradict each other."""
        if self.deep or self._parts_chosen_by:
            return
        stronger = StrongSearch(self.search, self.refits, self.plan)(self.found, self.parts)
        if stronger is not None:
            self.parts, self.found = stronger
            self.anchors, self.deep = list(self.found), True

    def _forget(self, places: Sequence[int]) -> None:
        """Forget the fits of some anchors, which are then predicted as all other observations are."""
        self.anchors = [k for k in self.anchors if k not in places]
        self.found = {k: self.found[k] for k in self.found if k not in places}

    # choices

    def selection(self) -> Selection | None:
        """Return the choices for all observations of known range; None if none is fitted."""
        if self._selected is None or not _same(self._selected[0], self.found):
            self._selected = dict(self.found), self._select()
        return self._selected[1]

    def _select(self) -> Selection | None:
        every = [observed(self.observations[k], self.found.get(k)) for k in self.rows]
        fitted = any(one.candidates for one in every)
        return select(every, self.stated) if fitted else None

    @property
    def _fits(self) -> dict[int, Optimum]:
        """The chosen optima, in the order of the observations."""
        return {k: self.chosen(k) for k in sorted(self.found)}

    def chosen(self, k: int) -> Optimum:
        """Return the optimum of observation k, with the session's sign if the session decides it."""
        selection, found = self.selection(), self.found[k]
        row = self.rows.get(k)
        if selection is None or row is None or selection.choice[row] == OUT:
            return found.best.canonical()
        place, twin = divmod(int(selection.choice[row]), 2)
        optimum = found.determined[place]
        return optimum.twin() if twin else optimum

    # camera parts and groups of modes

    def _choose_parts(self, places: Sequence[int]) -> bool:
        """Adopt the camera parts and the modes that some fits show. Return whether the choice changed."""
        fits = {k: self.chosen(k) for k in places}
        asked = {k: fit.log_likelihood for k, fit in fits.items()}
        if not fits or asked == self._parts_chosen_by:
            return False
        self._parts_chosen_by = asked
        parts = self.camera.chosen(fits, self.parts)
        if parts == self.parts:
            return False
        refitted = dict(self.refits.made[parts])
        before, self.parts, self.starts = self.parts, parts, {}
        self.search.later = self._to_come()
        rest = {k: self.chosen(k) for k in self.found if k not in refitted}
        refitted |= self.refits(rest, before, parts)
        self.found = {k: replace(self.found[k], optima=(refitted[k],)) for k in refitted}
        return True

    def _with_parts(self, places: Sequence[int], parts: Parts) -> dict[int, Optimum]:
        """Refit from the present optima, with other camera parts and modes."""
        self.search.later = None
        return self.refits({k: self.chosen(k) for k in places}, self.parts, parts)

    def _to_come(self, *, bare: bool = True) -> int:
        """Return the number of steps after the fits: refits with the plan's camera (if `bare`), a joint climb's, results."""
        joint = any(self.chosen(k).optics.beyond_usual for k in self.found)
        each = (bare and bool(self._of_the_body)) + joint
        return len(self.observations) * each + 1

    # the end

    def ended(self, plain: bool) -> Estimate:
        """Return the estimate, and the session with the plan's camera: for comparison, or as the result if `plain`.

        A plain session has the plan's pupil too.
        """
        if not self.found:
            left_out = "; ".join(self.search.left_out)
            raise FitError(f"no wavefront could be fitted: {left_out}")
        whole = self._as_estimate()
        self.search.conclude(self._to_come())
        if not self._camera_parts:
            return self._asked(whole, self.camera.missing, self.camera.with_missing)
        without = self._camera_parts if plain else self._of_the_body
        stated = StatedCamera(self.refits, self._fits, self.parts, without)
        if not plain and not (without and stated.explains()):
            return self._asked(whole, (), {})
        self.search.later = self._to_come(bare=False)
        bare = stated.session(whole)
        if not plain:
            return replace(self._asked(whole, (), {}), stated_camera=bare)
        missing = (*self.camera.missing, *sorted(self._camera_parts))
        return self._asked(bare, missing, self._fits, adopted=False)

    def _asked(
        self,
        session: Estimate,
        missing: tuple[str, ...],
        full: Mapping[int, Optimum],
        adopted: bool = True,
    ) -> Estimate:
        """Return the estimate with the parts that its model lacks."""
        with_missing = tuple(full.get(k) for k in sorted(self.found))
        every = self.camera.tried
        tried = tuple(replace(one, adopted=one.adopted and adopted) for one in every)
        return replace(
            session,
            tried=tried,
            missing=missing,
            with_missing=with_missing if missing else (),
        )

    def _as_estimate(self) -> Estimate:
        selection = self.selection()
        places = sorted(self.found)
        fits = tuple(
            LocalFit(self.observations[k], self.chosen(k), self.found[k]) for k in places
        )
        lost = tuple(self.search.left_out)
        if selection is None:
            return Estimate(fits, lost=lost)
        rows = [self.rows.get(k) for k in places]
        contribute = [i for i, row in enumerate(rows) if row is not None]
        members = tuple(i for i in contribute if selection.members[rows[i]])
        outliers = tuple(
            i for i in contribute if i not in members and selection.choice[rows[i]] != OUT
        )
        first = [self.first.get(k) for k in places]
        refitted = tuple(
            i for i in members if (f := first[i]) and f.moved_to(fits[i].optimum)
        )
        signed = tuple(i for i in members if not selection.open_signs[rows[i]])
        return Estimate(
            fits, selection.lens, members, outliers, refitted, signed, lost=lost
        )


def _same(found: Mapping[int, Found], other: Mapping[int, Found]) -> bool:
    return found.keys() == other.keys() and all(found[k] is other[k] for k in found)
