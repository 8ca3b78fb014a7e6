"""Every finding that a fit can report: its code, and the sentence with its numbers.

`found` makes a finding from a code and numbers. A function below makes each sentence that
needs more than numbers in their places. docs/troubleshooting explains each code and the
remedy.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from labkit.findings.texts import TEXTS
from labkit.key import Key
from labkit.types import JSON
from labkit.uncertain import Uncertain

NOTE = "note"
"""The code of a warning in results of schema 1 and 2, which have no codes."""

NAMED_PIXELS = 3
"""Number of pixels, and of photographs of each, that a sentence names."""

OTHER_KEYS = 3
"""Number of keys that a sentence names besides the likeliest: each takes a look at lens, camera or target."""

SUREST = 0.995
"""A larger probability is not repeated: it depends on the model's errors more than on the noise."""

KEBAB_CASE = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding's code, wavefront, numbers and sentence.

    Parameters
    ----------
    code : kebab-case; a code never changes its meaning
    key : the wavefront concerned; without a range, all wavefronts of its channel; None: the
        session
    numbers : JSON, the unit at the end of each name; a number that is not finite becomes
        None
    text : one sentence with the numbers
    warns : whether a user should see the text as a warning

    Raises
    ------
    ValueError
        `code` is not in kebab-case.
    TypeError
        `numbers` are not JSON.
    """

    code: str
    key: Key | None
    numbers: Mapping[str, JSON]
    text: str
    warns: bool = True

    def __post_init__(self) -> None:
        if not KEBAB_CASE.fullmatch(self.code):
            raise ValueError(
                f"code {self.code!r}: allowed are lower-case words with hyphens between"
            )
        object.__setattr__(
            self, "numbers", {name: _plain(value) for name, value in self.numbers.items()}
        )

    def __str__(self) -> str:
        return self.text


def each_once(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings without repetitions."""
    first = dict[str, Finding]()
    for finding in findings:
        first.setdefault(finding.text, finding)
    return list(first.values())


def _plain(value: JSON) -> JSON:
    """Return a value as JSON stores and returns it."""
    if isinstance(value, Mapping):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):  # NumPy's too
        return float(value) if isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{value!r} is no number, text, list or table")


UNANSWERED_CODES = ("fit-left-out", "no-best-focus", "channel-without-best-focus")
"""Codes of findings about quantities that could not be estimated."""


CONFIRMED_BY = {
    "starts": "many starts ended in",
    "parts": "a fit with more parts of the camera confirms",
}
"""How an optimum was confirmed, by the name of its test; any other test is the session's."""


LIKE_PIXELS = ("low_pass_filter", "diffusion")
"""Camera parts whose blur is like that of a larger pixel."""


ERRORS_OF = {"starts": "how much its numbers err is not known"}
"""Statement about the errors of an incomplete model, by the test's name: at one range only starts decide."""


def found(
    code: str,
    key: Key | None = None,
    words: Mapping[str, str] | None = None,
    /,
    **numbers: JSON,
) -> Finding:
    """Make a finding.

    Parameters
    ----------
    code : a key of `TEXTS`
    words : parts of the sentence besides the numbers
    numbers : numbers of the finding, which the sentence repeats

    Raises
    ------
    KeyError
        `code` is not in `TEXTS`, or its sentence needs another number.
    """
    where = {} if key is None else {"where": key.label}
    return Finding(
        code, key, numbers, TEXTS[code].format(**{**where, **numbers, **(words or {})})
    )


def flats_of_another_range(range_mm: float | None, taken_mm: float | None) -> Finding:
    """Return the finding that the nearest range's flats serve a range without flats."""
    words = {"where": at_range(range_mm), "taken": at_range(taken_mm)}
    return found(
        "flats-of-another-range", None, words, range_mm=range_mm, taken_mm=taken_mm
    )


def flats_partly_unlit(range_mm: float | None, unlit: float) -> Finding:
    """Return the finding that a share of the frame, 0 to 1, is unlit in the flats of a range."""
    return found(
        "flats-partly-unlit",
        None,
        {"where": at_range(range_mm)},
        range_mm=range_mm,
        unlit=unlit,
    )


