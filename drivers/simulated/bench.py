"""The simulated world that the simulated camera, rail and display share.

One seed determines everything. Fixed properties (aberration, pose, the panel's unevenness,
each pixel's response) are drawn when the bench is made; noise is drawn for each frame by
its name, and scatter for each visit to a station by the visit's number. An interrupted
capture therefore continues as if it had not been interrupted, unless a preflight visits
stations in between. Time is a number here: nothing sleeps.
"""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.image import colours_of, irradiance, mosaic
from labkit.drivers.simulated.modes import drawn_modes
from labkit.drivers.simulated.parts import Lit
from labkit.drivers.simulated.room import drawn_room
from labkit.drivers.simulated.scene import Glass
from labkit.drivers.simulated.sensor import PixelArray, strips
from labkit.drivers.simulated.view import Aim, View
from labkit.drivers.simulated.world import BenchSettings, Fault, Truth, Visit
from labkit.types import Floats, Floats32

KEPT_PICTURES = 4
"""White, black and the target at one stop are shown in turn; more than these need not be kept."""


class Bench:
    """The bench: place of the carriage, picture on the glass, and the resulting photograph.

    The public methods are the actions of devices. `truth` is for demos and tests, and never
    for an estimator.
    """

    def __init__(self, settings: BenchSettings, faults: Sequence[Fault] = ()) -> None:
        self.settings = settings
        self.clock_s = 0.0
        self.covered = False
        self.camera_present = True
        self.carriage_mm = 0.0  # before scatter
        self.screw_mm = 0.0
        self._faults = tuple(faults)
        self._calls: Counter[str] = Counter()
        self._visits_at: Counter[float] = Counter()
        self._homings = 0
        self._homing_mm = 0.0
        self._scatter_mm = 0.0
        self._wander_px = (0.0, 0.0)  # down, right
        self._asked_mm = 0.0
        self._visits: dict[float, Visit] = {}
        self._codes = np.zeros(settings.panel.pixels, dtype=np.int16)
        self._shown_mm = (0.0, 0.0)  # down, right
        self._seen: dict[bytes, Floats32] = {}
        self._draw()

    def trouble(self, device: str) -> str | None:
        """Count a call to a device, and return the kind of its fault, if any."""
        self._calls[device] += 1
        call = self._calls[device]
        for fault in self._faults:
            if fault.device == device and fault.call <= call < fault.call + fault.times:
                return fault.kind
        return None

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock_s += seconds

    def turn_screw(self, screw_mm: float, lost_mm: float = 0.0) -> None:
        """Drive the rail's screw to a position; the carriage follows after the play, less lost steps."""
        rail = self.settings.rail
        self.wait(abs(screw_mm - self.screw_mm) / rail.speed_mm_per_s)
        self.screw_mm = screw_mm
        reached = screw_mm - lost_mm
        # driven from below the carriage lies on the screw; from above it lags by the play
        self.carriage_mm = min(max(self.carriage_mm, reached), reached + rail.play_mm)

    def stand(self, asked_mm: float) -> None:
        """Bring the carriage to rest, and draw the scatter and sideways wander of this station."""
        self._visits_at[asked_mm] += 1
        rng = self._generator("stop", f"{asked_mm:.4f}", str(self._visits_at[asked_mm]))
        self._asked_mm = asked_mm
        self._scatter_mm = rng.normal(0, self.settings.rail.scatter_mm)
        wander = self.settings.pose.wander_px
        self._wander_px = (rng.uniform(-wander, wander), rng.uniform(-wander, wander))

    def trip_home_switch(self) -> None:
        """Count positions from the home switch, with this homing's scatter."""
        self._homings += 1
        rng = self._generator("homing", str(self._homings))
        self._homing_mm = rng.normal(0, self.settings.rail.homing_scatter_mm)

    @property
    def counted_mm(self) -> float:
        """Distance of the carriage from the home switch's last trip point: an encoder's reading."""
        return self.carriage_mm + self._scatter_mm

    @property
    def position_mm(self) -> float:
        """True place of the carriage."""
        return self.counted_mm + self._homing_mm

    @property
    def range_mm(self) -> float:
        """True distance of the panel's centre from the lens's front principal plane, along the axis."""
        rail = self.settings.rail
        return (
            rail.range_at_zero_mm + rail.tape_error_mm + rail.direction * self.position_mm
        )

    def light(self, picture: NDArray[np.uint8]) -> None:
        """Put grey values of panel pixels on the glass, centred and black around. Raises ValueError if too large."""
        rows, cols = self.settings.panel.pixels
        height, width = picture.shape
        if height > rows or width > cols:
            raise ValueError(
                f"a picture of {height} × {width} pixels is larger than the panel, {rows} × {cols}"
            )
        top = (rows - height) // 2
        left = (cols - width) // 2
        pitch_mm = self.settings.panel.pitch_mm
        self._shown_mm = (
            (top + height / 2 - rows / 2) * pitch_mm,
            (left + width / 2 - cols / 2) * pitch_mm,
        )
        self._codes = np.zeros((rows, cols), dtype=np.int16)
        self._codes[top : top + height, left : left + width] = picture

    def expose(self, exposure_s: float, iso: int, name: str) -> NDArray[np.uint16]:
        """Return a photograph, (rows, cols) counts, of the present scene. `name` draws its noise."""
        self.wait(exposure_s)
        sensor = self.settings.sensor
        rng = self._generator("frame", name)
        picture = None if self.covered else self._picture()
        cut = self.settings.fine
        fine = self._pixels.counts(picture, cut, exposure_s, iso, rng)
        if self._room is None:
            return fine
        counts = np.empty((sensor.rows, sensor.cols), dtype=np.uint16)
        glass = self._glass(None)
        every = slice(0, sensor.cols)
        for rows in strips(sensor.rows):
            light = None if self.covered else self._room.light(self.view, glass, rows)
            counts[rows] = self._pixels.rough_counts(
                light, (rows, every), exposure_s, iso, rng
            )
        counts[cut] = fine
        return counts

    @property
    def truth(self) -> Truth:
        """The truth of this bench and of its photographed stations."""
        lens = self.settings.lens
        sensor = self.settings.sensor
        tape_error_mm = self.settings.rail.tape_error_mm
        return Truth(
            seed=self.settings.seed,
            best_focus_mm={
                colour: range_mm - tape_error_mm
                for colour, range_mm in lens.best_focus_mm.items()
            },
            range_zero_mm=tape_error_mm,
            focal_length_mm=lens.focal_length_mm,
            f_number=lens.f_number,
            pupil=lens.pupil,
            outer_f_number=lens.outer_f_number,
            clear_share=lens.pupil.clear_share,
            pupil_magnification=lens.pupil_magnification,
            lateral_colour=dict(lens.lateral_colour),
            modes_waves=self._modes,
            counts_per_electron=sensor.counts_per_electron,
            read_noise_counts=sensor.read_noise_electrons * sensor.counts_per_electron,
            visits=tuple(self._visits.values()),
            field_terms=lens.field_terms.numbers() if self.settings.varies else {},
        )

    def irradiance(
        self, colour: str, samples: int | None = None, halo_um: float | None = None
    ) -> Floats32:
        """Return the (rows, cols) blurred image of the glass in one colour at every pixel, white = 1;
        noiseless.
        """
        return irradiance(self.view, self._glass, colour, samples, halo_um)

    @property
    def view(self) -> View:
        """The camera's view from the present station."""
        return View(
            self.settings,
            self._modes,
            self._aim,
            self.range_mm,
            self._wander_px,
            self._shown_mm,
        )

    def _draw(self) -> None:
        """Draw the constant properties of the bench."""
        lens = self.settings.lens
        pose = self.settings.pose
        rng = self._generator("fixed")
        self._modes = drawn_modes(lens, rng, self._generator("higher modes"))
        tilt_deg = (
            rng.uniform(-1, 1) * pose.tilt_deg,
            rng.uniform(-1, 1) * pose.tilt_deg,
        )
        roll_deg = rng.choice((-1, 1)) * rng.uniform(0.5, 1) * pose.roll_deg
        right_px, down_px = rng.uniform(-pose.offset_px, pose.offset_px, 2)
        if room := self.settings.room:
            down_px += room.target_px[0]
            right_px += room.target_px[1]
        self._aim = Aim(tilt_deg, roll_deg, (right_px, down_px))
        self._waves = (
            rng.uniform(0.3, 1.5, (5, 2)) * rng.choice((-1, 1), (5, 2)),
            rng.uniform(0, 2 * np.pi, 5),
        )
        high, wide = self.settings.panel.pixels
        y_mm = (np.arange(float(high)) - (high - 1) / 2) * self.settings.panel.pitch_mm
        x_mm = (np.arange(float(wide)) - (wide - 1) / 2) * self.settings.panel.pitch_mm
        self._evenness = self._unevenness(x_mm[None, :], y_mm[:, None]).astype(np.float32)
        self._pixels = PixelArray(self.settings, rng)
        self._room = drawn_room(self.settings, self._generator("room"))

    def _generator(self, *purpose: str) -> np.random.Generator:
        return np.random.default_rng(
            [self.settings.seed, zlib.crc32("/".join(purpose).encode())]
        )

    def _unevenness(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """Return the relative brightness of the panel's places, about 1: five slow waves across the glass."""
        high, wide = (n * self.settings.panel.pitch_mm for n in self.settings.panel.pixels)
        vectors, phases = self._waves
        total = sum(
            np.cos(2 * np.pi * (v * y_mm / high + w * x_mm / wide) + phase)
            for (v, w), phase in zip(vectors, phases, strict=True)
        )
        return np.asarray(
            1 + self.settings.panel.unevenness * np.sqrt(2 / len(phases)) * total
        )

    def _radiance(self, codes: NDArray[np.int16]) -> Floats32:
        panel = self.settings.panel
        lit = (
            1 / panel.contrast
            + (1 - 1 / panel.contrast) * (np.arange(256) / 255) ** panel.gamma
        )
        return lit.astype(np.float32)[codes]

    def _glass(self, lit: Lit | None) -> Glass:
        """Return what the panel shows through a part of its pixels."""
        return Glass(
            self._codes,
            self._radiance(self._codes) * self._evenness,
            self.settings.panel.pitch_mm,
            lit,
        )

    def _picture(self) -> Floats32:
        """Return (rows, cols) radiance in each fine pixel through its own colour, white = 1; the latest few are
        kept.
        """
        key = (
            self.view.to_pixels().tobytes() + hashlib.sha256(self._codes.tobytes()).digest()
        )
        if key not in self._seen:
            self._seen = dict(list(self._seen.items())[-KEPT_PICTURES + 1 :])
            even = self._fills_the_view()
            if not even:
                self._note_visit()
            # whoever sees a panel's own pixels sees them in white too
            if even and self.settings.panel.layout == "none":
                self._seen[key] = self._uniform()
            else:
                self._seen[key] = self._mosaic()
        return self._seen[key]

    def _mosaic(self) -> Floats32:
        """Return the radiance in each pixel through its own colour."""
        return mosaic(self.view, self._glass, colours_of(self.settings))

    def _note_visit(self) -> None:
        """Record the truth of this station."""
        rail = self.settings.rail
        asked_mm = rail.range_at_zero_mm + rail.direction * self._asked_mm
        view = self.view
        defocus = {
            colour: view.defocus(colour) for colour in self.settings.lens.wavelength_nm
        }
        pose = tuple(tuple(row) for row in view.to_pixels().tolist())
        tiles = view.tiles() if self.settings.varies else ()
        zero_mm = rail.tape_error_mm + rail.direction * self._homing_mm
        self._visits[asked_mm] = Visit(
            asked_mm, self.range_mm, zero_mm, defocus, pose, tiles
        )

    def _fills_the_view(self) -> bool:
        """Return whether the glass is one grey and reaches beyond the camera's view, halo included."""
        if self._codes.min() != self._codes.max():
            return False
        rim = self.view.reach_um() / self.settings.sensor.pitch_um + 1
        y, x = (
            np.array([part.start - rim, part.stop + rim]) for part in self.settings.fine
        )
        right, down = self.view.on_panel(x[None, :], y[:, None])
        high, wide = (
            n * self.settings.panel.pitch_mm / 2 for n in self.settings.panel.pixels
        )
        return bool(np.all(np.abs(right) < wide) and np.all(np.abs(down) < high))

    def _uniform(self) -> Floats32:
        """Return the image of a panel in one grey: only its unevenness, which blur does not change."""
        rows, cols = self.settings.fine
        level = self._radiance(self._codes[:1, :1])[0, 0]
        view = self.view
        seen = np.empty(self.settings.fine_shape, dtype=np.float32)
        x = np.arange(float(cols.start), float(cols.stop))[None, :]
        for some in strips(seen.shape[0]):
            y = rows.start + np.arange(float(some.start), float(some.stop))[:, None]
            x_mm, y_mm = view.on_panel(x, y)
            seen[some] = level * self._unevenness(x_mm, y_mm)
        return seen
