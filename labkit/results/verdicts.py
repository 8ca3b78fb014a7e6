"""Verdicts on fits, in words: whether the optimum is found, and whether the model explains the photographs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import nan

from labkit.findings.findings import Finding
from labkit.results.model import OptimumTest, Wavefront
from labkit.uncertain import Uncertain, decimals

MOST_NAMES = 6
"""Largest number of wavefronts named in a sentence; for more the sentence gives the number."""

UNTESTED = "untested"
EXPLAINS = "explains the photographs"

CONTRADICTIONS = (
    "plan-contradicted",
    "cones-contradict-one-lens",
    "pupil-magnification-at-bound",
)
"""Codes of findings that contradict the plan."""


def optimum_word(test: OptimumTest | None) -> str:
    """Return whether the best optimum is found: "found", "doubtful", "undetermined" or "untested"."""
    if test is None:
        return UNTESTED
    if test.undetermined:
        return "undetermined"
    return "found" if test.accepted else "doubtful"


def model_word(test: OptimumTest | None) -> str:
    """Return whether the model explains the photographs, in words: it does, "incomplete" or "untested"."""
    if test is None:
        return UNTESTED
    return EXPLAINS if test.explains else "incomplete"


def confirmed(wavefront: Wavefront, wavefronts: Sequence[Wavefront]) -> bool:
    """Return whether the errors of a wavefront's numbers are known.

    The optimum must be found, and the model must explain the photographs or another range of the channel must be fitted: what
    a model lacks shows as a difference between ranges, which errors include.
    """
    if wavefront.test is None or explained(wavefront):
        return wavefront.test is None or wavefront.accepted
    ranges = {w.range_mm for w in wavefronts if w.channel == wavefront.channel}
    return wavefront.accepted and len(ranges - {None}) > 1


def headline(wavefronts: Sequence[Wavefront], findings: Collection[Finding] = ()) -> str:
    """Return a sentence that says which numbers hold.

    Parameters
    ----------
    wavefronts : all of the results
    findings : all of the results
    """
    doubtful = [w for w in wavefronts if w.test is not None and not w.test.accepted]
    incomplete = [w for w in wavefronts if w.accepted and not explained(w)]
    untested = [w for w in wavefronts if w.test is None]
    parts = []
    if doubtful:
        parts.append(
            f"do not use {_named(doubtful, wavefronts)}: the optimum is doubtful, and no error is known"
        )
    if incomplete:
        parts.append(
            f"in {len(incomplete)} of {len(wavefronts)} fits the model is incomplete"
            + _holding(incomplete, wavefronts, findings)
        )
    if untested:
        parts.append(f"{_named(untested, wavefronts)}: the optimum is untested")
    if not parts:
        parts.append(
            "all numbers hold within their errors: every optimum is found, and the model explains the photographs"
        )
    if is_open := [w for w in wavefronts if w.sign_open and w.accepted]:
        parts.append(f"the sign of even modes is open: {_named(is_open, wavefronts)}")
    return "; ".join(parts)


def _holding(
    incomplete: Sequence[Wavefront],
    wavefronts: Sequence[Wavefront],
    findings: Collection[Finding],
) -> str:
    """Return which numbers hold if the model is incomplete in some fits, as the end of a sentence.

    Errors contain what a model lacks if ranges show it as their scatter about one lens, which then must not be in doubt.
    """
    if alone := [w for w in incomplete if not confirmed(w, wavefronts)]:
        names = _named(alone, wavefronts)
        return f", and no other range confirms {names}: errors are not known"
    if any(finding.code in CONTRADICTIONS for finding in findings):
        return ", and the fits contradict the plan: no number is sure to hold within its error; check plan and modes first"
    if all(w.sign_open for w in incomplete):
        return ", and no sign is known: no number is sure to hold within its error; check plan and modes first"
    return (
        ": defocus and best focus hold within their errors; Strehl ratio, RMS and MTF50 are of the fitted modes "
        "alone"
    )


def explained(wavefront: Wavefront) -> bool:
    """Return whether the residuals of a wavefront were tested and are noise alone."""
    return wavefront.test is not None and wavefront.test.explains


def stated(number: Uncertain, *, known: bool) -> Uncertain:
    """Return a number with its error if known, as `confirmed` has it; else with none."""
    if known:
        return number
    return replace(number, value=round(number.value, decimals(number.std)), std=nan)


def _named(some: Sequence[Wavefront], every: Sequence[Wavefront]) -> str:
    if len(some) == len(every) and len(every) > 1:
        return f"all {len(every)} fits"
    if len(some) > MOST_NAMES:
        return f"{len(some)} of {len(every)} fits"
    return ", ".join(w.key.label for w in some)