def surround_uneven(range_mm: float | None, surround: float) -> Finding:
    """Return the finding that the surround, 0 black or 1 white, is not even next to the target."""
    words = {"at": at_range(range_mm), "surround": "white" if surround else "black"}
    return found("surround-uneven", None, words, range_mm=range_mm)


@dataclass(frozen=True, slots=True)
class Moves:
    """Changes of a session's results under another model of the camera.

    Attributes
    ----------
    best_focus_mm : by channel; empty without a best focus
    waves : the largest change of a wavefront, waves RMS
    psf_l1 : the largest summed absolute difference of a PSF of unit sum
    """

    best_focus_mm: Mapping[str, float]
    waves: float
    psf_l1: float

    def __str__(self) -> str:
        words = [
            f"wavefronts by up to {self.waves:.2g} waves RMS",
            f"PSFs by up to {_percent(self.psf_l1)} % (L1)",
        ]
        focus = ", ".join(f"{name} {mm:+.2g} mm" for name, mm in self.best_focus_mm.items())
        return ", ".join([f"best focus by {focus}", *words] if focus else words)

    @property
    def numbers(self) -> dict[str, JSON]:
        """The changes as numbers of a finding."""
        return {
            "best_focus_moves_mm": dict(self.best_focus_mm),
            "waves_move": self.waves,
            "psf_moves_l1": self.psf_l1,
        }


def undetermined(key: Key, combinations: Sequence[str]) -> Finding:
    """Report combinations of modes that the frames do not determine."""
    return found(
        "undetermined",
        key,
        {"list": ", ".join(combinations)},
        combinations=list(combinations),
    )


def residuals_not_noise(
    key: Key,
    p_value: float,
    chi2_per_pixel: float,
    missing: Mapping[str, str],
    confirmed_by: str | None,
) -> Finding:
    """Report a wavefront whose frames the model does not explain.

    Parameters
    ----------
    key : of the wavefront
    p_value : of the residuals
    chi2_per_pixel : of the residuals
    missing : camera parts that the frames show and the model lacks, in words, by name
    confirmed_by : test that accepted the optimum; None if no test did
    """
    words = {"such_as": "".join(f", such as {part}" for part in missing.values())}
    code = "optimum-doubtful"
    if confirmed_by is not None:
        code = "model-incomplete"
        words["confirmed"] = CONFIRMED_BY.get(confirmed_by, "the session confirms")
        words["errors"] = ERRORS_OF.get(confirmed_by, "standard errors allow for it")
    return found(
        code,
        key,
        words,
        p_value=p_value,
        chi2_per_pixel=chi2_per_pixel,
        missing=list(missing),
        confirmed_by=confirmed_by,
    )


def camera_part_found(
    part: str,
    part_words: str,
    values: Mapping[str, Uncertain],
    gain: float | None,
    moves: Moves | None,
) -> Finding:
    """Report a camera part added to the model although the plan does not state it.

    Parameters
    ----------
    part, part_words : name of the part, and the part in words
    values : the part's numbers; each name ends with its unit
    gain : log-likelihood that the part gains, by its score test
    moves : changes of all results without the added parts; None for the pupil's, which always stay
    """
    plain = {
        name.removesuffix("_px").removesuffix("_nm").removesuffix("_deg"): value
        for name, value in values.items()
    }
    words = ", ".join(
        f"{name} {value}" for name, value in plain.items() if name != "spread"
    )
    words += "; a wrong sensor.fill_factor looks alike" if part in LIKE_PIXELS else ""
    return found(
        "camera-part-found",
        None,
        {"part_words": part_words, "values_words": words},
        part=part,
        log_likelihood_gain=gain,
        values={name: value.as_json() for name, value in values.items()},
        **({} if moves is None else moves.numbers),
    )


def camera_parts_missing(parts: Mapping[str, str], moves: Moves) -> Finding:
    """Report camera parts that the frames show and the model lacks.

    Parameters
    ----------
    parts : the parts in words, by name
    moves : changes of all results with these parts
    """
    words = {"list": " and ".join(parts.values()), "moves": str(moves)}
    return found("camera-parts-missing", None, words, parts=list(parts), **moves.numbers)


