"""Of each fit and its twin the right one: a lens's defocus grows with range, and its other modes stay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labkit.analysis.lens_fit import fit_lens, turned
from labkit.analysis.lens_model import Member, Stated
from labkit.optics.zernike import twin_signs

ROUGH_WAVES = 0.01  # errors below this decide no sign
CLEAR = 9.0  # of chi2 between one choice of signs and the next


def choose_twins(members: Sequence[Member], stated: Stated) -> tuple[list[int], list[str]]:
    """+1 for each member that is the right twin, -1 for one that is not; and the channels where the ranges leave it open.

    With the range, defocus passes from negative to positive once: of n ranges the first k are negative. Each k is tried with
    the whole law of the lens, which is steeper on one side of focus than on the other, and with modes that stay.
    """
    signs, open_ = dict[int, int](), list[str]()
    channels = dict.fromkeys(m.channel for m in members)
    places = {
        c: sorted((k for k, m in enumerate(members) if m.channel == c), key=lambda k: members[k].range_mm)
        for c in channels
    }
    lone = {c for c in channels if len({members[k].range_mm for k in places[c]}) < 2}
    for channel in sorted(channels, key=lambda c: c in lone):
        if channel in lone:
            chosen, clear = _like_those_known(members, places[channel], signs), True
        else:
            chosen, clear = _by_range([members[k] for k in places[channel]], stated)
        signs |= zip(places[channel], chosen, strict=True)
        open_ += [] if clear else [channel]
    return [signs[k] for k in range(len(members))], open_


def _by_range(members: Sequence[Member], stated: Stated) -> tuple[list[int], bool]:
    """Signs of one channel's members in order of range, and whether the next choice is clearly worse."""
    costs, choices = [], []
    for negative in range(len(members) + 1):
        wanted = [-1 if k < negative else 1 for k in range(len(members))]
        signs = [sign if defocus(m) >= 0 else -sign for sign, m in zip(wanted, members, strict=True)]
        choices.append(signs)
        costs.append(
            fit_lens([twin(m, s) for m, s in zip(members, signs, strict=True)], stated, extra_waves=ROUGH_WAVES).chi2
        )
    order = np.argsort(costs)
    return choices[order[0]], bool(costs[order[1]] - costs[order[0]] > CLEAR)


def _like_those_known(members: Sequence[Member], places: Sequence[int], signs: Mapping[int, int]) -> list[int]:
    """Where there is one range: the twin nearest to a known one of another channel there; the first follows the stated rule."""
    here = members[places[0]].range_mm
    known = min(signs, key=lambda k: abs(members[k].range_mm - here), default=places[0])
    like = twin(members[known], signs.get(known, 1)).measured.waves
    far = [[float(np.linalg.norm(twin(members[k], sign).measured.waves - like)) for sign in (1, -1)] for k in places]
    return [1 if same <= other else -1 for same, other in far]


def defocus(member: Member) -> float:
    """As measured, waves RMS."""
    return float(member.measured.values[member.measured.noll.index(4)])


def twin(member: Member, sign: int) -> Member:
    """The member itself, or its twin for -1."""
    return member if sign > 0 else turned(member, twin_signs(member.measured.noll))
