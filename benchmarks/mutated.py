"""What damaged inputs of every kind do: `python -m benchmarks.mutated --seconds 100`, so long for each kind.

Each input is taken, or refused in one printable line, within `MOST_S` and `MOST_BYTES`; anything else is a fault, whose input
is kept in the folder of --keep. The same seed makes the same inputs.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import shutil
import signal
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import cv2
import numpy as np
import tifffile
from PIL import Image

from labkit.catalogue.sessions import list_sessions
from labkit.catalogue.store import catalogue_file
from labkit.cli import run
from labkit.drivers.grbl import protocol as grbl
from labkit.drivers.grbl.rail import GrblRail
from labkit.errors import LabkitError
from labkit.estimation.residuals import Verdict
from labkit.noise.emva import camera_model
from labkit.noise.levels import read_series
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import read_exif
from labkit.photographs.picture_file import read_picture
from labkit.plan import Plan
from labkit.results import Results
from labkit.session.import_frames import read_rows
from labkit.session.journal import encode
from labkit.session.session import Session
from labkit.session.verify import verify
from labkit.storage import typed_file
from labkit.types import no_progress
from tests.chart_scenes import PLAN as CHART_PLAN
from tests.chart_scenes import chart, checkerboard, working_f_number
from tests.dng import write_dng
from tests.edge_scenes import FOCUS_MM, box, lens_results, square, write_scene
from tests.ladders import EXPOSURES_S, ladder
from tests.mutations import NASTY, mended_png, mutated
from tests.plans import PORTRAIT, plan_text
from tests.results_samples import full_results

MOST_S = 10.0
"""Longest time for an input."""

MOST_BYTES = 2**31
"""Memory that an input may add."""

WORDS = (
    *NASTY,
    *(
        b"=",
        b"[",
        b"]]",
        b"{",
        b"}",
        b",",
        b";",
        b":",
        b"'''",
        b".a" * 50,
        b"null",
        b"true",
    ),
    *(b"1e308", b"-1e-320", b"0", b"99999999999", b"NaN", b"Infinity", b"f/2.8", b"1,5"),
)
"""Tokens of texts."""

GRBL_LINES = (
    b"Grbl 1.1h ['$' for help]\n\n[VER:1.1h.20190825:]\n[OPT:V,15,128]\n$1=255\n$10=1\n$13=0\n$20=1\n$21=1\n$22=1\n"
    b"$23=0\n$24=25.0\n$25=500.0\n$27=1.0\n$100=250.0\n$110=500.0\n$120=10.0\n$130=300.0\nok\n"
    b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\nok\n"
    b"<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000|Pn:XP>\n"
)
"""A controller's answers as a rail is opened; at an empty line nothing comes for a while."""


class PlayedRail(GrblRail):
    """A rail whose controller says given lines, whatever it is asked."""

    def __init__(self, said: bytes) -> None:
        self._said = iter(said.decode("ascii", errors="replace").split("\n"))
        super().__init__("a port", reply_s=0.01)

    def _open(self, begin: Callable[[], None]) -> None:
        begin()

    def _send(self, data: bytes) -> None:
        pass

    def _line(self, deadline_s: float) -> str | None:
        return next(self._said, "") or None


class SlowError(BaseException):
    """An input takes longer than `MOST_S`; no handler of errors takes it."""


class FaultError(Exception):
    """A command says that labkit has a fault, or says nothing that fits a line."""


@dataclass
class Kind:
    """A kind of input.

    whole : undamaged contents
    read : takes a damaged one
    tokens : put into contents
    mend : makes the checksums of a damaged content right, as whoever forges a file does; every second input is mended
    """

    whole: Sequence[bytes]
    read: Callable[[bytes], object]
    tokens: Sequence[bytes] = NASTY
    mend: Callable[[bytes], bytes] = bytes


@dataclass
class Counts:
    """What became of inputs."""

    ends: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0


