"""The image of the glass on the simulated sensor: all at once, or in patches with PSFs of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.parts import Lit
from labkit.drivers.simulated.scene import (
    FineGrid,
    Glass,
    SceneTransform,
    photograph,
    render,
    transform,
)
from labkit.drivers.simulated.spread import near_psf, psf_and_halo, veiled
from labkit.drivers.simulated.tiles import (
    KNOTS,
    Patch,
    Place,
    by_label,
    mosaic_in_patches,
    one_psf,
    smooth,
)
from labkit.drivers.simulated.view import View
from labkit.drivers.simulated.world import BenchSettings
from labkit.types import Floats32

MOST_AT_ONCE = 640
"""Largest side of a sensor rendered at once, in 2 GB; larger sensors are rendered in tiles: 2288 × 2288 pixels in 1.0 GB."""

KEPT_SPREADS = 64
"""PSFs kept at least, of all colours together; more where a row of knots has more."""

Shown = Callable[[Lit | None], Glass]
"""Returns what the panel shows through the lit part of its pixels."""

Look = tuple[float, Lit | None]
"""Properties of a colour's scene: its size, and the lit part of the panel's pixels."""


def colours_of(settings: BenchSettings) -> NDArray[np.str_]:
    """Return (rows, cols) name of the colour of each pixel rendered finely."""
    sensor = settings.sensor
    rows, cols = settings.fine_shape
    if sensor.pattern == "mono":
        first = next(iter(settings.lens.wavelength_nm))
        return np.full((rows, cols), first)
    cell = np.array(list(sensor.pattern)).reshape(2, 2)
    return np.tile(cell, (rows // 2 + 1, cols // 2 + 1))[:rows, :cols]


def mosaic(view: View, shown: Shown, colours: NDArray[np.str_]) -> Floats32:
    """Return (rows, cols) radiance in each pixel through its own colour, white = 1; noiseless."""
    if view.settings.varies or max(colours.shape) > MOST_AT_ONCE:
        return _in_patches(view, shown, colours)
    scenes = dict[Look, SceneTransform]()
    grid = fine_grid(view)
    seen = np.zeros(colours.shape, dtype=np.float32)
    for colour in np.unique(colours):
        here = colours == colour
        look = _look(view, str(colour))
        if look not in scenes:
            scenes[look] = _scene(view, shown, look, grid)
        seen[here] = _photograph(view, str(colour), scenes[look])[here]
    return seen


def irradiance(
    view: View,
    shown: Shown,
    colour: str,
    samples: int | None = None,
    halo_um: float | None = None,
) -> Floats32:
    """Return the (rows, cols) blurred image in one colour at every pixel, white = 1; noiseless."""
    if view.settings.varies:
        every = np.full(view.settings.fine_shape, colour)
        return _in_patches(view, shown, every, samples, halo_um)
    grid = fine_grid(view, samples, halo_um)
    return _photograph(view, colour, _scene(view, shown, _look(view, colour), grid))


def fine_grid(
    view: View, samples: int | None = None, halo_um: float | None = None
) -> FineGrid:
    """Return the fine samples of a frame, as many to a pixel as diffraction needs, and their rim."""
    settings = view.settings
    pitch_um = settings.sensor.pitch_um
    nyquist_um = settings.lens.shortest_nm * 1e-3 * settings.lens.outer_f_number / 2
    per_pixel = samples or max(
        settings.samples_per_pixel, int(np.ceil(1.02 * pitch_um / nyquist_um))
    )
    reach = int(np.ceil(view.reach_um(halo_um) / pitch_um)) * per_pixel
    rows, cols = settings.fine
    return FineGrid(*settings.fine_shape, per_pixel, reach, rows.start, cols.start)


def patches(view: View) -> Iterator[Patch]:
    """Yield the patches of a view's fine part: one PSF for all, one a tile, or PSFs that blend."""
    settings = view.settings
    if not settings.varies:
        return one_psf(*settings.fine_shape)
    if settings.patch_px:
        rows, cols = settings.fine
        found = smooth(*settings.fine_shape, settings.patch_px)
        return (patch.seen_from(rows.start, cols.start) for patch in found)
    places = {
        number: view.tile_place((tile[0], tile[1]))
        for number, tile in enumerate(np.ndindex(*settings.grid.shape))
    }
    return by_label(_tile_of_pixel(view), places)


