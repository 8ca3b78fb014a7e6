"""Parse the address of a simulated bench: seed, sensor, room, lens and faults."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.world import FAULTS, Fault, TrueLens
from labkit.drivers.simulated.zernike_table import read_table
from labkit.errors import PlanError, shown

SEED_WORD = re.compile(r"seed=([0-9]{1,9})")
FAULT = re.compile(
    r"(?P<device>[a-z]+)\.(?P<kind>[a-z_]+)=(?P<call>[1-9]\d{0,5})(?:x(?P<times>[1-9]\d{0,5}))?"
)
SENSOR_WORD = re.compile(r"sensor=([0-9]{1,4}(?:\.[0-9]{1,3})?)mp")
ROOM_WORD = re.compile(r"room=([a-z]+)")
LENS_WORD = re.compile(r"lens\.([a-z0-9_]+)=(.+)")
NOLL_WORD = re.compile(r"noll_([0-9]{1,3})")
ORDERED_NUMBER = re.compile(r"-?\d{1,6}(?:\.\d{1,12})?")

PUPIL = {
    "blades": "blades",
    "blades_turn_deg": "turn_deg",
    "blade_rounding": "rounding",
    "obstruction": "obstruction",
}
"""The pupil's numbers, by their names in an address."""

OVER_THE_FRAME = {
    "axis_mm": 2,
    "field_curvature_per_mm": 1,
    "sensor_tilt_um_per_mm": 2,
    "coma_waves": 2,
    "coma_per_mm": 1,
    "astigmatism_per_mm": 2,
    "astigmatism_per_mm2": 1,
    "k1_per_mm2": 1,
    "distortion_centre_mm": 2,
    "cos4": 1,
    "cats_eye_per_mm": 2,
}
"""Words for `FieldTerms`, and how many numbers each takes."""

ROOM_LIGHT = {"bright": 1.0, "dark": 0.003}
"""Light of rooms by their names, relative to a day with a window and a lamp; in the dark a white wall sends 0.1 % of the
panel's white."""

LEAST_MEGAPIXELS, MOST_MEGAPIXELS = 1.0, 150.0

ORDERED_FAULTS = ", ".join(
    f"{device}.{kind}" for device, kinds in FAULTS.items() for kind in kinds
)

ALLOWED_ORDERS = (
    "allowed is seed=N; sensor=24mp (a whole frame of 1 to 150 megapixels) with room=bright "
    "or room=dark; a lens as in lens.blades=7, lens.blades_turn_deg=10, "
    "lens.blade_rounding=0.3, lens.obstruction=0.38, lens.cats_eye=0.3,1.1,45 (shift, radius, "
    "direction), lens.noll_22=0.01, lens.higher_rms=0.03; "
    f"over the frame lens.table=PATH, lens.lateral_colour=R,G,B, lens.patch_px, lens.{', lens.'.join(OVER_THE_FRAME)}; "
    "and faults as in camera.timeout=2 "
    f"(at the second exposure) or camera.timeout=2x3 (three times from there): {ORDERED_FAULTS}"
)


@dataclass(frozen=True, slots=True)
class Orders:
    """Orders of an address for a bench; none by default."""

    seed: int = 1
    faults: tuple[Fault, ...] = ()
    pupil: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of `Pupil`."""
    higher_waves: float = 0.0
    stated_waves: Mapping[int, float] = field(default_factory=dict)
    field_terms: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of `FieldTerms`."""
    lateral_colour: Mapping[str, float] = field(default_factory=dict)
    patch_px: float = 0.0
    megapixels: float | None = None
    """Of a whole frame; None for a sensor that just holds the target."""
    room: str = ""
    """One of `ROOM_LIGHT`; "" for the usual room of a whole frame."""

    def made(self, lens: TrueLens) -> TrueLens:
        """Return the lens as ordered; a lens with a table has no random aberration.

        Raises ValueError for an impossible lens.
        """
        terms = FieldTerms(**self.field_terms)
        return replace(
            lens,
            field_terms=terms,
            aberration_waves=0.0 if terms.table else lens.aberration_waves,
            lateral_colour=dict(self.lateral_colour),
            pupil=Pupil(**self.pupil),
            higher_waves=self.higher_waves,
            stated_waves=dict(self.stated_waves),
        )


