"""Check transferred files: whole, raw, typed by content; then move them to their place."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import rawpy

from labkit.drivers.gphoto2.link import IO, TIMEOUT, Trouble
from labkit.errors import CameraError, RawError
from labkit.photographs.container import recognise
from labkit.photographs.libraw import opened_raw
from labkit.storage.reading import opened_photograph

SUFFIXES = (
    (b"ftypcrx", ".cr3"), (b"CR\x02", ".cr2"), (b"FUJIFILMCCD-RAW", ".raf"), (b"IIU\0", ".rw2"),
    (b"IIRO", ".orf"), (b"IIRS", ".orf"), (b"MMOR", ".orf"),
)  # fmt: skip
MAKERS = {
    "nikon": ".nef",
    "sony": ".arw",
    "canon": ".cr2",
    "pentax": ".pef",
    "ricoh": ".pef",
    "samsung": ".srw",
}


def fresh_folder(folder: Path) -> Path:
    """Return an empty folder for transferred files."""
    incoming = folder / ".incoming"
    shutil.rmtree(incoming, ignore_errors=True)
    incoming.mkdir()
    return incoming


def clear_folder(folder: Path) -> None:
    shutil.rmtree(folder / ".incoming", ignore_errors=True)


def kept(files: list[dict[str, Any]], path: Path, wait_s: float) -> Path:
    """Move the only raw file of an exposure, if whole, to `path` plus its suffix.

    Raises Trouble or CameraError.
    """
    for file in files:
        size = Path(file["path"]).stat().st_size
        if file["size"] is not None and size != file["size"]:
            raise Trouble(IO, f"{file['name']} came with {size} of {file['size']} bytes")
    raws = [Path(file["path"]) for file in files if file["raw"]]
    if not files:
        raise Trouble(TIMEOUT, f"no photograph came within {wait_s:g} s")
    if not raws:
        raise CameraError(
            f"the camera sent {files[0]['name']}, a JPEG, and no raw file: set its image quality to raw"
        )
    if len(raws) > 1:
        raise Trouble(TIMEOUT, f"{len(raws)} raw files came of one exposure")
    made = path.with_name(path.name + _checked_suffix(raws[0]))
    if made.exists():
        raise CameraError(f"{made} is there already; photographs are never overwritten")
    raws[0].rename(made)
    return made


def _checked_suffix(raw: Path) -> str:
    """Return the suffix of a raw file by its content, whatever its name. Raises Trouble for a damaged file."""
    try:
        container = recognise(raw)
        with opened_raw(raw) as opened:
            sizes = opened.sizes
    except (RawError, rawpy.LibRawError) as error:
        raise Trouble(IO, f"what came is no whole raw file ({error})") from error
    if not (sizes.raw_width and sizes.raw_height):
        raise Trouble(IO, "what came holds no picture")
    with opened_photograph(raw) as file:
        head = file.read(32)
    for mark, suffix in SUFFIXES:
        if mark in head:
            return suffix
    maker = container.camera.partition(" ")[0].lower()
    return MAKERS.get(maker, ".dng") if head[:4] in (b"II*\0", b"MM\0*") else ".raw"