def _tile_of_pixel(view: View) -> NDArray[np.int16]:
    """Return (rows, cols) number of the tile that each fine pixel sees, or of the nearest."""
    rows, cols = view.settings.fine
    label = np.empty(view.settings.fine_shape, dtype=np.int16)
    x = np.arange(float(cols.start), float(cols.stop))[None, :]
    for top in range(0, label.shape[0], MOST_AT_ONCE):
        some = slice(top, min(top + MOST_AT_ONCE, label.shape[0]))
        y = rows.start + np.arange(float(some.start), float(some.stop))[:, None]
        right, down = view.on_panel(x, y)
        label[some] = view.settings.grid.nearest(
            right - view.shown_mm[1], down - view.shown_mm[0]
        )
    return label


def _look(view: View, colour: str) -> Look:
    return view.lateral(colour), view.settings.panel.lit(colour)


def _scene(view: View, shown: Shown, look: Look, grid: FineGrid) -> SceneTransform:
    lateral, lit = look
    straight = view.distortion.straight if view.distortion else None
    return transform(render(shown(lit), view.to_pixels(lateral), grid, straight), grid)


def _photograph(view: View, colour: str, scene: SceneTransform) -> Floats32:
    """Return a scene through the lens in one colour, with all of its light."""
    psf, halo = psf_and_halo(view.settings, colour, view.waves(colour), scene.grid)
    total = psf.sum(dtype=float) + halo.sum(
        dtype=float
    )  # what lands farther than the frame is wide is no loss
    fill_factor = view.settings.sensor.fill_factor
    seen = photograph(scene, psf, fill_factor, halo) / np.float32(total)
    return veiled(seen, scene, view.settings.lens.veil)


def _in_patches(
    view: View,
    shown: Shown,
    colours: NDArray[np.str_],
    samples: int | None = None,
    halo_um: float | None = None,
) -> Floats32:
    """Return the mosaic by patches; the light beyond a patch's rim is the axis's everywhere."""
    grid = fine_grid(view, samples, halo_um)
    halos = dict[str, Floats32]()
    for colour in map(str, np.unique(colours)):
        psf, halo = psf_and_halo(view.settings, colour, view.waves(colour), grid)
        halos[colour] = halo / np.float32(psf.sum(dtype=float) + halo.sum(dtype=float))

    @lru_cache(maxsize=_kept(view, len(halos)))
    def spread(colour: str, place: Place | None) -> Floats32:
        waves = view.waves(colour, place)
        psf = near_psf(view.through(place), colour, waves, grid)
        near = 1 - halos[colour].sum(dtype=float)
        return psf * np.float32(near / psf.sum(dtype=float))

    latest = dict[
        tuple[Look, FineGrid], SceneTransform
    ]()  # colours of one look share a patch's scene

    def draw(colour: str, here: FineGrid) -> SceneTransform:
        key = (_look(view, colour), here)
        if key not in latest:
            latest.clear()
            latest[key] = _scene(view, shown, key[0], here)
        return latest[key]

    fill_factor = view.settings.sensor.fill_factor
    seen, whole = mosaic_in_patches(
        colours, grid, draw, spread, halos, patches(view), fill_factor
    )
    if view.settings.lens.veil.fraction:
        for colour, scene in whole.items():
            mine = colours == colour
            seen[mine] = veiled(seen, scene, view.settings.lens.veil)[mine]
    return seen


def _kept(view: View, colours: int) -> int:
    """Return how many PSFs are kept: those of a row of patches, since the next row needs its last knots again."""
    settings = view.settings
    cols = settings.fine_shape[1]
    patches = cols / settings.patch_px + 1 if settings.patch_px else 1
    knots = KNOTS * (int(patches) * (KNOTS - 1) + 1)
    return max(KEPT_SPREADS, knots * colours)
