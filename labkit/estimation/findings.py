"""Findings about an estimate; their sentences are in `labkit.findings`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labkit.findings import Finding, found
from labkit.imaging.optics import OPTIONAL
from labkit.imaging.parts import Diffusion, LowPass
from labkit.key import Key
from labkit.types import JSON
from labkit.uncertain import Uncertain

CONFIRMED_BY = {
    "starts": "many starts ended in",
    "parts": "a fit with more parts of the camera confirms",
}
"""How an optimum was confirmed, by the name of its test; any other test is the session's."""


LIKE_PIXELS = (LowPass.name, Diffusion.name)
"""Parts whose blur is like that of a larger pixel."""


ERRORS_OF = {"starts": "how much its numbers err is not known"}
"""What is known of the errors of an incomplete model, by the name of the test: starts alone decide at one range."""


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
            f"PSFs by up to {100 * self.psf_l1:.2g} % (L1)",
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
    missing: Sequence[str],
    confirmed_by: str | None,
) -> Finding:
    """Report a wavefront whose frames the model does not explain.

    Parameters
    ----------
    key : of the wavefront
    p_value : of the residuals
    chi2_per_pixel : of the residuals
    missing : camera parts that the frames show and the model lacks
    confirmed_by : test that accepted the optimum; None if no test did
    """
    words = {"such_as": "".join(f", such as {OPTIONAL[name].words}" for name in missing)}
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
    part: str, values: Mapping[str, Uncertain], gain: float | None, moves: Moves | None
) -> Finding:
    """Report a camera part that was added to the model although the plan does not state it.

    Parameters
    ----------
    part : name of the part
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
        {"part_words": OPTIONAL[part].words, "values_words": words},
        part=part,
        log_likelihood_gain=gain,
        values={name: value.as_json() for name, value in values.items()},
        **({} if moves is None else moves.numbers),
    )


def camera_parts_missing(parts: Sequence[str], moves: Moves) -> Finding:
    """Report camera parts that the frames show and the model lacks. moves: changes of all results with these parts."""
    words = {
        "list": " and ".join(OPTIONAL[name].words for name in parts),
        "moves": str(moves),
    }
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
