"""Photon-transfer series of a simulated sensor, in files: flats and darks of several exposure times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from labkit.plan import Sensor
from labkit.session.frame import Frame
from labkit.storage.files import sha256_of
from labkit.types import Floats, FrameKind

SIDE = 96
EXPOSURES_S = tuple(np.round(np.linspace(0.02, 1.2, 16), 3).tolist())


@dataclass(frozen=True)
class TrueCamera:
    """A sensor with known noise: 12 bit, one colour. electrons_per_s: of the light; photons_per_s: of the same."""

    gain: float = 0.4
    read_noise_e: float = 6.0
    black: float = 100.0
    white: int = 4095
    prnu: float = 0.01
    dsnu_e: float = 3.0
    dark_e_per_s: float = 40.0
    electrons_per_s: float = 9500.0
    photons_per_s: float = 19000.0

    @property
    def sensor(self) -> Sensor:
        """Return the sensor of its plan."""
        return Sensor(
            pixel_pitch_um=5.0,
            cfa_pattern="mono",
            black_level=self.black,
            white_level=self.white,
        )


@dataclass
class Ladder:
    """Frames in a folder. filtered: what the camera makes of its counts before they are written."""

    camera: TrueCamera
    folder: Path
    rng: np.random.Generator
    filtered: Callable[[Floats], Floats] = np.asarray
    frames: list[Frame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.response = 1 + self.camera.prnu * self.rng.normal(size=(SIDE, SIDE))
        self.offset_e = self.camera.dsnu_e * self.rng.normal(size=(SIDE, SIDE))

    def take(
        self, kind: FrameKind, exposure_s: float, light: float = 1.0, warm: float = 0.0
    ) -> Frame:
        """Take a frame. light: relative; warm: additional electrons."""
        camera = self.camera
        lit = kind == "flat"
        mean = exposure_s * light * camera.electrons_per_s * self.response if lit else 0.0
        mean = mean + camera.dark_e_per_s * exposure_s + warm
        electrons = self.rng.poisson(mean, (SIDE, SIDE)) + self.offset_e
        noise = self.rng.normal(0, camera.read_noise_e, (SIDE, SIDE))
        counts = np.rint(camera.black + camera.gain * (electrons + noise))
        path = self.folder / f"{kind}_{len(self.frames)}.pgm"
        counts = np.rint(self.filtered(np.clip(counts, 0, camera.white)))
        content = counts.astype(">u2").tobytes()
        path.write_bytes(b"P5 %d %d 65535\n" % (SIDE, SIDE) + content)
        columns = {
            "exposure_s": f"{exposure_s:g}",
            "photons": f"{camera.photons_per_s * exposure_s:g}" if lit else "",
        }
        frame = Frame(
            path.name,
            kind,
            None,
            sha256_of(path),
            None,
            "",
            path,
            {"columns": columns},
        )
        self.frames.append(frame)
        return frame

    def without(self, column: str) -> list[Frame]:
        """Return the frames without a column of their list."""
        return [
            replace(
                frame,
                meta={
                    "columns": {
                        key: text
                        for key, text in frame.meta["columns"].items()
                        if key != column
                    }
                },
            )
            for frame in self.frames
        ]


def ladder(
    folder: Path,
    seed: int,
    exposures_s: Sequence[float] = EXPOSURES_S,
    camera: TrueCamera | None = None,
    frames: int = 2,
    filtered: Callable[[Floats], Floats] = np.asarray,
) -> Ladder:
    """Return a series of flats and darks at each exposure time."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    series = Ladder(camera or TrueCamera(), folder, rng, filtered)
    for exposure_s in exposures_s:
        for _ in range(frames):
            series.take("dark", exposure_s)
            series.take("flat", exposure_s)
    return series
