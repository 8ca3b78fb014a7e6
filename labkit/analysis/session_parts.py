"""What a session found of its camera, in the units of a data sheet, and in words."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from labkit.analysis.lens_fit import LensFit
from labkit.analysis.lens_model import whose
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.session_results import as_focus, as_wavefronts
from labkit.imaging.optics import ESTIMATED
from labkit.imaging.parts import KNOWN
from labkit.optics.metrics import psf_difference
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import twin_signs
from labkit.plan import Plan
from labkit.results import Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain


def model_parts(session: SessionFits, plan: Plan) -> dict[str, Uncertain]:
    """Return the data-sheet quantities of all parts of the camera, and of a panel, that were fitted, by key."""
    numbers = _of_lens(session.lens) if session.lens is not None else _of_fits(session)
    groups = dict[tuple[str, ...], list[Uncertain]]()
    for (label, *channel), number in numbers.items():
        groups.setdefault((label.partition(".")[0], *channel), []).append(number)
    channels = {channel.name: channel for channel in plan.channel}
    names = list(dict.fromkeys(name for name, *_ in groups))
    found = dict[str, Uncertain]()
    for name, *channel in sorted(groups, key=lambda of: names.index(of[0])):
        of = channels[channel[0]] if channel else None
        found |= ESTIMATED[name].quantities(groups[name, *channel], of)
    return found


def words_of_parts(session: SessionFits, found: dict[str, Uncertain], wanted: Collection[str] = ()) -> list[str]:
    """Say what was found of the camera, and what is missing, a line each; not of parts that the plan wanted fitted."""
    lines = []
    if session.missing and session.lens is not None:
        named = " and ".join(KNOWN[name].words for name in session.missing)
        lines.append(
            f"the photographs call for {named}, which the model lacks: errors hold how far that would move each number"
        )
    names = dict.fromkeys(key.partition(".")[0] for key in found)
    return lines + [ESTIMATED[name].finding(found) for name in names if name not in wanted]


def words_of_change(session: SessionFits, wavefronts: Sequence[Wavefront]) -> list[str]:
    """What the parts that were found change, against the session fitted without them; none where none was found.

    wavefronts: of all its fits.
    """
    plain = session.without_found
    if plain is None or session.unaided(0) is None:
        return []
    others = as_wavefronts(plain)
    pairs = [(wavefronts[k].fitted, others[k].fitted) for k in session.trusted]
    waves = max(_waves_difference(here, there) for here, there in pairs)
    psfs = max(psf_difference(here, there) for here, there in pairs)
    moved = [f"wavefronts by up to {waves:.2g} waves RMS", f"PSFs by up to {100 * psfs:.2g} % (L1)"]
    if focus := _focus_difference(session.lens, plain.lens):
        moved.insert(0, f"best focus by {', '.join(f'{name} {mm:+.2g} mm' for name, mm in focus.items())}")
    rejected = sum(w.test is not None and not w.test.accepted for w in others)
    end = f"; {rejected} of {len(others)} optima would be rejected" if rejected else ""
    return [f"the model as the plan states it would move {', '.join(moved)}{end}"]


def _focus_difference(lens: LensFit | None, other: LensFit | None) -> dict[str, float]:
    """Of best focus, mm, by channel, where both have one."""
    here, there = (None if of is None else as_focus(of) for of in (lens, other))
    if here is None or there is None:
        return {}
    return {c: there[c].value - at.value for c, at in here.best_focus_mm.items() if c in there.best_focus_mm}


def _waves_difference(wavefront: FittedWavefront, other: FittedWavefront) -> float:
    """Waves RMS. Of two twins the nearer counts."""
    twin = other.waves * twin_signs(other.noll)
    return min(float(np.linalg.norm(waves - wavefront.waves)) for waves in (other.waves, twin))


def _of_lens(lens: LensFit) -> dict[tuple[str, ...], Uncertain]:
    """By label, and channel where each has its own: values and standard errors of all parts."""
    return {
        tuple(map(str, c.of)): Uncertain(lens.value(c.kind, *c.of), lens.std(c.kind, *c.of))
        for c in lens.model.columns
        if c.kind == "part"
    }


def _of_fits(session: SessionFits) -> dict[tuple[str, ...], Uncertain]:
    """The same of fits without a lens in common: means weighted by their errors."""
    seen = dict[tuple[str, ...], list[tuple[float, float]]]()
    for local in session.fits:
        measured, modes = local.fit.measured, len(local.fit.noll)
        for k, label in enumerate(measured.parts, modes):
            of = whose(label, local.channel)
            seen.setdefault(of, []).append((measured.values[k], measured.covariance[k, k]))
    return {of: _weighted(np.array(pairs)) for of, pairs in seen.items()}


def _weighted(pairs: Floats) -> Uncertain:
    values, variances = pairs.T
    whole = float(np.sum(1 / variances))
    return Uncertain(float(np.sum(values / variances)) / whole, whole**-0.5)
