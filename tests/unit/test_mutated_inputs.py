"""Damaged files of every kind that is read: each is taken, or refused in one short printable line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from benchmarks.mutated import campaign, sessions, texts
from labkit.errors import InputError
from labkit.photographs.picture_file import read_picture
from labkit.plan import Plan
from labkit.session.import_frames import Row, read_rows
from tests.mutations import NASTY, mended_png, mutated
from tests.plans import PORTRAIT, RED_AND_GREEN, plan_text, simulated

PLAN = plan_text(PORTRAIT, RED_AND_GREEN, simulated([3000, 3200.5], 2950.0))
ROWS = (
    'file,kind,range_mm,lens\ntarget.dng,target,3000,"70, wide"\nflat 1.dng,flat,3000.5,\na/dark.dng,dark,,\n'
    "b/bias.dng;bias;;\n"
)
TOML = (
    *NASTY,
    b"=",
    b"[",
    b"[[",
    b".a" * 50,
    b"{",
    b"'''",
    b"0x" + b"f" * 5000,
    b"f/2.8",
    b"[lens]\n",
    b"channel",
)
CSV = (*NASTY, b",", b";", b"'", b"a" * 140_000, b"file", b"kind", b"/", b"target", b"1_0")


def refusals(damaged: Iterable[bytes], read: Callable[[bytes], object]) -> list[str]:
    """What is said of the inputs that are refused; whatever else goes wrong with one is raised."""
    messages = []
    for content in damaged:
        try:
            read(content)
        except InputError as error:
            messages.append(str(error))
    return messages


def read_plan(content: bytes) -> None:
    """A plan that is taken reads back the same."""
    plan = Plan.parse(content.decode("utf-8", errors="replace"))
    assert Plan.parse(plan.to_toml()) == plan


def rows_in(folder: Path) -> Callable[[bytes], object]:
    """Reads the rows of a CSV in that folder."""
    plan = Plan.parse(PLAN)

    def read(content: bytes) -> list[Row]:
        (folder / "frames.csv").write_bytes(content)
        return read_rows(folder / "frames.csv", plan)

    return read


def unfit(messages: list[str], longest: int) -> list[str]:
    """Those that are no one line that a terminal prints."""
    return [one for one in messages if not one.isprintable() or len(one) > longest]


def pictures() -> dict[str, bytes]:
    """A small picture in each format; the PNG's checksums are of no use against damage that a program did."""
    numbers = np.random.default_rng(1).integers(0, 65536, (24, 31)).astype(np.uint16)
    packed, plain = BytesIO(), BytesIO()
    Image.fromarray(numbers).save(packed, format="tiff", compression="tiff_lzw")
    tifffile.imwrite(plain, numbers)
    return {
        "png": cv2.imencode(".png", numbers)[1].tobytes(),
        "pgm": b"P5\n31 24\n65535\n" + numbers.tobytes(),
        "digits": b"P2\n31 24\n65535\n" + " ".join(map(str, numbers.ravel())).encode(),
        "tiff": plain.getvalue(),
        "packed": packed.getvalue(),
    }


def picture_in(folder: Path) -> Callable[[bytes], object]:
    """Reads a picture in that folder, of at most 100 kB: nothing that is damaged grows."""

    def read(content: bytes) -> None:
        (folder / "picture").write_bytes(content)
        assert read_picture(folder / "picture", 25_000).numbers.nbytes < 100_000

    return read


@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted by /proc")
def test_a_short_campaign_finds_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    every = {**texts(tmp_path), **sessions(tmp_path)}
    ends = {
        name: set(campaign(kind, 1, 0.3, tmp_path / "kept").ends) - {"taken", "refused"}
        for name, kind in every.items()
    }
    assert ends == {name: set() for name in every}


def test_damaged_plans_are_taken_or_refused_in_one_line() -> None:
    messages = refusals(mutated(PLAN.encode(), 400, tokens=TOML, seed=1), read_plan)
    assert 200 < len(messages) < 400  # some damage makes another good plan
    assert unfit(messages, 4000) == []


def test_damaged_csvs_are_taken_or_refused_in_one_line(tmp_path: Path) -> None:
    damaged = mutated(ROWS.encode(), 400, tokens=CSV, seed=2)
    messages = refusals(damaged, rows_in(tmp_path))
    assert 200 < len(messages) < 400  # some damage makes another good list
    assert unfit(messages, 4000) == []


@pytest.mark.parametrize("name", ["pgm", "digits", "tiff"])
def test_damaged_pictures_are_taken_or_refused_in_one_line(
    name: str, tmp_path: Path
) -> None:
    messages = refusals(mutated(pictures()[name], 300, seed=3), picture_in(tmp_path))
    assert len(messages) > 50  # a number that is changed is another number
    assert unfit(messages, 300) == []


@pytest.mark.parametrize("name", ["png", "packed"])
def test_damaged_pictures_that_reach_the_decoder_are_taken_or_refused_in_one_line(
    name: str, tmp_path: Path
) -> None:
    damaged = mutated(pictures()[name], 25, seed=4)
    messages = refusals(
        map(mended_png, damaged) if name == "png" else damaged, picture_in(tmp_path)
    )
    assert len(messages) > 5
    assert unfit(messages, 300) == []