def repacked(content: bytes) -> bytes:
    """Return a damaged NPZ file with checksums that fit the damage, where its archive can be read."""
    made = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w") as new:
            for entry in old.infolist():
                del entry.CRC  # then it is not compared
                new.writestr(entry.filename, old.open(entry).read(2**24))
    except Exception:  # zipfile lets through whatever a damaged entry breaks
        return content
    return made.getvalue()


def rechained(content: bytes) -> bytes:
    """Return a damaged journal whose lines that are JSON have right checksums."""
    lines, after = [], ""
    for line in content.split(b"\n"):
        try:
            event = json.loads(line)
            event = {key: event[key] for key in event if key not in ("check", "after")}
            line, after = encode(event, after)
        except (ValueError, TypeError, RecursionError):
            line += b"\n"
        lines.append(line)
    return b"".join(lines)


@contextmanager
def limited() -> Iterator[None]:
    """Limit time and memory of an input."""

    def slow(*_: object) -> None:
        raise SlowError

    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    handler = signal.signal(signal.SIGALRM, slow)
    timer = signal.setitimer(signal.ITIMER_REAL, MOST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def end_of(read: Callable[[bytes], object], content: bytes) -> str:
    """Return what became of an input: "taken", "refused", or a fault in words."""
    try:
        with limited():
            read(content)
    except (LabkitError, OSError) as error:
        words = str(error)
        short = words.isprintable() and len(words) < 4000
        return "refused" if short else f"no line: {words[:200]!r}"
    except SlowError:
        return f"longer than {MOST_S:g} s"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return (
            f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
        )
    return "taken"


def command(*words: str) -> None:
    """Run a command. Raises FaultError where it ends in anything but a result or one line."""
    printed, err = io.StringIO(), io.StringIO()
    with redirect_stdout(printed), redirect_stderr(err):
        status = run(["--debug", *words])
    lines = err.getvalue().splitlines()
    said = [line for line in lines if line.startswith("labkit: ")]
    strange = [line for line in said if not line.isprintable()]
    faults = [line for line in said if "fault in labkit" in line or "enough memory" in line]
    if strange or faults or status not in (0, 1, 2):
        last = [line.strip() for line in lines if line.startswith("  File")][-1:]
        raise FaultError(f"{(strange + faults)[:1]} {last} status {status}")
    if status:
        raise LabkitError("refused")


MENDED = {".npz": repacked, ".jsonl": rechained}


def kinds(folder: Path) -> dict[str, Kind]:
    """Return all kinds of input, with the files that they need in a folder."""
    return {**texts(folder), **sessions(folder), **pictures(folder), **scenes(folder)}


def texts(folder: Path) -> dict[str, Kind]:
    """Return plans, lists, and what a rail's controller says."""
    plan = Plan.parse(plan_text(PORTRAIT))

    def read_plan(content: bytes) -> None:
        (folder / "plan.toml").write_bytes(content)
        read = Plan.load(folder / "plan.toml")
        assert Plan.parse(read.to_toml(), folder) == read

    def read_list(content: bytes) -> None:
        (folder / "frames.csv").write_bytes(content)
        read_rows(folder / "frames.csv", plan)

    def read_grbl(content: bytes) -> None:
        rail = PlayedRail(content)
        rail.check(10)
        grbl.homing_s(rail._settings)
        grbl.moving_s(rail._settings, 100.0)

    rows = b'file,kind,range_mm,lens\na.dng,target,3000,"70, wide"\nb 1.dng,flat,3000.5,\nc/d.dng,dark,,\n'
    every = plan_text(
        PORTRAIT, {"target": {"kind": "image", "order": None, "file": "print.pgm"}}
    )
    (folder / "print.pgm").write_bytes(b"P5 2 2 255\n\x00\xff\xff\x00")
    return {
        "plan": Kind([plan_text(PORTRAIT).encode(), every.encode()], read_plan, WORDS),
        "list": Kind([rows, rows.replace(b",", b";")], read_list, WORDS),
        "grbl": Kind([GRBL_LINES], read_grbl, (*NASTY, b"=", b"|", b"<", b">", b"$", b"0")),
    }


def sessions(folder: Path) -> dict[str, Kind]:
    """Return the files of a session, of its results, and of the catalogue."""
    made = folder / "sessions" / "night"
    made.parent.mkdir()
    photograph = folder / "a.dng"
    write_dng(photograph, np.full((20, 30), 700, np.uint16))
    with Session.create(made, plan_text(PORTRAIT), folder) as session:
        session.add_frame(photograph, "a.dng", "target", 3000.0)
    results = made / "results" / "latest"
    full_results().write(results)
    list_sessions(made.parent)

    def in_place(path: Path, read: Callable[[], object]) -> Kind:
        whole = path.read_bytes()

        def read_damaged(content: bytes) -> None:
            path.write_bytes(content)
            try:
                read()
            finally:
                path.write_bytes(whole)

        tokens = NASTY if path.suffix == ".npz" else WORDS
        return Kind([whole], read_damaged, tokens, MENDED.get(path.suffix, bytes))

    def use_results() -> None:
        found = Results.load(made)
        found.headline, found.unanswered, repr(found), found._repr_html_()
        command("list", str(made.parent))

    def read_fit(content: bytes) -> None:
        try:
            typed_file.load(content, Verdict)
        except ValueError as error:
            raise LabkitError(
                str(error)[:200].encode("ascii", "replace").decode()
            ) from None

    kept = catalogue_file(made.parent)
    fit = typed_file.dump(Verdict(0.5, True, 0.0, 0.0), Verdict)
    return {
        "results": in_place(results / "results.json", use_results),
        "residuals": in_place(results / "residuals.npz", lambda: Results.load(made)),
        "field": in_place(results / "field.npz", lambda: Results.load(made)),
        "journal": in_place(made / "journal.jsonl", lambda: verify(made)),
        "catalogue": in_place(kept, lambda: command("list", str(made.parent))),
        "kept-fit": Kind([fit], read_fit, mend=repacked),
    }


def pictures(folder: Path) -> dict[str, Kind]:
    """Return photographs by format."""
    numbers = np.random.default_rng(1).integers(500, 16000, (40, 60)).astype(np.uint16)
    sensor = Plan.parse(plan_text(PORTRAIT)).sensor
    dng = write_dng(folder / "photo.dng", numbers).read_bytes()
    plain, packed, jpeg = io.BytesIO(), io.BytesIO(), io.BytesIO()
    tifffile.imwrite(plain, numbers)
    Image.fromarray(numbers).save(packed, format="tiff", compression="tiff_lzw")
    grey = Image.fromarray((numbers >> 6).astype(np.uint8))
    exif = Image.Exif()
    exif.update({271: "Acme", 272: "D1", 33434: 0.02, 36867: "2026:01:02 03:04:05"})
    grey.save(jpeg, format="jpeg", exif=exif)

    def read(content: bytes) -> None:
        path = folder / "photo.bin"
        path.write_bytes(content)
        read_exif(path)
        assert read_picture(path, processed=True).numbers.nbytes < 2**27

    def read_raw(content: bytes) -> None:
        (folder / "photo.dng").write_bytes(content)
        read_exif(folder / "photo.dng")
        read_photograph(folder / "photo.dng", sensor)

    return {
        "dng": Kind([dng], read_raw),
        "tiff": Kind([plain.getvalue(), packed.getvalue()], read),
        "png": Kind([cv2.imencode(".png", numbers)[1].tobytes()], read, mend=mended_png),
        "jpeg": Kind([jpeg.getvalue()], read),
        "pgm": Kind([pgm(numbers)], read),
    }


def pgm(numbers: np.ndarray) -> bytes:
    """Return a picture in the one format whose every damaged byte is another number."""
    rows, cols = numbers.shape
    return b"P5\n%d %d\n65535\n" % (cols, rows) + numbers.astype(">u2").tobytes()


def scenes(folder: Path) -> dict[str, Kind]:
    """Return photographs that are measured: edges, a chart, noise, and one that is restored."""
    plan = folder / "edges.toml"
    plan.write_text(CHART_PLAN)
    psf = folder / "lens"
    lens_results().write(psf / "results" / "latest")
    image = folder / "scene.pgm"
    edge = tifffile.imread(write_scene(folder / "s.tif", [square(1500.0, 0.15)]))
    board = chart((1, 2), lambda *_: np.zeros(6), working_f_number(FOCUS_MM), checkerboard)
    charted = tifffile.imread(write_scene(folder / "c.tif", [board]))
    series = ladder(folder / "noise", 1, EXPOSURES_S[::2])
    flat = next(one.path for one in series.frames if one.kind == "flat")

    def measured(*words: str) -> Callable[[bytes], object]:
        def read(content: bytes) -> None:
            image.write_bytes(content)
            shutil.rmtree(folder / "restored", ignore_errors=True)
            command(*(str(image) if word == "IMAGE" else word for word in words))

        return read

    def read_noise(content: bytes) -> None:
        flat.write_bytes(content)
        levels = read_series(series.frames, series.camera.sensor, ["M"], no_progress)
        camera_model(levels["M"])

    one = ("--workers", "1", "--json")
    edges = ("edges", "IMAGE", str(plan), "--box", ",".join(map(str, box(0))), *one)
    out = ("--out", str(folder / "restored"), "--force", "--json")
    return {
        "edges": Kind([pgm(edge)], measured(*edges)),
        "chart": Kind([pgm(charted)], measured("chart", "IMAGE", str(plan), *one)),
        "noise": Kind([flat.read_bytes()], read_noise),
        "restore": Kind([pgm(edge)], measured("restore", "IMAGE", "--psf", str(psf), *out)),
    }


def campaign(kind: Kind, seed: int, seconds: float, keep: Path) -> Counts:
    """Read damaged inputs of a kind for some seconds, and keep those that end in a fault."""
    counts = Counts()
    began = perf_counter()
    for whole in kind.whole:
        if (end := end_of(kind.read, whole)) != "taken":
            counts.ends[f"undamaged: {end}"] += 1
    for turn in count():
        whole = kind.whole[turn % len(kind.whole)]
        for content in mutated(whole, 20, tokens=kind.tokens, seed=seed + turn):
            content = kind.mend(content) if counts.ends.total() % 2 else content
            before = perf_counter()
            if before - began > seconds:
                return counts
            end = end_of(kind.read, content)
            counts.slowest_s = max(counts.slowest_s, perf_counter() - before)
            counts.ends[end] += 1
            if end not in ("taken", "refused") and counts.ends[end] == 1:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{len(counts.ends)}").write_bytes(content)
    return counts


def main() -> None:
    """Print what became of the inputs of each kind, and each fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", nargs="*")
    parser.add_argument("--keep", type=Path, default=Path("build/mutated"))
    given = parser.parse_args()
    with TemporaryDirectory() as base:
        os.environ["XDG_STATE_HOME"] = base
        every = kinds(Path(base))
        for name in given.kinds or every:
            keep = given.keep / name
            counts = campaign(every[name], given.seed, given.seconds, keep)
            ends = counts.ends
            print(
                f"{name:10s} {ends.total():7d} inputs, {ends['taken']:6d} taken, {ends['refused']:6d} refused, "
                f"slowest {counts.slowest_s:.2f} s",
                flush=True,
            )
            for words, times in ends.most_common():
                if words not in ("taken", "refused"):
                    print(f"    {times} × {json.dumps(words)[:400]}", flush=True)
    print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
