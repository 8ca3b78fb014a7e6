"""Errors over stated errors of many sessions, each fitted as it came: `python -m benchmarks.sessions OUT.jsonl --sessions 200`.

Lens, tape, target and home switch of each are off from what its plan states, by the errors that the plan has for them
(benchmarks/random_sessions.py). Each session is a line in the file as soon as it is done; run again, the same command goes on,
and with nothing left to do prints the table only.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import labkit
from benchmarks.psf_errors import psf_chance, psf_errors
from benchmarks.random_sessions import KINDS, Drawn, make
from benchmarks.real_lens import draw_real_lens
from benchmarks.session_tables import (
    COUNTS,
    Line,
    light_table,
    parts_table,
    psf_table,
    table,
    wavefront_table,
)
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.world import Truth
from labkit.jobs.execute import run_all
from labkit.plan import Plan
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.results import Results

STUDIES: dict[str, Callable[[int, int], Drawn]] = {
    **KINDS,
    "real-lens": draw_real_lens,
    "real-lens-careful": partial(draw_real_lens, careful=True),
    "real-lens-8-frames": partial(draw_real_lens, frames_per_range=8),
}
"""Draw the sessions of each study, by seed and index."""

WRONG_WAVES = 0.03
"""RMS over the modes above defocus beyond which, and beyond six standard errors, an optimum is another one than the right."""


@dataclass(frozen=True, slots=True)
class Job:
    """A session of a study, to be made and fitted. keep: the folder for sessions that are not thrown away.

    plain: fitted as its plan has it, whatever the camera has besides. limit_s: processor time after which a fit is ended
    and the session counts as failed; 0 for no limit.
    """

    study: str
    seed: int
    index: int
    keep: Path | None
    plain: bool = False
    limit_s: float = 0


def run(job: Job) -> Line:
    """Make a session, fit it without its truth, and compare."""
    drawn = STUDIES[job.study](job.seed, job.index)
    with TemporaryDirectory(prefix="labkit-sessions-") as base:
        folder = (job.keep or Path(base)) / f"{job.seed}-{job.index}"
        shutil.rmtree(folder, ignore_errors=True)  # what a run that was killed had kept
        started = time.perf_counter()
        truth = make(drawn, folder)
        made = time.perf_counter()
        line = _described(job, drawn) | {"failed": None}
        try:
            with ended_after(job.limit_s):
                labkit.fit(folder, workers=1, plain=job.plain)
            results = json.loads((folder / "results/latest/results.json").read_text())
            line |= compared(results, truth) | _diagnosed(results, drawn.plan)
            loaded, lens = Results.load(folder), drawn.settings.lens
            line["psf"] = psf_errors(loaded, lens, truth)
            one = loaded.wavefronts[job.index % len(loaded.wavefronts)]
            line["psf_chance"] = psf_chance(one, lens, truth, job.index)
        except (Exception, OutOfTime) as error:  # a finding of the study, and not its end
            line["failed"] = f"{type(error).__name__}: {error}"
    return line | {
        "making_s": round(made - started, 1),
        "fitting_s": round(time.perf_counter() - made, 1),
    }


class OutOfTime(BaseException):
    """The processor time of a fit is spent. No Exception: a fit goes on without a search that raised one."""


@contextmanager
def ended_after(seconds: float) -> Iterator[None]:
    """Raise OutOfTime where the work inside takes longer, in processor time; 0 for no limit."""

    def end(*_: object) -> None:
        raise OutOfTime(f"not fitted within {seconds:g} s of a processor")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _described(job: Job, drawn: Drawn) -> Line:
    lens, plan = drawn.settings.lens, drawn.plan
    assert plan.rail is not None
    return {
        "study": job.study,
        "plain": job.plain,
        "seed": job.seed,
        "index": job.index,
        **drawn.kind,
        "focal_length_mm": lens.focal_length_mm,
        "f_number": lens.f_number,
        "pupil_magnification": lens.pupil_magnification,
        "best_focus_mm": dict(lens.best_focus_mm),
        "aberration_waves": lens.aberration_waves,
        "lateral_colour": bool(lens.lateral_colour),
        "ranges_mm": list(plan.rail.ranges_mm),
        "pixels": drawn.settings.sensor.rows,
    }


def compared(results: Line, truth: Truth) -> Line:
    """Errors over standard errors of all that results.json tells, and how many fits ended in a wrong optimum.

    Ranges are those that the encoder read: their zero holds the tape's error and that of the home switch. F-number and modes
    are those of the full pupil, whatever a cat's eye cuts.
    """
    zero_mm = truth.visits[0].range_zero_mm
    best_mm = {
        colour: mm + truth.range_zero_mm - zero_mm
        for colour, mm in truth.best_focus_mm.items()
    }
    z: dict[str, list[float]] = {}
    lens, focus = results.get("lens") or {}, results.get("focus") or {}
    pupils = lens.get("pupil_magnification") or focus.get("pupil_magnification")
    _add(z, "focal_length", lens.get("focal_length_mm"), truth.focal_length_mm)
    _add(z, "f_number", lens.get("f_number"), truth.f_number)
    _add(z, "pupil_magnification", pupils, truth.pupil_magnification)
    _add(z, "range_zero", lens.get("range_zero_mm"), zero_mm)
    # away from the axis a lens that changes over the frame has another best focus than the truth's, which is the axis's
    found_mm = {} if truth.field_terms else focus.get("best_focus_mm", {})
    for colour, best in found_mm.items():
        _add(z, "best_focus", best, best_mm[colour])
    counts = dict.fromkeys(COUNTS, 0)
    counts["mended"] = sum(
        finding["code"] == "fit-mended" for finding in results["findings"]
    )
    wavefront = list[float]()
    for w in results["wavefronts"]:
        true = truth.waves(w["range_mm"], w["channel"])
        errors = np.array(w["waves_rms"]) - [true.get(j, 0.0) for j in w["noll"]]
        accepted, wrong = (
            w["global_test"]["accepted"],
            _is_wrong(errors[1:], np.array(w["std"][1:])),
        )
        fitted = dict(zip(w["noll"], w["waves_rms"], strict=True))
        apart = [fitted.get(j, 0.0) - true.get(j, 0.0) for j in {*fitted, *true}]
        wavefront.append(float(np.linalg.norm(apart)))
        counts["fits"] += 1
        if wrong or not accepted:
            counts[
                f"{'wrong' if wrong else 'right'}_{'accepted' if accepted else 'rejected'}"
            ] += 1
        for j, value in zip(w["noll"], errors / w["std"], strict=True):
            z.setdefault(f"noll.{j}", []).append(float(value))
    _add_pupil(z, lens.get("pupil") or {}, truth.pupil)
    return {"z": z, "wavefront": wavefront, **counts}


def _add_pupil(z: dict[str, list[float]], found: Line, true: Pupil) -> None:
    """Add the errors of the numbers of a pupil, as far as it was found to have what it has."""
    if true.obstruction:
        _add(z, "pupil.obstruction", found.get("obstruction"), true.obstruction)
    if true.blades and found.get("blades") == true.blades:
        _add(z, "pupil.roundness", found["roundness"], true.rounding)
        turned = 360 / true.blades
        _add(z, "pupil.turn_deg", found["turn_deg"], true.turn_deg, every=turned)
    if true.cats_eye and (eye := found.get("cats_eye")):
        shift, radius, direction_deg = true.cats_eye
        unit = true.opening / true.extent  # found ones are relative to the blades' corners
        _add(z, "pupil.shift", eye["shift"], shift * unit)
        _add(z, "pupil.radius", eye["radius"], radius * unit)
        _add(z, "pupil.direction_deg", eye["direction_deg"], direction_deg, every=360)


def _diagnosed(results: Line, plan: Plan) -> Line:
    """Return parts and groups of modes that were found beyond the plan, and the gains that score tests foresaw of others."""
    found = list(dict.fromkeys(name.split(".")[0] for name in results["model_parts"]))
    if plan.fit.zernike_noll is None:
        last = _last_mode(results)
        found += [name for name, group in MODE_GROUPS.items() if group.last <= last]
    foreseen = {
        tried["part"]: tried["gain"]
        for tried in results["parts_tried"]
        if not tried["adopted"]
    }
    gains = {name: gain for name, gain in foreseen.items() if name not in found}
    return {"found": found, "gains": gains, "widest_light_nm": results["widest_light_nm"]}


def _last_mode(results: Line) -> int:
    """Return the last mode that the photographs called for."""
    if results["lens"] is None:
        return max(int(j) for w in results["wavefronts"] for j in w["noll"])
    return int(results["lens"]["modes"]["noll"][1])


def _add(
    z: dict[str, list[float]],
    name: str,
    estimate: Line | None,
    true: float,
    every: float = math.inf,
) -> None:
    """Add the error over the standard error of an estimate, of a number that repeats after `every`."""
    if estimate and estimate["std"] > 0:
        error = math.remainder(estimate["value"] - true, every)
        z.setdefault(name, []).append(error / estimate["std"])


def _is_wrong(errors: np.ndarray[Any, Any], std: np.ndarray[Any, Any]) -> bool:
    return bool(np.linalg.norm(errors) > max(WRONG_WAVES, 6 * float(np.linalg.norm(std))))


def read(path: Path) -> list[Line]:
    """The whole lines of a file, which is cut after the last of them: a run may have been killed as it wrote."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return [json.loads(line) for line in whole.splitlines()]


