"""Standard errors of restored natural scenes: `python -m benchmarks.restored_scenes`.

Red of scenes, defocused by a wave and mosaicked, is restored by `restore_job`. The scenes are pictures of scikit-image, as they
are and reduced to half: a picture as it is has lost its finest detail to the camera that took it, which a real scene has not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from labkit.experiments import restoration as study
from labkit.experiments.camera import Camera
from labkit.experiments.conditions import NOLL
from labkit.experiments.picture_camera import PictureCamera
from labkit.restoration.strength import DISCREPANCY
from labkit.restoration.tiles import restore_job
from labkit.types import Floats

FRAME_PX, TORUS_PX, SQUARES, SAMPLES = 96, 144, 2, 2
WANTED, SLACK = 0.68, 0.10  # share of the truth within one standard error
MIDDLE = (0.5, 0.5)
PICTURES = (
    ("camera", MIDDLE),
    ("camera", (0.2, 0.8)),
    ("coins", MIDDLE),
    ("brick", MIDDLE),
    ("grass", MIDDLE),
    ("grass", (0.0, 0.0)),
    ("gravel", MIDDLE),
    ("moon", MIDDLE),
    ("page", MIDDLE),
    ("text", (0.5, 0.2)),
    ("astronaut", (0.2, 0.5)),
    ("astronaut", (0.9, 0.9)),
    ("coffee", MIDDLE),
    ("chelsea", MIDDLE),
    ("rocket", MIDDLE),
    ("hubble_deep_field", MIDDLE),
    ("stereo_motorcycle", MIDDLE),
    ("immunohistochemistry", MIDDLE),
)
"""Names in scikit-image, and the places of the parts that are used: shares of the room above and on the left."""


def radiance(name: str, place: tuple[float, float], reduced: int) -> Floats:
    """Return (n, n) radiance of a part of a picture, mirrored if it is too small, reduced by a factor."""
    from skimage import data

    picture: Any = getattr(data, name)()
    whole = np.asarray(picture[0] if isinstance(picture, tuple) else picture, float)
    whole = (whole[..., 0] if whole.ndim == 3 else whole) / 255
    side = reduced * SQUARES * TORUS_PX
    missing = [max(side - n, 0) for n in whole.shape]
    whole = np.pad(whole, [(m // 2, m - m // 2) for m in missing], mode="reflect")
    top, left = (int((n - side) * at) for n, at in zip(whole.shape, place, strict=True))
    part = whole[top : top + side, left : left + side] ** 2.2
    n = side // reduced
    return np.asarray(part.reshape(n, reduced, n, reduced).mean(axis=(1, 3)))


def restored(scene: Floats, seed: int) -> tuple[float, float, float]:
    """Return RMSE in % of white, and the shares of the truth within one and two standard errors."""
    light = study.LIGHTS["R"]
    camera = Camera(
        light.wavelength_um,
        study.SCENE_F_NUMBER,
        study.SCENE_PITCH_UM,
        TORUS_PX,
        FRAME_PX,
        8,
    )
    waves = light.waves() * study.REFERENCE_UM / light.wavelength_um
    world = PictureCamera(scene, SQUARES, camera, waves, NOLL)
    frame = study.exposed(study.SCENE_WHITE * world.mean(), np.random.default_rng(seed))
    picture = restore_job(study.job_of([frame], SAMPLES), DISCREPANCY, FRAME_PX, 0)
    apart = picture.scene[0] - study.SCENE_WHITE * world.truth(SAMPLES)
    over = np.abs(apart) / picture.std[0]
    rmse = 100 * float(np.sqrt(np.mean(apart**2))) / study.SCENE_WHITE
    return rmse, float(np.mean(over < 1)), float(np.mean(over < 2))


def main() -> None:
    """Print RMSE and coverage of each scene, and of all."""
    for reduced in (1, 2):
        shares = []
        for seed, (name, place) in enumerate(PICTURES):
            rmse, one, two = restored(radiance(name, place, reduced), seed)
            shares.append(one)
            print(
                f"{name:22s} reduced {reduced}: RMSE {rmse:5.2f} % of white, within one "
                f"standard error {100 * one:.0f} %, within two {100 * two:.0f} %",
                flush=True,
            )
        right = sum(abs(share - WANTED) <= SLACK for share in shares)
        away = np.sqrt(np.mean((np.array(shares) - WANTED) ** 2))
        print(
            f"reduced {reduced}: {100 * np.mean(shares):.0f} % in the mean, {100 * min(shares):.0f} to "
            f"{100 * max(shares):.0f} %, {right} of {len(shares)} within {100 * SLACK:.0f} % of "
            f"{100 * WANTED:.0f} %, {100 * away:.1f} % away RMS",
            flush=True,
        )


if __name__ == "__main__":
    main()
