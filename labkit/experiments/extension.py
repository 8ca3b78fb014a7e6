"""Holes and surroundings filled with the least bandwidth, beside in-painting: thesis Appendix A, Figures A.2 and A.3."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from labkit.errors import InputError
from labkit.experiments.methods.smooth_extension import fill
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.figure_style import panels
from labkit.types import Bools, Floats

EXTENDED_PICTURES = (
    "camera",
    "moon",
    "coins",
    "brick",
    "grass",
    "page",
)  # scikit-image's, which lie on the disk with it
SIDE = 128  # samples of a picture, each the mean of several
EXTERIOR = SIDE // 8  # wide, on every side, where it is unknown
RADIUS = 3  # samples around a hole that OpenCV's two look at
MINIMUM_BANDWIDTH = "minimum bandwidth"
NEAREST = "biharmonic"


@dataclass(frozen=True)
class Task:
    picture: str
    mask: str
    exterior_known: bool


@dataclass(frozen=True)
class Answer:
    """filled: (SIDE, SIDE) radiance by method; seconds: of each method."""

    truth: Floats
    known: Bools
    filled: dict[str, Floats]
    seconds: dict[str, float]

    def psnr_db(self, method: str, *, whole: bool) -> float:
        """Return the PSNR against the full range of radiance, over the interior or the whole image."""
        error = self.filled[method] - self.truth
        return float(-10 * np.log10(np.mean((error if whole else interior(error)) ** 2)))


def interior(image: Floats) -> Floats:
    """Return the part of an image that is not exterior."""
    return image[EXTERIOR:-EXTERIOR, EXTERIOR:-EXTERIOR]


def picture(name: str) -> Floats:
    """Return (SIDE, SIDE) radiance 0..1: the middle of one of scikit-image's pictures.

    Raises InputError without scikit-image.
    """
    whole = np.asarray(getattr(_skimage("data"), name)(), dtype=np.float64) / 255
    many = min(whole.shape) // SIDE
    top, left = ((side - many * SIDE) // 2 for side in whole.shape)
    middle = whole[top : top + many * SIDE, left : left + many * SIDE]
    return np.asarray(middle.reshape(SIDE, many, SIDE, many).mean(axis=(1, 3)))


def masks(rng: np.random.Generator) -> dict[str, Bools]:
    """Return (SIDE, SIDE) masks of known samples: without a checkerboard's squares, scattered samples, squares,
    scratches.
    """
    row, col = np.indices((SIDE, SIDE))
    scratches = np.zeros((SIDE, SIDE), np.uint8)
    for ends in rng.integers(0, SIDE, (24, 4)):
        cv2.line(scratches, tuple(map(int, ends[:2])), tuple(map(int, ends[2:])), 1, 2)
    return {
        "checkerboard": (row // 3 + col // 3) % 2 == 0,
        "half": rng.random((SIDE, SIDE)) < 0.5,
        "a quarter": rng.random((SIDE, SIDE)) < 0.25,
        "squares": (row % 16 >= 6) | (col % 16 >= 6),
        "scratches": scratches == 0,
    }


def methods() -> dict[str, Callable[[Floats, Bools], Floats]]:
    """Name -> (image, known) -> image. Raises InputError where scikit-image is missing."""
    biharmonic = _skimage("restoration").inpaint_biharmonic

    def by_opencv(how: int) -> Callable[[Floats, Bools], Floats]:
        def filled(image: Floats, known: Bools) -> Floats:
            # 8 bits, which both are made for: of a picture in floats one of them makes nonsense
            grey = np.rint(255 * image).astype(np.uint8)
            return np.where(
                known,
                image,
                cv2.inpaint(grey, (~known).astype(np.uint8), RADIUS, how) / 255.0,
            )

        return filled

    return {
        MINIMUM_BANDWIDTH: fill,
        NEAREST: lambda image, known: np.asarray(biharmonic(image, ~known)),
        "OpenCV, Navier-Stokes": by_opencv(cv2.INPAINT_NS),
        "OpenCV, Telea": by_opencv(cv2.INPAINT_TELEA),
    }


def work(task: Task) -> Answer:
    """Fill one picture's holes in every way."""
    truth = picture(task.picture)
    known = masks(np.random.default_rng(0))[task.mask]
    if not task.exterior_known:
        inside = np.zeros_like(known)
        inside[EXTERIOR:-EXTERIOR, EXTERIOR:-EXTERIOR] = True
        known = known & inside
    given = np.where(known, truth, 0.0)
    filled = {}
    seconds = {}
    for name, method in methods().items():
        began = perf_counter()
        filled[name] = method(given, known)
        seconds[name] = perf_counter() - began
    return Answer(truth, known, filled, seconds)


