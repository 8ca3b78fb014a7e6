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

from labkit.key import Key
from labkit.types import JSON
from labkit.uncertain import Uncertain

NOTE = "note"
"""The code of a warning in results of schema 1 and 2, which have no codes."""

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


TEXTS = {
    # session and photographs
    "session-mended": "{note}",
    "kept-fits-refused": (
        "{count} of the fits stored in {folder} were altered, or made by another user or on another machine: they were "
        "fitted again"
    ),
    "photographs-unlisted": (
        "{count} photographs in {folder} are not used, such as {first}: the journal does not list them. Its end is lost, or "
        "somebody added the files; labkit verify names them"
    ),
    "same-photograph": "{file} is the same photograph as {same_as}: it counts once",
    "exif-focal-length": (
        "{file} was taken at {focal_length_mm:g} mm by its EXIF, but the plan has lens.focal_length_mm = "
        "{planned_mm:g}: correct the plan, or take photographs of that lens"
    ),
    "exif-f-number": (
        "{file} was taken at f/{f_number:g} by its EXIF, but the plan has {plan_key} = {planned:g}: correct the plan, "
        "or take photographs of that aperture"
    ),
    "settings-differ": (
        "the photographs differ in {setting}: {first_file} has {first}, {file} {other} by their EXIF; a session has "
        "one lens at one setting: make a session for each"
    ),
    "picture-altered": "{note}",
    "picture-processed": (
        "processed pictures ({file_format}, {bits} bit), {tone_curve}: demosaicing, sharpening and noise reduction are "
        "part of the reported PSF, and errors are larger than stated, because neighbouring pixels share "
        "noise; use raw files if possible"
    ),
    "colours-at-half-resolution": (
        "JPEG stores its colours at half resolution: R and B are blurred; use channel G alone, or JPEGs "
        "without subsampling (4:4:4)"
    ),
    "panel-pixels-seen": (
        "the photographs resolve the panel's own pixels, {pitch_mm:.4g} mm apart with {contrast:.0%} of contrast, and the "
        "plan has no [target.pixels]: add {to_add} to [target]"
    ),
    "surround-contradicted": (
        'the plan has target.surround = "{surround}", but the target\'s surround has {level:.0%} of the radiance of its '
        'white: write "{other}", or "unknown" for neither'
    ),
    # flats and darks
    "no-dark-frames": (
        "no dark frames: the black level of the files (or the plan) is used, and hot pixels are unknown"
    ),
    "bias-instead-of-darks": "no dark frames: bias frames are used instead, and dark current is neglected",
    "dark-exposure-differs": "dark and target frames differ in exposure time: dark current may be wrong",
    "noise-contradicts-plan": (
        "channel {channel}: {key} = {stated:.4g} in the plan, but the session's own flats and darks show {measured:.4g} ± "
        "{std:.2g}: the session's own is used; correct the plan, whose number holds for one ISO only"
    ),
    "no-flat-frames": (
        "no flat frames: uneven light is fitted as a low-order polynomial, with gain and read noise; all pixels are "
        "assumed to be equal"
    ),
    "flats-of-another-range": "no flat frames{where}: those{taken} are taken instead",
    "flats-partly-unlit": "flat frames{where} leave {unlit:.0%} of the frame unlit: this part is not used",
    "tiles-not-found": (
        "{count} of {every} tiles are not found{at}, and left out: {named}; are they whole in the frame, lit and not covered?"
    ),
    "tile-left-out": "{where} is left out: {why}",
    "gain-not-measured": "no range has two flat frames: gain is not measured, and equal pixels are assumed",
    # each fit
    "results-corrupt": "results.json could not be read; it is set aside as {aside}",
    "fit-left-out": "{note}; completed fits are kept",
    "search-cut-short": (
        "{where}: the search ended after {patience_s:g} s of processor time and {starts} starts without an accepted "
        "optimum; the likeliest is kept, a longer --patience searches further"
    ),
    "fit-mended": "{where}: contradicted the other fits; a new fit from their prediction agrees",
    "fit-does-not-belong": (
        "{where}: contradicts the other fits and is left out of best focus; was the lens touched, or is the optimum "
        "wrong?"
    ),
    "two-camps": (
        "the fits form two groups that contradict each other: {members} follow one lens, {outliers} another; best focus is "
        "of the first; was the lens touched or refocused?"
    ),
    "undetermined": "{where}: the frames do not determine {list}; is the target lit, sharp and large enough?",
    "model-incomplete": (
        "{where}: the residuals are more than noise (p = {p_value:.1g}, χ² per pixel {chi2_per_pixel:.2f}); {confirmed} the "
        "optimum: the model lacks something{such_as}; {errors}"
    ),
    "optimum-doubtful": (
        "{where}: the residuals are more than noise (p = {p_value:.1g}, χ² per pixel {chi2_per_pixel:.2f}); the optimum may "
        "be wrong, or the model lacks something{such_as}; its errors are unknown"
    ),
    "model-incomplete-everywhere": (
        "the residuals of {count} of {fits} fits are more than noise (χ² per pixel {least:.2f} to {most:.2f}); the fits "
        "confirm each other's optima: the model lacks something; standard errors allow for it"
    ),
    "chi2-unusual": "{where}: χ² per pixel is {chi2_per_pixel:.2f}, expected is {low:g} to {high:g}",
    # the session's lens
    "lens-changed": (
        "the lens or its focus was changed between {last_mm:g} and {next_mm:g} mm, as the photographs were taken: the "
        "ranges before and after follow two lenses; `labkit fit --split` fits them separately"
    ),
    "no-best-focus": "no best focus: {why}",
    "channel-without-best-focus": (
        "no best focus of {where}, which needs at least 2 ranges: photograph the target at more ranges"
    ),
    "defocus-sign-open": (
        "{where}: these ranges leave open the sign of defocus and, with it, of all even modes; ranges on both sides of focus "
        "would determine it"
    ),
    "pupil-magnification-at-bound": (
        "no pupil magnification from {least:g} to {most:g} fits: defocus does not follow a lens's curve; check ranges, "
        "focal length and target size"
    ),
    "pupil-magnification-undetermined": (
        "these ranges do not determine the pupil magnification: its standard error is {pupil_magnification_std:.3f}; "
        "ranges near the closest focus would, or smaller errors of focal length and range zero"
    ),
    "plan-contradicted": (
        "the photographs contradict the plan: they agree with {key} = {agreed} in place of {stated:g}, which the results "
        "assume; check this key first, then, the likeliest first, {others}; correct the plan and fit again"
    ),
    "cones-contradict-one-lens": (
        "working f-numbers and sizes contradict one lens focused as a whole (the f-number is {cone_relative_error:+.1%} "
        "off): they were not used for focal length, f-number and pupil magnification; are channel.wavelength_nm, "
        "sensor.pixel_pitch_um, target.size_mm and lens.f_number right?"
    ),
    "modes-differ-between-ranges": (
        "the modes differ from range to range beyond their errors: they were estimated for each range"
    ),
    "errors-widened": (
        "the fits depart from one lens by {factor:.1f} times their standard errors (χ² per degree of freedom "
        "{chi2_per_freedom:.1f}); all errors were increased by this factor"
    ),
    # the camera
    "camera-part-found": "the photographs show {part_words}, which the plan does not state: {values_words}",
    "pupil-at-bound": (
        "the {title} ended at the limit of what a pupil can be: its numbers describe nothing; the model lacks something else"
    ),
    "light-contradicted": "the light that the plan names has another width than the photographs show: {list}",
    "higher-modes-found": (
        "the photographs show Zernike modes {first_noll} to {last_noll}, {waves_words} RMS together, which were fitted "
        "besides the usual modes"
    ),
    "camera-parts-missing": (
        "the photographs show {list}, which the model lacks and which would move {moves}; standard errors include this effect"
    ),
    "stated-model-moves": "the model as the plan states it would move {moves}{rejected}",
    "panel-aperture-found": (
        "a stripe of the panel's pixels is lit over {across} of its third, and over {down} of the pitch"
    ),
    # edges
    "ranges-not-determined": (
        "ranges are not determined: give --psf SESSION with a best focus, or --focus MM"
    ),
    "psf-of-another-camera": "PSF of another camera, by force: {difference}",
    "edge-methods-disagree": (
        "box {at}, channel {channel}: MTF50 is {fit} by the fit and {iso} by ISO 12233, more apart than their errors allow: "
        "see whether the box holds one straight edge between even sides"
    ),
    # charts
    "chart-edges-left-out": "left out: {cut} edges cut by the frame, {clipped} clipped",
    "chart-edges-not-fitted": "{count} edges of the chart gave no fit, most as: {why}",
    "chart-edges-along-pixels": (
        "{count} of {edges} edges run within 1 degree of rows or columns and are badly sampled: turn the chart by 5 degrees"
    ),
    "chart-directions-missing": (
        "S and T are not determined at {count} of {places} places, for want of an edge nearly along or across the radius: "
        "photograph the chart turned by 45 degrees as well"
    ),
    "chart-focus-sign-open": (
        "the sign of the focus errors is open: give photographs at two ranges or more, and --range MM for each"
    ),
}
"""The sentence of each code. `where` is the key's label; other names are numbers, or words made of them."""

UNANSWERED_CODES = ("fit-left-out", "no-best-focus", "channel-without-best-focus")
"""Codes that say what was to be estimated and could not be."""


CONFIRMED_BY = {
    "starts": "many starts ended in",
    "parts": "a fit with more parts of the camera confirms",
}
"""How an optimum was confirmed, by the name of its test; any other test is the session's."""


LIKE_PIXELS = ("low_pass_filter", "diffusion")
"""Camera parts whose blur is like that of a larger pixel."""


ERRORS_OF = {"starts": "how much its numbers err is not known"}
"""What is known of the errors of an incomplete model, by the name of the test: starts alone decide at one range."""


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
    """Report a camera part that was added to the model although the plan does not state it.

    Parameters
    ----------
    part, part_words : name of the part, and the part in words
    values : the part's numbers; each name ends with its unit
    gain : log-likelihood that the part gains, by its score test
    moves : changes of all results without the added parts
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
