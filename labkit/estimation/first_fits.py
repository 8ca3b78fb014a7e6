"""Which observations of a session are fitted first, and what others tell of their starts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from labkit.estimation.local import Found, Optimum
from labkit.estimation.observation import Observation
from labkit.estimation.select import OUT, Selection
from labkit.estimation.settings import SETTINGS
from labkit.estimation.starts import near_focus
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.key import Tile
from labkit.plan import leading_channel
from labkit.types import Floats


def anchors(observations: Sequence[Observation], places: Sequence[int]) -> list[int]:
    """Return the reference channel at the nearest and the farthest range; one observation if ranges are unknown.

    Of tiles, the one nearest to the middle of the frame.
    """
    channels = [observations[k].channel for k in places]
    first = leading_channel(channels)
    of = [k for k in places if observations[k].channel == first]
    inner = observations[min(of, key=lambda k: np.hypot(*observations[k].place))].tile
    of = [k for k in of if observations[k].tile == inner]
    ranges = {k: r for k in of if (r := observations[k].measured_range_mm) is not None}
    if not ranges:
        return of[:1]
    ends = min(ranges, key=ranges.__getitem__), max(ranges, key=ranges.__getitem__)
    return list(dict.fromkeys(ends))


def telling(found: Mapping[int, Found]) -> list[int]:
    """Return the anchors that tell what the camera has: those far from focus, the explained ones if there are any.

    Near focus a wrong optimum may be explained by chance, or call for parts that are not there. If none is far from focus and
    none is explained, all tell.
    """
    explained = [k for k in found if found[k].best.verdict.accepted]
    far = [k for k in found if not _near_focus(found[k])]
    clear = [k for k in far if k in explained]
    return clear or far or ([] if explained else list(found))


def wrong_near_focus(found: Mapping[int, Found]) -> list[int]:
    """Return the anchors near focus that are not explained by a model that explains one far from focus.

    Their optimum is wrong: it would lead the prediction of all others astray.
    """
    explained = [k for k in found if found[k].best.verdict.accepted]
    if all(_near_focus(found[k]) for k in explained):
        return []
    return [k for k in found if k not in explained and _near_focus(found[k])]


def _near_focus(found: Found) -> bool:
    return near_focus(found.best.optics, found.best.waves)


def clearest(
    observations: Sequence[Observation], defocus: Mapping[int, float]
) -> list[int]:
    """Return the observation of each channel and tile that is farthest from focus, by predicted defocus, waves RMS."""
    best = dict[tuple[str, Tile | None], int]()
    for k, waves in defocus.items():
        other = best.setdefault((observations[k].channel, observations[k].tile), k)
        if abs(waves) > abs(defocus[other]):
            best[observations[k].channel, observations[k].tile] = k
    return list(best.values())


def best_predicted(
    observations: Sequence[Observation],
    fitted: Collection[int],
    stds: Mapping[int, float],
    terms: int,
) -> list[int]:
    """Return, of each channel, the observations whose defocus is predicted best: tiles next to those that are fitted.

    Parameters
    ----------
    observations : of the session
    fitted : places of observations with a fit; of a channel without any, one observation is returned
    stds : standard errors of predicted defocus, by the place of an observation
    terms : number of observations of a channel: of terms that its wavefront has over the field, 1 without tiles
    """
    known = {observations[k].channel for k in fitted}
    ranked = sorted(stds, key=lambda k: stds[k])
    chosen = list[int]()
    for channel in dict.fromkeys(observations[k].channel for k in stds):
        of = [k for k in ranked if observations[k].channel == channel]
        chosen += of[: terms if channel in known else 1]
    return chosen


def nearest_fitted(
    observations: Sequence[Observation], fitted: Collection[int], place: int
) -> int | None:
    """Return the nearest fitted tile of a tile's channel and range; None if none is fitted, or without tiles.

    Its wavefront is a safer start than a prediction: the field's expansion may extrapolate few tiles to any wavefront.
    """
    here = observations[place]
    same = [
        k
        for k in fitted
        if (observations[k].channel, observations[k].range_mm)
        == (here.channel, here.range_mm)
    ]
    if here.tile is None or not same:
        return None
    away = {k: np.subtract(observations[k].place, here.place) for k in same}
    return min(same, key=lambda k: float(np.hypot(*away[k])))


def beside(
    observations: Sequence[Observation],
    rows: Mapping[int, int],
    selection: Selection,
    place: int,
    optics: Optics,
) -> tuple[Optics, Floats] | None:
    """Return the fit of a channel that the lens predicts to be most like an observation, moved by the predicted difference.

    Numbers of a cut pupil and modes lie along a curved valley, and the Gaussian of the lens may predict a wavefront outside.

    Parameters
    ----------
    observations : of the session
    rows : their places in the selection, of those whose range is known
    selection : the choices for all observations, and the lens
    place : of the observation
    optics : the observation's

    Returns
    -------
    optics and modes (modes,); None without a range, or without another fit of the channel
    """
    lens, here = selection.lens, rows.get(place)
    of_channel = [
        row
        for k, row in rows.items()
        if k != place
        and selection.members[row]
        and observations[k].channel == observations[place].channel
    ]
    if here is None or not of_channel:
        return None
    by_lens, modes = lens.solved.predicted, len(optics.noll)
    away = by_lens[here] - by_lens[of_channel]
    nearest = int(np.argmin(np.linalg.norm(away[:, :modes], axis=1)))
    values = lens.measured.values[of_channel[nearest]] + away[nearest]
    return optics.with_named(lens.model.parts, values[modes:-1]), values[:modes]


def in_other_colour(
    observations: Sequence[Observation], fits: Mapping[int, Optimum], place: int
) -> Optimum | None:
    """Return the explained fit of another channel at an observation's station and tile, if it is behind a cat's eye.

    The circle and the modes belong together: means over stations need not. None without such a fit.
    """
    here = observations[place]
    for k, fit in fits.items():
        there = observations[k]
        same = (there.range_mm, there.tile) == (here.range_mm, here.tile)
        tells = fit.verdict.accepted and not fit.optics.rim.is_full
        if same and there.channel != here.channel and tells:
            return fit
    return None


def confirmed(found: Mapping[int, Found], selection: Selection | None) -> bool:
    """Return whether anchors confirm each other: several starts returned to the optimum of each, and all belong to one lens.

    If none of them is explained, the model is then incomplete for all.
    """
    if selection is None or not all(each.returns for each in found.values()):
        return False
    inside = np.flatnonzero(selection.members)
    stations = {selection.observed[k].reading.station for k in inside}
    return len(stations) > 1 and bool(selection.members[selection.choice != OUT].all())


def known_poses(
    observations: Sequence[Observation], found: Mapping[int, Found], place: int
) -> tuple[Pose, ...]:
    """Return the target's poses in an observation's photographs by a fit of another channel; empty without one."""
    here = observations[place]
    for k in found:
        there = observations[k]
        same = there.names == here.names and there.tile == here.tile
        if k != place and there.names and same:
            top, left = np.subtract(here.origin_px, there.origin_px)
            poses = found[k].best.state.poses
            return tuple(pose.shifted(top, left) for pose in poses)
    return ()


def first_of(found: Mapping[int, Found]) -> Optimum:
    """Return the optimum from which others begin if no lens predicts them: explained, and farthest from focus."""
    best = [each.best for each in found.values()]
    return max(best, key=lambda one: (one.verdict.accepted, abs(float(one.waves[0]))))


def spread(observations: Sequence[Observation], places: Collection[int]) -> list[int]:
    """Return the observations that decide about camera parts and modes: all, but of tiles the most distant of each photograph.

    The parts are those of the whole frame: a sample of its tiles shows a part, and refits with each part that is
    tried take as long for a thousand tiles as for ten.
    """
    exposures = dict[tuple[float | None, str], list[int]]()
    for k in places:
        exposures.setdefault(
            (observations[k].range_mm, observations[k].channel), []
        ).append(k)
    chosen = [
        of[i]
        for of in exposures.values()
        for i in _farthest(np.array([observations[k].place for k in of]))
    ]
    return sorted(chosen)


def _farthest(places: Floats) -> list[int]:
    """Return indices of places (n, 2): the one nearest to the middle, then each time the one farthest from all before."""
    chosen = [int(np.argmin(np.hypot(*places.T)))]
    while len(chosen) < min(len(places), SETTINGS.deciding_tiles):
        away = np.linalg.norm(places[:, None] - places[chosen], axis=-1).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return chosen