def run(setting: Setting) -> Outcome:
    """Measure the peak signal-to-noise ratio of each method, with the exterior unknown (A.2) and known (A.3)."""
    names = list(masks(np.random.default_rng(0)))
    pictures, which = (
        (EXTENDED_PICTURES[:1], names[:2]) if setting.quick else (EXTENDED_PICTURES, names)
    )
    tasks = [Task(p, m, known) for known in (False, True) for p in pictures for m in which]
    in_order = all_answers(
        setting, work, tasks, lambda task: f"{task.picture}, {task.mask}"
    )
    answers = dict(zip(tasks, in_order, strict=True))
    rows = [
        {
            "figure": "A.3" if task.exterior_known else "A.2",
            "picture": task.picture,
            "mask": task.mask,
            "method": name,
            "psnr_db": answers[task].psnr_db(name, whole=False),
            "psnr_whole_db": answers[task].psnr_db(name, whole=True),
            "seconds": answers[task].seconds[name],
        }
        for task in tasks
        for name in answers[task].filled
    ]

    def draw() -> Figure:
        figure, axes = panels(12, 6, 2.0)
        for k, known in enumerate((False, True)):
            answer = answers[Task(EXTENDED_PICTURES[0], names[0], known)]
            shown = {
                "picture": answer.truth,
                "known": np.where(answer.known, answer.truth, 0),
            } | answer.filled
            for axis, (name, image) in zip(axes[6 * k :], shown.items(), strict=False):
                axis.imshow(image, cmap="gray", vmin=0, vmax=1)
                axis.set_axis_off()
                if name in answer.filled:
                    inside, whole = (answer.psnr_db(name, whole=w) for w in (False, True))
                    name += f"\n{inside:.1f} dB ({whole:.1f})"
                axis.set_title(name, fontsize=7)
        return figure

    return Outcome(_claims(rows, len(pictures) * len(which)), rows, draw)


def _claims(rows: list[dict[str, Any]], n: int) -> list[Claim]:
    """Return the claims; the thesis's figures are of another picture and mask, and of other methods.

    The thesis compares sparse and PDE in-painting.
    """

    def mean(figure: str, method: str, key: str = "psnr_db") -> float:
        return float(
            np.mean(
                [
                    row[key]
                    for row in rows
                    if row["figure"] == figure and row["method"] == method
                ]
            )
        )

    others = [
        name
        for name in dict.fromkeys(row["method"] for row in rows)
        if name != MINIMUM_BANDWIDTH
    ]
    claims = []
    for figure, where, thesis in (
        ("A.2", "exterior unknown", 28.8),
        ("A.3", "exterior known", 30.78),
    ):
        ours = mean(figure, MINIMUM_BANDWIDTH)
        claims.append(Claim(f"PSNR of {MINIMUM_BANDWIDTH}, {where}", thesis, ours, "dB", n))
        claims += [
            Claim(
                f"{MINIMUM_BANDWIDTH} over {name}, {where}",
                None,
                ours - mean(figure, name),
                "dB",
                n,
            )
            for name in others
        ]
    ours = mean("A.2", MINIMUM_BANDWIDTH, "psnr_whole_db")
    claims.append(
        Claim(f"PSNR of {MINIMUM_BANDWIDTH}, exterior and all", 17.6, ours, "dB", n)
    )
    for name in others:
        over = ours - mean("A.2", name, "psnr_whole_db")
        claims.append(
            Claim(f"{MINIMUM_BANDWIDTH} over {name}, exterior and all", None, over, "dB", n)
        )
    return claims


def _skimage(part: str) -> Any:
    try:
        import skimage
    except ImportError as error:
        raise InputError(
            "the study of extensions needs scikit-image: pip install 'labkit[study]'"
        ) from error
    return getattr(skimage, part)