def stated_model_moves(moves: Moves, rejected: int, optima: int) -> Finding:
    """Report changes of all results without the added parts; then `rejected` of the optima would be rejected."""
    words = f"; {rejected} of {optima} optima would be rejected" if rejected else ""
    return found(
        "stated-model-moves",
        None,
        {"moves": str(moves), "rejected": words},
        rejected_optima=rejected,
        optima=optima,
        **moves.numbers,
    )


def pixels_left_out(
    residual_stds: Mapping[tuple[int, int], Mapping[str, float]],
) -> Finding:
    """Report pixels of the target's photographs that no model explains.

    residual_stds: by (row, column) in the frame and by file, in standard deviations of noise
    """
    first = list(residual_stds.items())[:NAMED_PIXELS]
    named = [f"pixel {place} of {_listed(list(files))}" for place, files in first]
    if (more := len(residual_stds) - len(first)) > 0:
        named.append(f"{more} more")
    sizes = [abs(size) for files in residual_stds.values() for size in files.values()]
    return found(
        "pixels-left-out",
        None,
        {"named": ", ".join(named)},
        most_stds=max(sizes),
        pixels=[
            {"row": row, "column": column, "residual_stds": dict(files)}
            for (row, column), files in residual_stds.items()
        ],
    )


def _listed(files: Sequence[str]) -> str:
    """Return the names of a few files, or the first and the number of others."""
    if len(files) <= NAMED_PIXELS:
        return " and ".join([", ".join(files[:-1]), files[-1]] if files[1:] else files)
    return f"{files[0]} and {len(files) - 1} more"


def plan_contradicted(
    key: str, stated: float, agrees: Uncertain, probability: float, others: Sequence[str]
) -> Finding:
    """Report a number of the plan that is probably a mistake.

    Parameters
    ----------
    key : names it in the plan
    stated : the plan's value
    agrees : the value that agrees with the photographs
    probability : of this mistake
    others : keys that may be mistakes in its place, the likeliest first
    """
    sure = (
        f"{100 * probability:.0f}"
        if probability < SUREST
        else f"more than {100 * SUREST:g}"
    )
    others = list(dict.fromkeys(one for one in others if one != key))[:OTHER_KEYS]
    return found(
        "plan-contradicted",
        None,
        {"agreed": str(agrees), "sure": sure, "others": _one_of(others)},
        key=key,
        stated=stated,
        agrees=agrees.as_json(),
        probability=probability,
        next=others,
    )


def _one_of(names: Sequence[str]) -> str:
    """Return names with "or" before the last."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)


def two_camps(members: Sequence[Key], outliers: Sequence[Key]) -> Finding:
    """Report fits that follow one lens, and outliers that follow another."""
    words = {
        "members": ", ".join(key.label for key in members),
        "outliers": ", ".join(key.label for key in outliers),
    }
    return found(
        "two-camps",
        None,
        words,
        members=[key.array_name for key in members],
        outliers=[key.array_name for key in outliers],
    )


def model_incomplete_everywhere(chi2_per_pixel: Mapping[str, float], fits: int) -> Finding:
    """Report a model that explains the frames of few fits, whose optima confirm each other.

    Parameters
    ----------
    chi2_per_pixel : by key, of the unexplained fits
    fits : number of all fits
    """
    values = list(chi2_per_pixel.values())
    return found(
        "model-incomplete-everywhere",
        chi2_per_pixel=dict(chi2_per_pixel),
        count=len(values),
        fits=fits,
        least=min(values),
        most=max(values),
    )


def unanswered(findings: Collection[Finding]) -> str | None:
    """Name the requested quantities that could not be estimated; None if all were."""
    return (
        "; ".join(finding.text for finding in findings if finding.code in UNANSWERED_CODES)
        or None
    )


def _percent(share: float) -> str:
    """Return a share in percent, with two significant digits and no power of ten."""
    return f"{float(f'{100 * share:.2g}'):g}"


def at_range(range_mm: float | None) -> str:
    return " without a range" if range_mm is None else f" at {range_mm:g} mm"
