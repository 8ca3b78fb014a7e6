"""Data classes as files: read back equal, and never as anything else than their annotations say."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from labkit.estimation.local import Found
from labkit.findings.findings import Finding, found
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, Diffusion, Veil
from labkit.key import Key
from labkit.storage import npz, typed_file
from labkit.types import Floats


@dataclass(frozen=True)
class Base:
    name: str


@dataclass(frozen=True)
class Derived(Base):
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True)
class Whole:
    of: Base | None
    table: Mapping[str, Floats]
    pair: tuple[int, str] = (1, "a")
    flag: bool = False
    grid: Floats = field(default_factory=lambda: np.eye(3, order="F"))


WHOLE = Whole(Derived("b", (0.1, -1e-300)), {"x": np.arange(4.0)[::2]}, (2**60, "µ"))


def test_every_part_of_a_camera_is_read_back_as_it_was() -> None:
    optics = Optics(
        wavelength_nm=550.0,
        reference_nm=450.0,
        f_number=2.8,
        pitch_um=4.78,
        active_um=4.78,
        parts=tuple(KNOWN.values()),
        given=(Diffusion(0.1), Veil(0.02, 7.3)),
    )
    assert typed_file.load(typed_file.dump(optics, Optics), Optics) == optics


def test_arrays_and_classes_come_back_as_they_were() -> None:
    read = typed_file.load(typed_file.dump(WHOLE, Whole), Whole)
    assert read.of == WHOLE.of
    assert (read.pair, read.flag) == (WHOLE.pair, False)
    np.testing.assert_array_equal(read.table["x"], [0.0, 2.0])
    assert read.grid.flags.f_contiguous


def test_a_finding_with_its_numbers_is_read_back() -> None:
    finding = found(
        "settings-differ", setting="ISO", first_file="a", first=1, file="b", other=[2.5]
    )
    both = (
        finding,
        Finding("note", Key(3200.0, "G", (1, 2)), {"table": {"x": None}}, "..."),
    )
    kind = tuple[Finding, ...]
    assert typed_file.load(typed_file.dump(both, kind), kind) == both


@pytest.mark.parametrize("value", [Whole(None, {"x": np.eye(2).astype(object)}), "text", 1])
def test_what_is_of_another_type_is_not_written(value: Any) -> None:
    with pytest.raises(TypeError):
        typed_file.dump(value, Whole)


def test_a_file_of_another_type_is_not_read() -> None:
    content = typed_file.dump(Derived("a"), Derived)
    for kind in (Found, Whole, Optics, dict[str, float], float):
        with pytest.raises(ValueError, match="it holds no"):
            typed_file.load(content, kind)


def test_a_class_that_is_no_relation_is_not_made() -> None:
    tree = np.frombuffer(b'["Whole", {}]', np.uint8)
    with pytest.raises(ValueError, match="no data class"):
        typed_file.load(npz.packed({"tree": tree}), Base)


def test_damage_is_told_by_one_error_and_takes_no_memory() -> None:
    rng, content = random.Random(5), typed_file.dump(WHOLE, Whole)
    refused = 0
    for _ in range(2000):
        damaged = bytearray(content)
        for _ in range(rng.choice((1, 3))):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        try:
            typed_file.load(bytes(damaged), Whole)
        except ValueError:
            refused += 1
    assert refused > 1000  # zip's checksums hold all but its unused fields


def test_an_array_larger_than_allowed_is_not_unpacked() -> None:
    content = npz.packed({"data": np.zeros(10**7)})  # 80 MB in 80 kB
    with pytest.raises(ValueError, match="takes more than"):
        npz.unpacked(content, lambda _: 10**6)


def test_objects_and_texts_are_no_arrays() -> None:
    with pytest.raises(ValueError, match="header cannot be read"):
        npz.unpacked(npz.packed({"x": np.array(["a"])}), lambda _: 10**6)