def main() -> None:
    """Run what is left of a study, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="a JSON line for each session")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="keep the sessions in this folder")
    parser.add_argument(
        "--study", choices=STUDIES, default="any", help="which sessions are drawn"
    )
    parser.add_argument(
        "--plain", action="store_true", help="fit with no part that the plan does not state"
    )
    parser.add_argument(
        "--limit-s",
        type=float,
        default=0,
        help="processor time that a fit may take; 0: no limit",
    )
    asked = parser.parse_args()
    kind = (asked.study, asked.seed, asked.plain)

    def of_study() -> list[Line]:
        return [
            line
            for line in read(asked.out)
            if (line["study"], line["seed"], line["plain"]) == kind
        ]

    done = {line["index"] for line in of_study()}
    left = [index for index in range(asked.sessions) if index not in done]
    jobs = [
        Job(asked.study, asked.seed, index, asked.keep, asked.plain, asked.limit_s)
        for index in left
    ]
    with asked.out.open("a", encoding="utf-8") as file:
        for _, line in run_all(run, jobs, asked.workers):
            file.write(json.dumps(line) + "\n")
            file.flush()
    tables = (table, parts_table, light_table, psf_table, wavefront_table)
    print(*(row for each in tables for row in each(of_study())), sep="\n")


if __name__ == "__main__":
    main()
