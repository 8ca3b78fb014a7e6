"""Scenes restored from red of a D7000's frames, defocused as at 3.2 m, alone and with the other colours, beside other methods:
thesis Figure 4.31."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.errors import InputError
from labkit.experiments.camera import Camera
from labkit.experiments.conditions import NOLL
from labkit.experiments.methods.restoration_baselines import BASELINES, interpolated, psf_of
from labkit.experiments.picture_camera import PictureCamera
from labkit.experiments.runner import Claim, Outcome, Setting, all_answers
from labkit.figure_style import panels
from labkit.imaging.optics import Optics
from labkit.restoration.colours import colour_coupling
from labkit.restoration.job import Colour, Exposure, Job
from labkit.restoration.registration import refined, registered
from labkit.restoration.strength import DISCREPANCY
from labkit.restoration.tiles import restore_job
from labkit.types import Floats

SCENE_PICTURES = (
    "camera",
    "coins",
    "brick",
    "grass",
    "moon",
    "page",
    "astronaut",
    "coffee",
    "chelsea",
)
"""scikit-image's, which lie on the disk with it: six grey ones and three in colour."""
REFERENCE_UM, SCENE_F_NUMBER, SCENE_PITCH_UM = (
    0.45,
    2.868,
    4.78,
)  # the cone at the sensor, focused at 3 m
WAVES = np.array(
    [0.0, 0.021, -0.018, 0.024, 0.019, -0.022, 0.013, 0.027, -0.015, 0.017, -0.012, 0.020]
)
SCENE_GAIN, SCENE_READ_NOISE, SCENE_WHITE = (
    0.45,
    1.13,
    10_350.0,
)  # counts an electron, counts, counts
SCENE_FRAME = 64
TORUS = 112
SQUARES = 2
SAMPLES = 6
GUARD = 16
QUICK_SAMPLES = 2
INSIDE_PX = 8  # from the border, where the frame's end no longer counts
FRAMES = 4
GRANTED = {
    "richardson-lucy": (25, 50, 100, 200, 400),
    "richardson-lucy-blind": (2, 4, 8),
} | {
    "wiener": (1e-5, 1e-4, 1e-3, 1e-2, 1e-1),
    "total-variation": (5e-4,),
}
"""Settings of the others, of which each scene's best is taken by its truth; ours are not chosen so."""
FULL_PSF = "full PSF"
DEFOCUS_ONLY = "defocus alone"
BLURRED = "interpolated"
SEVERAL = "four frames"
THREE_COLOURS = "three colours"


@dataclass(frozen=True, slots=True)
class Light:
    """One colour's pixels in the cell, and the lens at its wavelength. defocus_waves: RMS at the reference
    wavelength.
    """

    places: tuple[tuple[int, int], ...]
    wavelength_um: float
    defocus_waves: float

    def waves(self) -> Floats:
        """Return (modes,) waves at the reference wavelength."""
        return np.where(np.array(NOLL) == 4, self.defocus_waves, WAVES)


LIGHTS = {
    "R": Light(((0, 0),), 0.65, 1.068),
    "G": Light(((0, 1), (1, 0)), 0.55, 1.361),
    "B": Light(((1, 1),), 0.45, 0.852),
}
"""Defocus goes as 1/range - 1/best focus, which is at 3.024, 2.979 and 3.058 m (thesis Figure 4.30)."""


@dataclass(frozen=True)
class Task:
    """samples: restored samples to a pixel; fewer samples err more, and are quicker."""

    picture: str
    samples: int = SAMPLES


@dataclass(frozen=True)
class Answer:
    """restored: relative radiance by method, samples to a pixel; seconds: of each; covered: share of truth within 1 and 2
    errors of ours."""

    samples: int
    truth: Floats
    data: Floats
    restored: dict[str, Floats]
    seconds: dict[str, float]
    covered: tuple[float, float]

    def rmse(self, method: str, inside: bool = False) -> float:
        """Return the RMS error relative to white, over the frame or its inner part."""
        apart = self.restored[method] - self.truth
        border = INSIDE_PX * self.samples
        return float(
            np.sqrt(
                np.mean((apart[border:-border, border:-border] if inside else apart) ** 2)
            )
        )

    def ssim(self, method: str) -> float:
        """Return the structural similarity, relative to white's range."""
        similarity = _skimage("metrics").structural_similarity
        return float(similarity(self.truth, self.restored[method], data_range=1.0))


