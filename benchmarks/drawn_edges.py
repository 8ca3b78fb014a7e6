"""Edges as photographs have them, against the truth: `python -m benchmarks.drawn_edges --edges 400`.

Each edge is drawn on samples eight to a pixel and blurred by closed forms (a lens without aberrations, the pixel, motion), so
that nothing of the model is used. Two conditions at a time: bow, light that falls off, noise, motion, sharpening, clipping; at
any slope from 2 to 45 degrees. Printed are errors over standard errors where nothing is said, and the causes that are named.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import tifffile
from scipy.fft import fft2, fftfreq, ifft2
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

from labkit.edges.measurement import measure_edges
from labkit.errors import DataError
from labkit.types import Floats

FRAME, FINER = 112, 8  # pixels along a side; samples to a pixel
BOX = (10, 10, 102, 102)
PITCH_UM, WAVELENGTH_UM = 4.0, 0.55
GAIN, READ, BLACK, WHITE = 0.15, 3.0, 200, 4095
DARK, BRIGHT = 250.0, 2800.0
CONDITIONS = ("bow", "light", "noise", "motion", "sharpening", "clipping")
WORDS = {
    "motion": ("motion", "shake"),
    "sharpening": ("sharpening", "program"),
    "clipping": ("clipped",),
}
"""What a sentence on a cause says; bow, light and noise need none."""

PLAN = """
[lens]
focal_length_mm = 50
f_number = {f_number}
[sensor]
pixel_pitch_um = 4
cfa_pattern = "mono"
black_level = 200
white_level = 4095
[[channel]]
name = "M"
wavelength_nm = 550
[target]
kind = "sierpinski"
order = 3
size_mm = 20
"""


@dataclass(frozen=True)
class Drawn:
    """A drawn edge.

    Attributes
    ----------
    conditions : two of `CONDITIONS`
    angle, f_number : of the normal, radians; of the lens
    bow_px, fall : bow of the edge over the frame; fall of the light, relative
    gain : counts per electron
    motion_px : (rows, columns)
    sharpening : amount and radius of an unsharp mask, pixels
    clip : counts above black
    """

    conditions: tuple[str, ...]
    angle: float
    f_number: float
    bow_px: float = 0.0
    fall: tuple[float, float] = (0.0, 0.0)
    gain: float = GAIN
    motion_px: tuple[float, float] = (0.0, 0.0)
    sharpening: tuple[float, float] = (0.0, 1.0)
    clip: float = np.inf

    @classmethod
    def random(cls, conditions: tuple[str, ...], rng: np.random.Generator) -> Drawn:
        """Draw an edge with conditions."""
        turn = rng.integers(4) * np.pi / 2
        slant = np.radians(rng.uniform(2, 45)) * rng.choice([-1, 1])
        way, direction = rng.uniform(1, 3), rng.uniform(0, np.pi)
        of_light = rng.uniform(0, 2 * np.pi)
        fall = rng.uniform(0.1, 0.5)
        return cls(
            conditions,
            turn + slant,
            rng.choice([4.0, 5.6, 8.0, 11.0]),
            rng.uniform(0.5, 3) if "bow" in conditions else 0.0,
            (fall * np.sin(of_light), fall * np.cos(of_light))
            if "light" in conditions
            else (0.0, 0.0),
            GAIN * (8 if "noise" in conditions else 1),
            (way * np.sin(direction), way * np.cos(direction))
            if "motion" in conditions
            else (0.0, 0.0),
            (rng.uniform(0.3, 1.5), rng.uniform(0.7, 2))
            if "sharpening" in conditions
            else (0.0, 1.0),
            rng.uniform(0.6, 0.95) * BRIGHT if "clipping" in conditions else np.inf,
        )

    def transfer(self, rows: Floats, columns: Floats) -> Floats:
        """Return the transfer function before sharpening, at cycles a pixel."""
        cutoff = PITCH_UM / (WAVELENGTH_UM * self.f_number)
        s = (np.hypot(rows, columns) / cutoff).clip(0, 1)
        lens = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
        moved = np.sinc(rows * self.motion_px[0] + columns * self.motion_px[1])
        return np.asarray(lens * np.sinc(rows) * np.sinc(columns) * moved)

    @property
    def mtf50(self) -> float:
        """True frequency of a half, across the edge, cycles/mm."""
        amount, radius = self.sharpening
        across = np.array([np.sin(self.angle), np.cos(self.angle)])

        def excess(f: float) -> float:
            mask = np.prod([_smoothed(part * f, radius) for part in across])
            moved = self.transfer(*(np.array([f]) * across[:, None]))
            sharp = float(1 + amount * (1 - mask))
            return float(abs(moved[0])) * sharp - 0.5

        grid = np.linspace(0.01, 2, 400)
        first = next(k for k, f in enumerate(grid) if excess(f) < 0)
        return float(brentq(excess, grid[first - 1], grid[first])) / (PITCH_UM * 1e-3)

    def counts(self, rng: np.random.Generator) -> np.ndarray:
        """Return the photograph (rows, columns)."""
        size = FRAME * FINER
        at = (np.arange(size) + 0.5) / FINER - FRAME / 2
        x, y = at[None, :], at[:, None]
        across = x * np.cos(self.angle) + y * np.sin(self.angle) - rng.uniform(-0.5, 0.5)
        along = (y * np.cos(self.angle) - x * np.sin(self.angle)) / (FRAME / 2)
        lit = (0.5 + FINER * (across - self.bow_px * (1 - along**2))).clip(0, 1)
        light = 1 + (self.fall[0] * y + self.fall[1] * x) / FRAME
        scene = (DARK + (BRIGHT - DARK) * lit) * light
        # what comes around at the border must not: the picture continues as its own mirror
        mirrored = np.block([[scene, scene[:, ::-1]], [scene[::-1], scene[::-1, ::-1]]])
        f = fftfreq(2 * size, 1 / FINER)
        spectrum = fft2(mirrored) * self.transfer(f[:, None], f[None, :])
        blurred = ifft2(spectrum).real[:size, :size]
        mean = blurred[FINER // 2 :: FINER, FINER // 2 :: FINER]
        electrons = rng.poisson(mean.clip(0) / self.gain)
        counts = self.gain * electrons + rng.normal(0, READ, mean.shape)
        counts = np.minimum(counts, self.clip)
        amount, radius = self.sharpening
        counts = counts + amount * (counts - gaussian_filter(counts, radius))
        return np.rint(counts + BLACK).clip(0, WHITE).astype(np.uint16)


def _smoothed(frequency: float, radius: float) -> float:
    """Return the transfer of `gaussian_filter` along an axis, of samples: it has the period of the pixels."""
    at = np.arange(-int(4 * radius + 0.5), int(4 * radius + 0.5) + 1)
    weight = np.exp(-(at**2) / (2 * radius**2))
    return float(weight @ np.cos(2 * np.pi * frequency * at) / weight.sum())


def said(drawn: Drawn, rng: np.random.Generator, folder: Path) -> tuple[float, str]:
    """Measure a drawn edge; return its error in standard errors, nan without a number, and what is said."""
    image, plan = folder / "edge.tif", folder / "plan.toml"
    tifffile.imwrite(image, drawn.counts(rng))
    plan.write_text(PLAN.format(f_number=drawn.f_number))
    try:
        outcome = measure_edges(image, plan, boxes=[BOX], workers=1)
    except DataError as error:
        return np.nan, str(error)
    words = [of.text for of in outcome.findings if of.code != "ranges-not-determined"]
    words += [of.why for of in outcome.rejected]
    if not outcome.edges:
        return np.nan, "; ".join(words)
    found = outcome.edges[0].main.fitted.mtf50
    return (found.value - drawn.mtf50) / found.std, "; ".join(words)


def study(edges: int, seed: int) -> None:
    """Print a line for each edge, then pulls where nothing is said, and how often the true cause is named."""
    pairs = [*combinations(CONDITIONS, 2)]
    silent: list[float] = []
    spoken: list[float] = []
    named: list[bool] = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(edges):
            rng = np.random.default_rng([seed, k])
            drawn = Drawn.random(pairs[k % len(pairs)], rng)
            pull, words = said(drawn, rng, Path(folder))
            slant = abs((np.degrees(drawn.angle) + 45) % 90 - 45)
            first = f"{k:4d} {'+'.join(drawn.conditions):22s} {slant:4.1f} deg f/{drawn.f_number:<4g}"
            print(f"{first} {drawn.mtf50:6.1f} {pull:6.2f} {words}", flush=True)
            if words:
                causes = [WORDS[of] for of in drawn.conditions if of in WORDS]
                named.append(any(word in words for of in causes for word in of))
                spoken.append(pull)
            else:
                silent.append(pull)
    pulls = np.array(silent)
    print(
        f"nothing said: {pulls.size}, error over standard error {pulls.mean():+.2f} ± {pulls.std():.2f}"
    )
    print(f"beyond 3 and nothing said: {np.sum(np.abs(pulls) > 3)}")
    both = np.array(spoken)
    beyond = np.sum(np.abs(both) > 3)
    print(
        f"something said: {both.size}, numbers given: {np.isfinite(both).sum()}, beyond 3: {beyond}"
    )
    print(f"the true cause is named: {np.mean(named):.0%} of {len(named)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edges", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    study(chosen.edges, chosen.seed)
