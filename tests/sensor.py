"""A Bayer sensor whose offset, light and pixels are known; it fills sessions by plain numpy and tifffile."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from labkit.session.frame import Frame
from labkit.session.session import Session
from labkit.types import Floats, FrameKind
from tests.plans import PORTRAIT, Tables, plan_text

SHAPE = (180, 240)
BLACK, WHITE, GAIN, READ_NOISE, PRNU = 512.0, 16383.0, 0.45, 1.5, 0.006
COLOURS = {"R": 0.6, "G": 1.0, "B": 0.75}


def light_at(range_mm: float) -> Floats:
    """Vignetting times a display's fall-off that differs between ranges; about 1."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    shift = (range_mm - 2000.0) / 500.0
    return np.asarray(
        (1.1 - 0.25 * (x**2 + y**2) / 2)
        * (1 + 0.05 * (x - shift) * y)
        / (1 + 0.02 * (x + shift) ** 2)
    )


@dataclass
class Sensor:
    """A Bayer sensor with pixels of its own; exposes frames into a session."""

    rng: np.random.Generator
    response: Floats = field(init=False)
    offset: Floats = field(init=False)
    colour: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.response = 1 + PRNU * self.rng.standard_normal(SHAPE)
        self.offset = np.zeros(SHAPE)
        self.colour = np.tile(
            [[COLOURS["R"], COLOURS["G"]], [COLOURS["G"], COLOURS["B"]]],
            (SHAPE[0] // 2, SHAPE[1] // 2),
        )

    def expose(self, mean_e: Floats | float) -> NDArray[np.uint16]:
        electrons = self.rng.poisson(np.maximum(mean_e * self.colour * self.response, 0))
        counts = (
            GAIN * electrons
            + self.offset
            + READ_NOISE * self.rng.standard_normal(SHAPE)
            + BLACK
        )
        return np.clip(np.rint(counts), 0, WHITE).astype(np.uint16)


WITH_LEVELS: Tables = {
    "sensor": {"cfa_pattern": "RGGB", "black_level": BLACK, "white_level": WHITE},
    "target": {"size_mm": 30.0, "corners_px": [[40, 60], [40, 160], [140, 160], [140, 60]]},
    "fit": {"range_zero_std_mm": 10_000.0},  # its target spans 100 pixels at every range
}


class Bench:
    """A session in a folder, and the sensor that fills it."""

    def __init__(self, folder: Path, seed: int = 1, colours: str = "RGB") -> None:
        channels = [{"name": name, "wavelength_nm": 550.0} for name in colours]
        self.folder = folder
        self.session = Session.create(
            folder / "session",
            plan_text(PORTRAIT, WITH_LEVELS, {"channel": channels}),
            folder,
        )
        self.sensor = Sensor(np.random.default_rng(seed))

    def add(
        self,
        kind: FrameKind,
        range_mm: float | None,
        mean_e: Floats | float,
        frames: int = 1,
    ) -> Frame:
        """Expose that many frames; the last of them."""
        for _ in range(frames):
            name = f"{kind}{len(self.session.frames)}.tif"
            tifffile.imwrite(self.folder / name, self.sensor.expose(mean_e))
            frame = self.session.add_frame(self.folder / name, name, kind, range_mm)
        return frame

    def usual(self, frames: int = 6, ranges: tuple[float, ...] = (2000.0, 2200.0)) -> None:
        """Darks, and flats at every range."""
        self.add("dark", None, 0.0, frames)
        for range_mm in ranges:
            self.add("flat", range_mm, 20000 * light_at(range_mm), frames)