def scene(name: str) -> Floats:
    """Return (3, n, n) radiance 0..1 of a picture's middle, mirrored if too small, equal colours if grey.

    Raises InputError without scikit-image.
    """
    whole = (np.asarray(getattr(_skimage("data"), name)(), dtype=np.float64) / 255) ** 2.2
    whole = whole.transpose(2, 0, 1) if whole.ndim == 3 else np.stack(3 * [whole])
    side = SQUARES * TORUS
    missing = [max(side - n, 0) for n in whole.shape[1:]]
    whole = np.pad(
        whole, [(0, 0), *((m // 2, m - m // 2) for m in missing)], mode="reflect"
    )
    top, left = ((n - side) // 2 for n in whole.shape[1:])
    return np.asarray(whole[:, top : top + side, left : left + side])


def job_of(
    frames: list[Floats],
    samples: int = SAMPLES,
    names: str = "R",
    defocus_only: bool = False,
) -> Job:
    """Return a job of some colours of frames, with the estimator's knowledge; positions are registered."""
    lenses = [_lens(name, defocus_only) for name in names]
    used = np.zeros(frames[0].shape, bool)
    for lens in lenses:
        for row, column in lens.places:
            used[row::2, column::2] = True
    places = [place for lens in lenses for place in lens.places]
    shots = [Exposure(counts, used, np.ones(counts.shape)) for counts in frames]
    shots = [
        shots[0],
        *(
            replace(shot, motion=registered(shots[0], shot, 2, places))
            for shot in shots[1:]
        ),
    ]
    job = Job(tuple(shots), tuple(lenses), 2, samples, GUARD, np.eye(len(lenses)))
    return refined(replace(job, coupling=colour_coupling(job)) if len(lenses) > 1 else job)


def _lens(name: str, defocus_only: bool) -> Colour:
    light = LIGHTS[name]
    optics = Optics(
        wavelength_nm=1e3 * light.wavelength_um,
        reference_nm=1e3 * REFERENCE_UM,
        f_number=SCENE_F_NUMBER,
        pitch_um=SCENE_PITCH_UM,
        active_um=SCENE_PITCH_UM,
        noll=NOLL,
    )
    waves = (
        np.where(np.array(NOLL) == 4, light.defocus_waves, 0.0)
        if defocus_only
        else light.waves()
    )
    return Colour(name, light.places, optics, waves, SCENE_GAIN, SCENE_READ_NOISE**2)


def work(task: Task) -> Answer:
    """Photograph one scene, and restore its red channel by every method."""
    rng = np.random.default_rng(SCENE_PICTURES.index(task.picture))
    worlds = _worlds(task.picture)
    shifts = [(0.0, 0.0), *map(tuple, rng.uniform(-2, 2, (FRAMES - 1, 2)))]
    frames = [exposed(SCENE_WHITE * _mosaic(worlds, shift), rng) for shift in shifts]
    made = partial(job_of, samples=task.samples)
    truth = worlds["R"].truth(task.samples)
    one = made(frames[:1])
    restored = {BLURRED: interpolated(one, 0) / SCENE_WHITE}
    seconds = {BLURRED: 0.0}
    for name in GRANTED:
        began = perf_counter()
        restored[name] = _best(name, one, truth)
        seconds[name] = perf_counter() - began
    ways: dict[str, Callable[[], Job]] = {
        DEFOCUS_ONLY: lambda: made(frames[:1], defocus_only=True),
        FULL_PSF: lambda: one,
    }
    ways |= {
        SEVERAL: lambda: made(frames),
        THREE_COLOURS: lambda: made(frames[:1], names="RGB"),
    }
    for name, job in ways.items():
        began = perf_counter()
        found = restore_job(job(), DISCREPANCY, SCENE_FRAME, 0)
        restored[name], seconds[name] = found.scene[0] / SCENE_WHITE, perf_counter() - began
        if name == FULL_PSF:
            apart = np.abs(found.scene[0] / SCENE_WHITE - truth) / (
                found.std[0] / SCENE_WHITE
            )
            covered = (float(np.mean(apart < 1)), float(np.mean(apart < 2)))
    return Answer(
        task.samples, truth, frames[0][::2, ::2] / SCENE_WHITE, restored, seconds, covered
    )


def _worlds(picture: str) -> dict[str, PictureCamera]:
    """Return the scene in each colour."""
    worlds = {}
    for (name, light), radiance in zip(LIGHTS.items(), scene(picture), strict=True):
        camera = Camera(
            light.wavelength_um, SCENE_F_NUMBER, SCENE_PITCH_UM, TORUS, SCENE_FRAME, 8
        )
        waves = light.waves() * REFERENCE_UM / light.wavelength_um
        worlds[name] = PictureCamera(radiance, SQUARES, camera, waves, NOLL)
    return worlds


def _mosaic(worlds: dict[str, PictureCamera], shift_px: tuple[float, float]) -> Floats:
    """Return (frame, frame) mean radiance in a Bayer array's pixels, relative to white."""
    mosaic = np.empty((SCENE_FRAME, SCENE_FRAME))
    for name, world in worlds.items():
        mean = world.mean(shift_px)
        for row, column in LIGHTS[name].places:
            mosaic[row::2, column::2] = mean[row::2, column::2]
    return mosaic


def exposed(mean: Floats, rng: np.random.Generator) -> Floats:
    """Return counts above black, rounded."""
    return np.rint(
        SCENE_GAIN * rng.poisson(mean.clip(0) / SCENE_GAIN)
        + rng.normal(0, SCENE_READ_NOISE, mean.shape)
    )


def _best(name: str, job: Job, truth: Floats) -> Floats:
    """Return another method's scene with the setting nearest the truth; stop once settings get worse."""
    blurred = interpolated(job, 0) / SCENE_WHITE
    psf = psf_of(job, 0)
    reach = GUARD * job.samples
    best = blurred
    least = np.inf
    wide = np.pad(blurred, reach, mode="reflect")
    method = BASELINES[name]
    for setting in GRANTED[name]:
        found = method(wide, psf, setting)[reach:-reach, reach:-reach]
        error = float(np.mean((found - truth) ** 2))
        if error > least and name.startswith("richardson"):
            break
        if error < least:
            best = found
            least = error
    return best


def run(setting: Setting) -> Outcome:
    """Measure RMSE, PSNR and SSIM of every method on every scene."""
    tasks = (
        [Task(SCENE_PICTURES[0], QUICK_SAMPLES)]
        if setting.quick
        else [Task(name) for name in SCENE_PICTURES]
    )
    answers = all_answers(setting, work, tasks, lambda task: task.picture)
    rows = [
        {
            "picture": task.picture,
            "method": name,
            "rmse": answer.rmse(name),
            "rmse_inside": answer.rmse(name, inside=True),
            "psnr_db": -20 * np.log10(answer.rmse(name)),
            "ssim": answer.ssim(name),
            "seconds": answer.seconds[name],
            "within_1_std": answer.covered[0] if name == FULL_PSF else None,
            "within_2_std": answer.covered[1] if name == FULL_PSF else None,
        }
        for task, answer in zip(tasks, answers, strict=True)
        for name in answer.restored
    ]
    return Outcome(_claims(rows, len(tasks)), rows, partial(_draw, answers[0]))


def _claims(rows: list[dict[str, Any]], n: int) -> list[Claim]:
    """Return the claims; the thesis's RMSE is of its own target, so only the methods' order is comparable."""

    def mean(method: str, key: str) -> float:
        return float(np.mean([row[key] for row in rows if row["method"] == method]))

    def below(method: str, other: str, key: str) -> float:
        return 100 * (1 - mean(method, key) / mean(other, key))

    claims = []
    for name in dict.fromkeys(row["method"] for row in rows):
        claims.append(
            Claim(f"RMSE, {name}", None, 100 * mean(name, "rmse"), "% of white", n)
        )
        claims.append(Claim(f"PSNR, {name}", None, mean(name, "psnr_db"), "dB", n))
        claims.append(Claim(f"SSIM, {name}", None, mean(name, "ssim"), "", n))
    comparisons = [
        (FULL_PSF, "richardson-lucy"),
        (THREE_COLOURS, "richardson-lucy"),
        (SEVERAL, FULL_PSF),
        (FULL_PSF, DEFOCUS_ONLY),
    ]
    for key, where in (
        ("rmse", "whole frame"),
        ("rmse_inside", f"{INSIDE_PX} pixels off its border"),
    ):
        for method, other in comparisons:
            claims.append(
                Claim(
                    f"{method} below {other}, {where}",
                    None,
                    below(method, other, key),
                    "%",
                    n,
                )
            )
    for k, key in ((1, "within_1_std"), (2, "within_2_std")):
        claims.append(
            Claim(
                f"truth within {k} standard errors, {FULL_PSF}",
                None,
                100 * mean(FULL_PSF, key),
                "%",
                n,
            )
        )
    return claims


def _draw(answer: Answer) -> Figure:
    figure, axes = panels(9, 5, 2.1)
    order = (
        BLURRED,
        "richardson-lucy-blind",
        "richardson-lucy",
        "total-variation",
        DEFOCUS_ONLY,
        FULL_PSF,
        SEVERAL,
        THREE_COLOURS,
    )
    shown = {"truth": answer.truth} | {name: answer.restored[name] for name in order}
    shape: Callable[[Floats], Floats] = lambda image: image.clip(0, 1) ** (1 / 2.2)  # noqa: E731
    for axis, (name, image) in zip(axes, shown.items(), strict=False):
        axis.imshow(shape(image), cmap="gray", vmin=0, vmax=1)
        axis.set_axis_off()
        if name in answer.restored:
            name += f"\nRMSE {100 * answer.rmse(name):.1f} %, SSIM {answer.ssim(name):.2f}"
        axis.set_title(name, fontsize=7)
    return figure


def _skimage(part: str) -> Any:
    try:
        import skimage
    except ImportError as error:
        raise InputError(
            "the study of restorations needs scikit-image: pip install 'labkit[study]'"
        ) from error
    return getattr(skimage, part)
