"""Files are read by `labkit.storage.reading` alone: calls that read in another way are named here, each with its reason."""

import ast
from collections.abc import Iterator

import pytest

from tests.unit.test_house import PRODUCT, name

READS = {
    *("open", "os.open", "io.open", "io.FileIO", "io.open_code", "os.fdopen", "mmap.mmap"),
    *("tomllib.load", "json.load", "pickle.load", "pickle.loads", "sqlite3.connect"),
    *("np.load", "np.fromfile", "np.memmap", "np.loadtxt", "np.genfromtxt"),
    *("cv2.imread", "tifffile.imread", "rawpy.imread", "tifffile.TiffFile"),
    *("Image.open", "zipfile.ZipFile", "ZipFile", "shutil.copy", "shutil.copy2"),
    *("shutil.copyfile", "shutil.copytree", "linecache.getlines", "fileinput.input"),
}
"""Functions that read a file, or from a file object that is opened elsewhere."""

READ_METHODS = {"open", "read_text", "read_bytes", "imread"}
"""Of a path."""

NO_PATH = {"Session", "Image", "os", "io", "archive", "screen"}
"""What these open is no path: a session, whose files are read by `labkit.storage.reading`, or counts as a function above."""

OWN_CODE = "a file of the package itself"
OPENED = "reads from an opened file or from memory, not from a path"
SYSTEM = "the system's own account of this machine"
MADE = "makes a new file"

ALLOWED = {
    ("labkit/storage/reading.py", "open"): "the one reader",
    ("labkit/storage/reading.py", "os.open"): "the one reader",
    ("labkit/storage/files.py", "os.open"): "standard streams, and a folder to sync",
    ("labkit/storage/files.py", "open"): MADE,
    ("labkit/storage/files.py", ".open"): MADE,
    ("labkit/storage/npz.py", "zipfile.ZipFile"): OPENED,
    ("labkit/storage/apart.py", "open"): "memory shared with the decoder",
    ("labkit/storage/apart.py", "os.fdopen"): "the pipe to the decoder",
    ("labkit/storage/apart.py", "pickle.loads"): "what this process asks of the decoder",
    ("labkit/storage/apart.py", ".read_text"): SYSTEM,
    (
        "labkit/jobs/processes.py",
        "pickle.loads",
    ): "what processes of one fit send each other",
    ("labkit/jobs/execute.py", "pickle.load"): "what processes of one fit send each other",
    ("labkit/cli/command_line.py", "open"): "the null device, for closed streams",
    ("labkit/cli/command_line.py", "os.open"): "the null device, for closed streams",
    ("labkit/restoration/tile_size.py", "open"): SYSTEM,
    ("labkit/devices/inventory.py", ".read_text"): SYSTEM,
    ("labkit/restoration/canvas.py", "np.memmap"): "a temporary file of this process",
    ("labkit/photographs/libraw.py", "open"): "memory for LibRaw's messages",
    ("labkit/photographs/libraw.py", "rawpy.imread"): OPENED,
    ("labkit/photographs/container.py", "tifffile.TiffFile"): OPENED,
    ("labkit/photographs/encoding.py", "tifffile.TiffFile"): OPENED,
    ("labkit/photographs/picture_file.py", "tifffile.TiffFile"): OPENED,
    ("labkit/photographs/picture_file.py", "Image.open"): OPENED,
    ("labkit/report/pictures.py", "Image.open"): OPENED,
    ("labkit/numerics.py", ".read_bytes"): OWN_CODE,
    ("labkit/spectra/__init__.py", ".read_text"): OWN_CODE,
    ("labkit/report/html.py", ".read_text"): OWN_CODE,
    ("drivers/web/server.py", ".read_bytes"): OWN_CODE,
    ("labkit/experiments/methods/psf_basis.py", "np.load"): OWN_CODE,
    ("labkit/experiments/methods/strehl_candidates.py", "np.load"): OWN_CODE,
}


def dotted(node: ast.expr) -> str:
    """`np.load` for numpy.load as a module imports it; empty for anything else than names with dots."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (before := dotted(node.value)):
        return f"{before}.{node.attr}"
    return ""


def reads(tree: ast.AST) -> Iterator[str]:
    """Yield the name of each call that reads a file; of a path's method with a dot in front."""
    for node in ast.walk(tree):
        called = node.func if isinstance(node, ast.Call) else None
        if called is not None and (words := dotted(called)) in READS:
            yield words
        elif isinstance(called, ast.Attribute) and called.attr in READ_METHODS:
            owner = dotted(called.value)
            if owner.partition(".")[0] not in {*NO_PATH, "reading", "self"}:
                yield f".{called.attr}"


def imported_readers(tree: ast.AST) -> Iterator[str]:
    """Yield readers imported by their bare names, which the names above would not find."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = {"numpy": "np", "PIL.Image": "Image"}.get(node.module, node.module)
            yield from (
                words
                for alias in node.names
                if (words := f"{module}.{alias.name}") in READS
            )


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("open('a')", ["open"]),
        ("(folder / 'a').read_text()", [".read_text"]),
        ("Path(given).open('rb')", [".open"]),
        ("with path.open() as f: json.load(f)", [".open", "json.load"]),
        ("np.load(path)", ["np.load"]),
        ("reading.read_text(path, 1)", []),
        ("read_bytes(path, 1)", []),
        ("Session.open(folder)", []),
    ],
)
def test_ways_to_read_are_recognised(code: str, found: list[str]) -> None:
    assert sorted(reads(ast.parse(code))) == found


def test_files_are_read_in_one_way() -> None:
    trees = {name(path): ast.parse(path.read_text(encoding="utf-8")) for path in PRODUCT}
    found = {(where, call) for where, tree in trees.items() for call in reads(tree)}
    assert found - ALLOWED.keys() == set()
    assert ALLOWED.keys() - found == set()
    assert [w for w, tree in trees.items() if [*imported_readers(tree)]] == []
