"""Tables of many simulated sessions, from the lines that `python -m benchmarks.sessions` writes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from scipy import stats

from labkit.estimation.camera import chance_gain, kind
from labkit.imaging.parts import KNOWN, OPTIONAL_PARTS
from labkit.plan.mode_groups import MODE_GROUPS

Line = dict[str, Any]

COUNTS = (
    "fits",
    "wrong_accepted",
    "wrong_rejected",
    "right_rejected",
    "mended",
)

PARTS = {
    "low_pass_px": "low_pass_filter",
    "spectrum": "spectrum",
    "diffusion_px": "diffusion",
    "smear": "smear",
    "veil": "veil",
}
"""By name in a drawn session, as results name them."""

HIGHER_GROUPS = ("modes_16_21", "modes_22_28", "modes_29_36")
"""Groups of modes that every lens as it is made has."""

REAL_GROUPS = (*HIGHER_GROUPS, "modes_37_37")
"""Groups of modes that the commercial lens has."""

BLADES = tuple(name for name in KNOWN if name.startswith("blades_"))

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
    "blades": ("pupil.roundness", "pupil.turn_deg"),
    "obstruction": ("pupil.obstruction",),
    "cat's eye": ("pupil.shift", "pupil.radius", "pupil.direction_deg"),
}


def true_parts(line: Line) -> frozenset[str]:
    """Return the parts and groups of modes that a session's camera and lens have, as results name them."""
    names = {PARTS[name] for name in line.get("parts", {})}
    if "field_deg" in line:
        names |= set(REAL_GROUPS)
    made = line.get("as_made")
    if made is not None:
        names |= {name for name in ("obstruction", "cats_eye") if made.get(name)}
        names |= {f"blades_{made['blades']}"} if made.get("blades") else set()
        names |= set(HIGHER_GROUPS) if made.get("higher_waves") else set()
    return frozenset(names)


def parts_table(lines: Iterable[Line]) -> Iterator[str]:
    """Yield a row for each kind of part that a session has or found.

    A part that was not found is missed where its score test gains more than chance. A part that was found and is absent
    stands in for a part that explains the same departures and was not found, and is invented otherwise.
    """
    done = [(true_parts(line), line) for line in lines if line["failed"] is None]
    every = {name for true, line in done for name in true | set(line["found"])}
    rows = {name: (name,) for name in OPTIONAL_PARTS if name not in BLADES}
    for title, names in {**rows, "blades": BLADES}.items():
        if every & set(names):
            yield f"{title}: {_counted(done, names)}"


def _counted(done: list[tuple[frozenset[str], Line]], names: tuple[str, ...]) -> str:
    """Return in how many sessions one of some parts was found, missed, stands in or is invented."""
    having = [(name, line) for true, line in done for name in names if name in true]
    found = sum(name in line["found"] for name, line in having)
    missed = [line for name, line in having if _missed(name, line)]
    absent = [
        (_stands_in(name, true, line), line)
        for true, line in done
        for name in names
        if name in line["found"] and name not in true
    ]
    invented = [line for stands_in, line in absent if not stands_in]
    return (
        f"found in {found} of the {len(having)} that have it, "
        f"missed in {_listed(missed)}; absent, it stands in for another part in "
        f"{len(absent) - len(invented)}, is invented in {_listed(invented)}"
    )


def _listed(lines: list[Line]) -> str:
    """Return the number of some sessions, and which they are."""
    if not lines:
        return "0"
    return f"{len(lines)} ({', '.join(str(line['index']) for line in lines)})"


def _missed(name: str, line: Line) -> bool:
    """Return whether a part was not found although it is worth more than chance."""
    numbers = (
        len(MODE_GROUPS[name].noll) if name in MODE_GROUPS else len(KNOWN[name].labels)
    )
    gain = line["gains"].get(name, 0.0)
    return name not in line["found"] and gain > chance_gain(numbers)


def _stands_in(name: str, true: frozenset[str], line: Line) -> bool:
    """Return whether the session has a part of the same kind that was not found."""
    return any(kind(one) == kind(name) and one not in line["found"] for one in true)


def light_table(lines: Iterable[Line]) -> Iterator[str]:
    """Yield the light that photographs allow, of the lines whose light is broad."""
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
    """Yield the errors of PSFs, of the lines that tell them."""
    done = [line for line in lines if line["failed"] is None]
    pairs = [pair for line in done for pair in line.get("psf", [])]
    if pairs:
        error, stated = np.array(pairs).T
        ratio = error / stated
        yield (
            f"PSFs: L1 errors of {100 * np.median(error):.2g} % in the median, "
            f"{100 * error.max():.2g} % at most, {np.mean(error < 0.005):.0%} below 0.5 %; "
            f"over the stated error {np.median(ratio):.2f} in the median, more than 2 in "
            f"{(ratio > 2).sum()} of {ratio.size}"
        )
    chances = [line["psf_chance"] for line in done if line.get("psf_chance") is not None]
    if chances:
        z = np.asarray(stats.norm.ppf(chances))
        yield (
            f"PSF's L1 among those of the wavefront's errors, one a session: n {z.size}, mean {z.mean():.2f}, "
            f"std {z.std():.2f}, KS p {stats.kstest(z, 'norm').pvalue:.2g}"
        )


def wavefront_table(lines: Iterable[Line]) -> Iterator[str]:
    """Yield the errors of whole wavefronts, modes that were not fitted included, of the lines that tell them."""
    rms = [e for line in lines if line["failed"] is None for e in line.get("wavefront", [])]
    if rms:
        yield (
            f"wavefronts: errors of {np.median(rms):.2g} waves RMS in the median, "
            f"{max(rms):.2g} at most, {np.mean(np.array(rms) < 0.005):.0%} below 0.005"
        )


def _std(lines: Iterable[tuple[float, float]]) -> float:
    """Return the standard deviation of wavelengths with shares of the light."""
    nm, shares = np.array([*lines]).T
    return float(np.sqrt(shares @ (nm - shares @ nm) ** 2))


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