def ordered(address: str) -> Orders:
    """Parse an address such as "simulated:seed=3,lens.blades=7,camera.timeout=2,rail.stall=1x4".

    Commas between numbers belong to their order.

    Raises
    ------
    PlanError
        for an unknown word, and for an impossible lens
    """
    orders = Orders()
    words = address.partition(":")[2]
    try:
        for word in re.split(r",(?![-.\d])", words) if words else ():
            read = _read(word, orders)
            if read is None:
                raise PlanError(f'address "{address}": {shown(word)}: {ALLOWED_ORDERS}')
            orders = read
        if orders.room and orders.megapixels is None:
            raise PlanError(
                f'address "{address}": room={orders.room} needs a whole frame: add sensor=24mp, or leave the room out'
            )
        orders.made(TrueLens())
    except ValueError as error:
        raise PlanError(f'address "{address}": {error}') from error
    return orders


def _read(word: str, orders: Orders) -> Orders | None:
    """Return the orders with another word; None for an unknown word."""
    if found := SEED_WORD.fullmatch(word):
        return replace(orders, seed=int(found[1]))
    if found := SENSOR_WORD.fullmatch(word):
        size = float(found[1])
        if not LEAST_MEGAPIXELS <= size <= MOST_MEGAPIXELS:
            return None
        return replace(orders, megapixels=size)
    if found := ROOM_WORD.fullmatch(word):
        return replace(orders, room=found[1]) if found[1] in ROOM_LIGHT else None
    if found := LENS_WORD.fullmatch(word):
        if found[1] == "table":
            return _with_field(orders, "table", read_table(found[2]))
        return _with_lens(orders, found[1], found[2].split(","))
    found = FAULT.fullmatch(word)
    if found and found["kind"] in FAULTS.get(found["device"], ()):
        device, kind = cast(Any, (found["device"], found["kind"]))
        fault = Fault(device, kind, int(found["call"]), int(found["times"] or 1))
        return replace(orders, faults=(*orders.faults, fault))
    return None


def _with_lens(orders: Orders, name: str, written: list[str]) -> Orders | None:
    """Return the orders with a property of the lens; None for an unknown name, or for wrong numbers."""
    if not all(ORDERED_NUMBER.fullmatch(number) for number in written):
        return None
    values = [float(number) for number in written]
    if name in OVER_THE_FRAME or name in ("lateral_colour", "patch_px"):
        return _over_the_frame(orders, name, values)
    if name == "cats_eye":
        return (
            replace(orders, pupil={**orders.pupil, name: tuple(values)})
            if len(values) == 3
            else None
        )
    if len(values) != 1 or (name == "blades" and not written[0].isdigit()):
        return None
    if name in PUPIL:
        number = int(written[0]) if name == "blades" else values[0]
        return replace(orders, pupil={**orders.pupil, PUPIL[name]: number})
    if name == "higher_rms":
        return replace(orders, higher_waves=values[0])
    if found := NOLL_WORD.fullmatch(name):
        stated = {**orders.stated_waves, int(found[1]): values[0]}
        return replace(orders, stated_waves=stated)
    return None


def _over_the_frame(orders: Orders, name: str, values: list[float]) -> Orders | None:
    """Return the orders with numbers of the field; None for too many or too few numbers."""
    if name == "lateral_colour":
        by_colour = dict(zip("RGB", values, strict=False))
        return replace(orders, lateral_colour=by_colour) if len(values) == 3 else None
    if name == "patch_px":
        return replace(orders, patch_px=values[0]) if len(values) == 1 else None
    if len(values) != OVER_THE_FRAME[name]:
        return None
    return _with_field(orders, name, values[0] if len(values) == 1 else tuple(values))


def _with_field(orders: Orders, name: str, value: object) -> Orders:
    """Return the orders with a number of the field, or its table."""
    return replace(orders, field_terms={**orders.field_terms, name: value})
