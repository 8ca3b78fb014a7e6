"""Errors over stated errors of many sessions, each fitted as it came: `python -m benchmarks.sessions OUT.jsonl --sessions 200`.

Lens, tape, target and home switch of each are off from what its plan states, by the errors that the plan has for them
(benchmarks/random_sessions.py). Each session is a line in the file as soon as it is done; run again, the same command goes on,
and with nothing left to do prints the table only.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import stats

import labkit
from benchmarks.psf_errors import psf_errors
from benchmarks.random_sessions import KINDS, Drawn, make
from labkit.drivers.simulated.world import Truth
from labkit.estimation.camera import chance_gain
from labkit.execute import run_all
from labkit.imaging.parts import KNOWN
from labkit.results import Results

Line = dict[str, Any]

COUNTS = (
    "fits",
    "wrong_accepted",
    "wrong_rejected",
    "right_rejected",
    "mended",
)

WRONG_WAVES = 0.03
"""RMS over the modes above defocus beyond which, and beyond six standard errors, an optimum is another one than the right."""

PARTS = {
    "low_pass_px": "low_pass_filter",
    "spectrum": "spectrum",
    "diffusion_px": "diffusion",
    "smear": "smear",
    "veil": "veil",
}
"""By name in a drawn session, as results name them."""

TURNED = "low_pass_filter_turned"
BLURS = ("low_pass_filter", TURNED, "diffusion", "smear")

FAR_Z = 4.0
"""One error in 16,000 of a unit normal is beyond."""

ROWS = {
    "f-number": ("f_number",),
    "focal length": ("focal_length",),
    "pupil magnification": ("pupil_magnification",),
    "range zero": ("range_zero",),
    "best focus": ("best_focus",),
    "defocus": ("noll.4",),
    "other modes": tuple(f"noll.{j}" for j in range(5, 23)),
    "modes beyond 22": tuple(f"noll.{j}" for j in range(23, 46)),
}


@dataclass(frozen=True, slots=True)
class Job:
    """A session of a study, to be made and fitted. keep: the folder for sessions that are not thrown away.

    plain: fitted as its plan has it, whatever the camera has besides.
    """

    study: str
    seed: int
    index: int
    keep: Path | None
    plain: bool = False


def run(job: Job) -> Line:
    """Make a session, fit it without its truth, and compare."""
    drawn = KINDS[job.study](job.seed, job.index)
    with TemporaryDirectory(prefix="labkit-sessions-") as base:
        folder = (job.keep or Path(base)) / f"{job.seed}-{job.index}"
        shutil.rmtree(folder, ignore_errors=True)  # what a run that was killed had kept
        started = time.perf_counter()
        truth = make(drawn, folder)
        made = time.perf_counter()
        line = _described(job, drawn) | {"failed": None}
        try:
            labkit.fit(folder, workers=1, plain=job.plain)
            results = json.loads((folder / "results/latest/results.json").read_text())
            line |= compared(results, truth) | _diagnosed(results)
            line["psf"] = psf_errors(Results.load(folder), drawn.settings.lens, truth)
        except (
            Exception
        ) as error:  # whatever it is, it is a finding of the study and not its end
            line["failed"] = f"{type(error).__name__}: {error}"
    return line | {
        "making_s": round(made - started, 1),
        "fitting_s": round(time.perf_counter() - made, 1),
    }


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
    return {"z": z, "wavefront": wavefront, **counts}


def _diagnosed(results: Line) -> Line:
    """Parts of the camera that were found, and the most that each of the others was seen to gain, in log-likelihood."""
    found = list(dict.fromkeys(name.split(".")[0] for name in results["model_parts"]))
    last = {
        tried["part"]: tried["gain"]
        for tried in results["parts_tried"]
        if not tried["adopted"]
    }
    gains = {name: gain for name, gain in last.items() if name not in found}
    return {"found": found, "gains": gains, "widest_light_nm": results["widest_light_nm"]}


def parts_table(lines: Iterable[Line]) -> Iterator[str]:
    """What is printed of the parts of cameras in the lines that have any.

    A part that was not found is missed where it would have gained more than is called for. One found that the camera has not
    stands in for another where that one, blur of the same kind, was not found, and is invented else.
    """
    done = [
        (set(map(PARTS.get, line["parts"])), line)
        for line in lines
        if line["failed"] is None and "parts" in line
    ]
    for name in (*PARTS.values(), TURNED) if done else ():
        with_it = [line for true, line in done if name in true]
        found = sum(name in line["found"] for line in with_it)
        missed = sum(
            name not in line["found"]
            and line["gains"].get(name, 0.0) > chance_gain(len(KNOWN[name].labels))
            for line in with_it
        )
        more = [
            (true, line)
            for true, line in done
            if name in line["found"] and name not in true
        ]
        stands_in = sum(
            name in BLURS and any(b in true and b not in line["found"] for b in BLURS)
            for true, line in more
        )
        yield (
            f"{name}: found in {found} of the {len(with_it)} that have it, missed in {missed}; in the other "
            f"{len(done) - len(with_it)} it stands in for another blur in {stands_in}, is invented in {len(more) - stands_in}"
        )


def light_table(lines: Iterable[Line]) -> Iterator[str]:
    """What is printed of the light that photographs allow, in the lines whose light is broad."""
    pairs = [
        (most, _std(line["parts"]["spectrum"][channel]))
        for line in lines
        if line["failed"] is None and "spectrum" in line.get("parts", {})
        for channel, most in line.get("widest_light_nm", {}).items()
    ]
    if pairs:
        most, true = np.array(pairs).T
        yield (
            f"light: no broader than what is allowed in {(true <= most).sum()} of {true.size} channels, standard deviations of "
            f"{true.min():.0f} to {true.max():.0f} nm; {np.median(most):.0f} nm are allowed in the median"
        )


def psf_table(lines: Iterable[Line]) -> Iterator[str]:
    """What is printed of PSFs, in the lines that tell their errors."""
    pairs = [
        pair for line in lines if line["failed"] is None for pair in line.get("psf", [])
    ]
    if pairs:
        error, stated = np.array(pairs).T
        ratio = error / stated
        yield (
            f"PSFs: L1 errors of {100 * np.median(error):.2g} % in the median, "
            f"{100 * error.max():.2g} % at most; over the stated error "
            f"{np.median(ratio):.2f} in the median, more than 2 in "
            f"{(ratio > 2).sum()} of {ratio.size}"
        )


def wavefront_table(lines: Iterable[Line]) -> Iterator[str]:
    """What is printed of whole wavefronts, in the lines that tell their errors, modes that were not fitted included."""
    rms = [e for line in lines if line["failed"] is None for e in line.get("wavefront", [])]
    if rms:
        yield (
            f"wavefronts: errors of {np.median(rms):.2g} waves RMS in the median, "
            f"{max(rms):.2g} at most, {np.mean(np.array(rms) < 0.005):.0%} below 0.005"
        )


def _std(lines: Iterable[tuple[float, float]]) -> float:
    """Of wavelengths and their shares of the light."""
    nm, shares = np.array([*lines]).T
    return float(np.sqrt(shares @ (nm - shares @ nm) ** 2))


def _add(z: dict[str, list[float]], name: str, estimate: Line | None, true: float) -> None:
    if estimate and estimate["std"] > 0:
        z.setdefault(name, []).append((estimate["value"] - true) / estimate["std"])


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


def table(lines: Iterable[Line]) -> Iterator[str]:
    """What is printed of a study.

    Errors of one session go together: modes are the same at all its ranges, and all defocus hangs on its f-number. So each
    gives one error of a kind, each mode a kind of its own, of channels and ranges taken in turn.
    """
    every = list(lines)
    done = [line for line in every if line["failed"] is None]
    far_of_all = f"of all, beyond {FAR_Z:g}"
    heads = f"{'median |z|':>12}{'all within 1':>14}{'KS p':>9}{far_of_all:>20}"
    yield f"{'error / stated error':<22}{'n':>6}{'mean':>8}{'std':>7}{heads}"
    for name, keys in ROWS.items():
        known = [
            (line["index"], line["z"][key])
            for line in done
            for key in keys
            if key in line["z"]
        ]
        if known:
            z = np.array([values[index % len(values)] for index, values in known])
            sizes = np.abs(np.concatenate([values for _, values in known]))
            far, within = sizes > FAR_Z, f"{100 * np.mean(sizes < 1):.0f} %"
            p, middle = stats.kstest(z, "norm").pvalue, np.median(np.abs(z))
            beyond = f"{far.sum()} of {far.size}"
            yield f"{name:<22}{z.size:>6}{z.mean():>8.2f}{z.std():>7.2f}{middle:>12.2f}{within:>14}{p:>9.2g}{beyond:>20}"
    yield "a unit normal has mean 0, std 1, median |z| 0.67 and 68 % within 1"
    counts = (
        f"{key.replace('_', ' ')} {sum(line[key] for line in done)}" for key in COUNTS
    )
    yield f"{len(done)} sessions: {', '.join(counts)}"
    seconds = [sum(line[key] for line in every) for key in ("making_s", "fitting_s")]
    yield f"{seconds[0]:.0f} s of making, {seconds[1]:.0f} s of fitting"
    for line in every:
        if line["failed"] is not None:
            yield f"session {line['index']} failed: {line['failed']}"


def main() -> None:
    """Run what is left of a study, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="a JSON line for each session")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="keep the sessions in this folder")
    parser.add_argument(
        "--study", choices=KINDS, default="any", help="which sessions are drawn"
    )
    parser.add_argument(
        "--plain", action="store_true", help="fit with no part that the plan does not state"
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
    jobs = [Job(asked.study, asked.seed, index, asked.keep, asked.plain) for index in left]
    with asked.out.open("a", encoding="utf-8") as file:
        for _, line in run_all(run, jobs, asked.workers):
            file.write(json.dumps(line) + "\n")
            file.flush()
    tables = (table, parts_table, light_table, psf_table, wavefront_table)
    print(*(row for each in tables for row in each(of_study())), sep="\n")


if __name__ == "__main__":
    main()
