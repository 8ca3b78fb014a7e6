"""Protocols of a camera, a rail and a display, as the rest of labkit uses them.

Drivers implement these protocols and import only labkit's errors besides. All calls are
synchronous, every wait in them has a time limit, and each device is a context manager that
closes itself. They raise DeviceError (CameraError, RailError, RailLimitError, DisplayError,
DeviceTimeoutError).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from labkit.panel import PanelInfo as PanelInfo

Picture = Literal["white", "black"] | NDArray[np.uint8]
"""Picture on a display: a uniform grey, or grey values of panel pixels, centred on black."""


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """A camera's model, serial number and driver, as the camera reports them."""

    model: str
    serial: str
    driver: str


@dataclass(frozen=True, slots=True)
class ExposureSettings:
    """An exposure: shutter time and sensitivity."""

    exposure_s: float
    iso: int

    def __post_init__(self) -> None:
        if not (self.exposure_s > 0 and self.iso > 0):
            raise ValueError(f"exposure time and ISO must be above 0: {self}")


@dataclass(frozen=True, slots=True)
class RawFrame:
    """A raw file from the camera: its path, its exposure, and other values the camera reported (JSON)."""

    path: Path
    exposure_s: float
    iso: int
    meta: Mapping[str, Any] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True)
class Setting:
    """A camera's setting, writable or not: its value now, and the allowed values if they are listed."""

    name: str
    label: str
    value: Any
    choices: tuple[Any, ...]
    readonly: bool


@dataclass(frozen=True, slots=True)
class Check:
    """A device's own check before a capture: obstacles, and remarks that only a person can check."""

    problems: tuple[str, ...] = ()
    by_hand: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Travel:
    """Positions that a rail can reach."""

    low_mm: float
    high_mm: float

    def __post_init__(self) -> None:
        if not self.low_mm < self.high_mm:
            raise ValueError(f"empty travel: {self}")


@dataclass(frozen=True, slots=True)
class Shown:
    """A display's confirmation of a picture: (height, width) of its lit part in panel pixels."""

    pixels: tuple[int, int]


class ClosesItself(ABC):
    """Base of drivers: every device is a context manager."""

    @abstractmethod
    def close(self) -> None:
        """Let the device go; again does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()


class Camera(AbstractContextManager["Camera"], Protocol):
    """A camera that delivers raw files."""

    def identify(self) -> CameraInfo:
        """Return model and serial number, after reconnecting if the connection was lost."""
        ...

    def configure(self, settings: ExposureSettings) -> None:
        """Set how the next frames are exposed; read back, never silently rounded."""
        ...

    def expose(self, path: Path) -> RawFrame:
        """Expose once and write the raw file unchanged, whole or not at all, to a path that does not exist yet."""
        ...

    def close(self) -> None:
        """Let the camera go; again does nothing."""
        ...


@runtime_checkable
class SelfRecovering(Protocol):
    """A device that recovers from faults by itself, and reports them."""

    def recovered(self) -> tuple[str, ...]:
        """Describe the faults recovered from since the last call."""
        ...


@runtime_checkable
class Previewing(Protocol):
    """A camera with a live view, which does not wear the shutter."""

    def preview(self, path: Path) -> Path | None:
        """Write the present view, a picture that labkit reads, to `path` with a suffix; None without live view."""
        ...


@runtime_checkable
class Coverable(Protocol):
    """A camera that can cover its lens. Other cameras need an operator who puts the cap on."""

    def cover(self, closed: bool) -> None:
        """Shut the light out, or let it in."""
        ...


@runtime_checkable
class Adjustable(Protocol):
    """A camera that can list its settings."""

    def settings(self) -> tuple[Setting, ...]:
        """Return all settings."""
        ...


@runtime_checkable
class Checkable(Protocol):
    """A device that can check its state before a capture."""

    def check(self, frames: int) -> Check:
        """Check whether the device can take `frames` more photographs."""
        ...


class Rail(AbstractContextManager["Rail"], Protocol):
    """A motorised stage along the optical axis."""

    @property
    def travel_mm(self) -> Travel:
        """Positions that the rail can reach."""
        ...

    def home(self) -> None:
        """Find the zero again."""
        ...

    def move_to(self, position_mm: float) -> float:
        """Move to a position, and return the measured position in mm when the rail stands still."""
        ...

    def stop(self) -> None:
        """Stop at once."""
        ...

    def close(self) -> None:
        """Let the rail go; again does nothing."""
        ...


@runtime_checkable
class PositionChecking(Protocol):
    """A rail that can detect whether it was moved."""

    def check_still(self) -> None:
        """Raise RailError if the rail moved since the last move ended; DeviceTimeoutError without an answer."""
        ...


class Controller(Protocol):
    """A simulated motion controller at a serial port, driven by a rail's driver like a real controller."""

    @property
    def path(self) -> str:
        """The port's device file."""
        ...

    def close(self) -> None:
        """End the controller."""
        ...


@runtime_checkable
class SimulatedTime(Protocol):
    """A device with simulated time: a wait beside the device lets this time pass."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        ...


class Display(AbstractContextManager["Display"], Protocol):
    """A panel that shows targets, pixel for pixel."""

    @property
    def panel(self) -> PanelInfo:
        """The glass."""
        ...

    def show(self, picture: Picture) -> Shown:
        """Show a picture, and return when the display has confirmed it."""
        ...

    def close(self) -> None:
        """Let the display go; again does nothing."""
        ...


@runtime_checkable
class OnPaper(Protocol):
    """A display without pixels: the plan states the size of its target."""

    on_paper: bool


@runtime_checkable
class SeesDisplay(Protocol):
    """A simulated camera, before which another driver's display shows its pictures."""

    def see(self, picture: Picture) -> None:
        """Receive the picture that the display now shows."""
        ...


@runtime_checkable
class PictureChecking(Protocol):
    """A display that can lose its picture during an exposure, and detects the loss."""

    def undisturbed(self) -> bool:
        """Return whether the picture was on the glass all the time since `show` returned, by the display's own report."""
        ...
