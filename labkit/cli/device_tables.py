"""Tables of `labkit devices`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from labkit.devices.inventory import Connected

Found = TypeVar("Found")
NONE_OF = {
    "Cameras": 'none on USB; one on a network is not looked for: camera.address = "gphoto2:ptpip:ADDRESS"',
    "Rails": "none answers at a serial port on USB that no program holds",
}


def device_tables(
    connected: Connected,
) -> tuple[tuple[str, Sequence[list[str]] | None], ...]:
    """Return title and rows of each kind of device, with the line for the plan; None for kinds not looked for."""
    cameras = connected.cameras
    rails = connected.rails
    usb = connected.usb
    named = [
        (p, f'display.address = "{p.address}"' if p.address else "")
        for p in connected.pages
    ]
    return (
        (
            "Cameras",
            _each(
                cameras, lambda c: [c.address, c.model, f'camera.address = "{c.address}"']
            ),
        ),
        (
            "Rails",
            _each(rails, lambda r: [r.address, r.model, f'rail.address = "{r.address}"']),
        ),
        ("Pages", [[page.url, page.text, line] for page, line in named]),
        (
            "USB",
            _each(
                usb, lambda d: [d.where, d.vendor_product, d.name, "camera" * d.is_camera]
            ),
        ),
        (
            "Serial ports",
            [
                [port.path, port.vendor_product, port.name, port.stable_path]
                for port in connected.serial
            ],
        ),
        (
            "Installed drivers",
            [
                [kind, ", ".join(f"{n}:" for n in names)]
                for kind, names in connected.drivers.items()
            ],
        ),
    )


def _each(
    found: Sequence[Found] | None, row: Callable[[Found], list[str]]
) -> list[list[str]] | None:
    return None if found is None else [row(one) for one in found]
